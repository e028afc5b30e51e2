"""What can go wrong when a task is asked for or a rollout is run.

Each message names the offending value, the rule it breaks and the alternatives that exist.
"""


class TaskError(ValueError):
    """Base class: a task, its settings, a context or a trajectory is not usable as given."""


class UnknownTaskError(TaskError):
    """No task is registered under that id."""


class InvalidContextError(TaskError):
    """A context has the wrong shape, holds a non-finite value or lies outside the context space."""


class InvalidTrajectoryError(TaskError):
    """A trajectory has the wrong shape or holds a non-finite value."""


class TaskContractError(TaskError):
    """A task breaks a rule on which environments and algorithms rely (`check_task`)."""


class RenderingUnavailableError(RuntimeError):
    """No off-screen OpenGL renderer could be started, or the task draws no pictures."""


class NoPicturesError(RenderingUnavailableError, TypeError):
    """A render mode was given for a task that draws no pictures.

    A TypeError, as of an argument that there is not: SB3's ``make_vec_env`` gives every environment
    ``render_mode="rgb_array"``, and leaves it out where that raises one.
    """
