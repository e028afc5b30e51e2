"""What can go wrong when runs are asked for or read; each message names the alternatives."""


class BenchmarkError(ValueError):
    """A suite, an algorithm, a setting or a folder of runs is not usable as given."""


class SettingsClashError(BenchmarkError):
    """A folder holds runs of the same experiment with other settings."""


class RecordError(BenchmarkError):
    """A file is no record of a run, is damaged, or is of another version."""
