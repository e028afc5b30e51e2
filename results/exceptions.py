"""What can go wrong when runs are asked for or read; each message names the alternatives."""


class BenchmarkError(ValueError):
    """A suite, an algorithm, a setting or a folder of runs is not usable as given."""


class SettingsClashError(BenchmarkError):
    """A folder holds runs of the same experiment with other settings."""


class RecordError(BenchmarkError):
    """A file is no record of a run, is damaged, or is of another version."""


class UnreadableRecordError(RecordError):
    """A file is no record of a run, or is damaged: no version reads it.

    :param message: for who has a folder of runs
    :param why: what about the file, for who has named it alone
    """

    def __init__(self, message: str, why: str = "") -> None:
        super().__init__(message)
        self.why = why
