"""`check_task`: whether a task keeps the contract, rule by rule, as Gymnasium's ``check_env``."""

from collections.abc import Callable
from numbers import Integral

from benchmark_envs.checking import contexts, declarations, outcomes
from benchmark_envs.checking.examined import Examined, apply, require
from benchmark_envs.exceptions import TaskContractError
from benchmark_envs.task import Task

#: in this order: a rule relies on those before it
TASK_RULES: tuple[Callable[[Examined], None], ...] = (
    declarations.everything_is_declared,
    declarations.spaces_are_finite_boxes,
    declarations.every_entry_has_a_name_with_its_unit,
    declarations.what_is_said_is_text,
    declarations.the_scale_has_an_entry_per_dimension,
    declarations.time_goes_on,
    declarations.the_rewards_have_a_range,
    declarations.settings_build_the_same_task,
    contexts.contexts_are_drawn_inside_their_space,
    contexts.equal_seeds_draw_equal_contexts,
    declarations.what_is_told_is_plain_json,
    contexts.the_naive_trajectory_fits,
    outcomes.what_is_measured_has_its_shapes,
    outcomes.the_terms_are_those_documented,
    outcomes.rewards_are_finite_and_in_range,
    outcomes.achievements_are_contexts,
    outcomes.rollouts_can_be_repeated,
    outcomes.rollouts_do_not_depend_on_their_batch,
    contexts.the_expert_solves_its_task,
    outcomes.naive_trajectories_leave_something_to_learn,
    contexts.what_is_no_context_or_trajectory_is_refused,
    outcomes.set_points_outside_are_clipped_and_reported,
    outcomes.executed_modes_are_known,
    outcomes.its_environment_is_one_of_gymnasiums,
)


def check_task(task: Task, n_contexts: int = 5, seed: int = 0) -> None:
    """Raise unless a task keeps the contract on which environments and algorithms rely.

    It draws contexts, runs the expert and executes some rollouts; `TASK_RULES` are what it asks.

    >>> from benchmark_envs import make_task
    >>> check_task(make_task("nmp/ViaPoints-v0"))

    :param task: to be checked
    :param n_contexts: in how many contexts it is tried, at least 2
    :param seed: of what is tried
    :raises TaskContractError: it breaks a rule: the value, the rule, and the way out
    """
    if not isinstance(task, Task):
        raise TaskContractError(
            f"{task!r} is a {type(task).__name__}; give an instance of a subclass of "
            "benchmark_envs.Task, such as make_task('nmp/Bottles-v0')."
        )
    for name, value, least in (("n_contexts", n_contexts, 2), ("seed", seed, 0)):
        whole = isinstance(value, Integral) and not isinstance(value, bool)
        require(
            whole and value >= least, f"{name} is {value!r}; it must be a whole number >= {least}."
        )
    examined = Examined(task, n_contexts, seed)
    for rule in TASK_RULES:
        apply(rule, examined)
