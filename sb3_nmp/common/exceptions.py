"""What can go wrong with an algorithm's settings or data; each message names the alternatives."""


class ConfigurationError(ValueError):
    """An algorithm's settings do not fit each other or the environment."""


class UnknownArgumentError(ConfigurationError, TypeError):
    """A constructor was given an argument that it does not have."""


class InvalidDataError(ValueError):
    """Trajectories, contexts or rewards have the wrong shape or hold non-finite values."""


class AlgorithmContractError(ValueError):
    """An algorithm breaks a rule on which Stable-Baselines3 and the benchmark rely."""


class FileFormatError(ValueError):
    """A file is not one that this library wrote."""


class UnsafeFileError(FileFormatError):
    """Reading a file could run code that stands in it."""


class PickleWarning(UserWarning):
    """A part of a model can be saved as a pickle only, which `load` reads only when asked to."""


class ViaPointWarning(UserWarning):
    """A trajectory misses a via-point, since the action space allows no more."""


class DemonstrationWarning(UserWarning):
    """Demonstrations lie far outside the spaces of the environment, as in another unit."""


class ContextWarning(UserWarning):
    """A context lies outside the observation space, so that the answer is an extrapolation."""


class ResumeWarning(UserWarning):
    """A run does not go on exactly where the saved one stopped."""


class UntrainedWarning(UserWarning):
    """A policy is asked before it has learned anything."""
