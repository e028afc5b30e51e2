"""Rules about contexts, and about the trajectories that a task offers in them."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from benchmark_envs.checking.examined import Examined, numbers, require
from benchmark_envs.exceptions import (
    InvalidContextError,
    InvalidTrajectoryError,
    TaskContractError,
    TaskError,
)
from benchmark_envs.rollouts import FloatArray

#: share of the contexts that an expert must solve
EXPERT_SOLVES = 0.8


def contexts_are_drawn_inside_their_space(it: Examined) -> None:
    """Whatever `_draw_context` returns is a context."""
    try:
        it.contexts  # noqa: B018
    except InvalidContextError as error:
        raise TaskContractError(
            f"{it.name}._draw_context left the context space: {error} Draw inside of it, or widen "
            "context_space."
        ) from error


def equal_seeds_draw_equal_contexts(it: Examined) -> None:
    """Chance comes from the generator that is given."""
    again = Examined(it.task, it.n_contexts, it.seed).contexts
    row = int(np.argmax((again != it.contexts).any(axis=1)))
    require(
        np.array_equal(again, it.contexts),
        f"{it.name}._draw_context drew {it.contexts[row].tolist()} and, from a generator of the "
        f"same seed, {again[row].tolist()}; draw from the given rng alone, not from np.random or "
        "a generator of the task's own.",
    )


def the_naive_trajectory_fits(it: Examined) -> None:
    """A search starts inside the trajectory space, from an array of its own."""
    _trajectories(it, "initial_trajectory", it.task.initial_trajectory)


def the_expert_solves_its_task(it: Examined) -> None:
    """Each mode of the expert succeeds nearly everywhere; a task without one raises a TaskError."""
    for mode in it.task.modes:
        try:
            it.task.demonstrate(it.contexts[0], mode)
        except TaskError:
            continue  # no expert
        shown = _trajectories(
            it, "demonstrate", lambda context, mode=mode: it.task.demonstrate(context, mode)
        )
        solved = int(it.task.simulate(it.contexts, shown).successes.sum())
        require(
            solved >= EXPERT_SOLVES * it.n_contexts,
            f"{it.name}'s expert ('{mode}') solves {solved} of {it.n_contexts} contexts; it must "
            f"solve {EXPERT_SOLVES:.0%} of them. Mend demonstrate or what counts as a success, or "
            "raise a TaskError where there is no expert.",
        )


def _trajectories(it: Examined, name: str, make: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Return what a method makes of the contexts, shape (N, T, D), after a look at each.

    Raise unless it is a trajectory, the same one again, and the context is left as it was.
    """
    space, found = it.task.trajectory_space, []
    for given in it.contexts:
        context = given.copy()
        made = _trajectory(it, name, make(context))
        beyond = float(np.max(np.maximum(made - space.high, space.low - made)))
        require(
            beyond <= 1e-6,
            f"{it.name}.{name} lies {beyond:.4g} outside the trajectory space in the context "
            f"{given.tolist()}; keep set-points inside, or widen trajectory_space.",
        )
        require(
            np.array_equal(context, given),
            f"{it.name}.{name} changed the context it was given from {given.tolist()} to "
            f"{context.tolist()}; work on a copy.",
        )
        before = made.copy()
        if made.flags.writeable:
            made += 1.0
        require(
            np.array_equal(make(context), before),
            f"{it.name}.{name} returns another trajectory when it is asked again in the context "
            f"{given.tolist()}; it must depend on the context alone, and return an array of its "
            "own, that a caller may change.",
        )
        found.append(before)
    return np.stack(found)


def _trajectory(it: Examined, name: str, returned: ArrayLike) -> FloatArray:
    """Return what a method returned, shape (T, D), or raise unless it is a trajectory."""
    shape = it.task.trajectory_space.shape
    found = numbers(returned)
    try:
        if found.ndim == 2:
            return it.task.check_trajectories(found)[0]
    except InvalidTrajectoryError as error:
        raise TaskContractError(f"{it.name}.{name} returned no trajectory: {error}") from error
    raise TaskContractError(
        f"{it.name}.{name} returned no trajectory but a {type(returned).__name__} of shape "
        f"{np.shape(found) if found.size > 1 else ()}; it must be an array of shape (T, D) = "
        f"{shape} ({', '.join(it.task.trajectory_names)})."
    )


def what_is_no_context_or_trajectory_is_refused(it: Examined) -> None:
    """Wrong shapes, values that are not finite and contexts outside raise errors of their own."""
    context, trajectory = it.contexts[0], it.trajectories[0]
    holed = trajectory.copy()
    holed[0, 0] = np.nan
    outside = it.task.context_space.high.astype(np.float64) + 1.0
    cases = (
        ("a context outside its space", InvalidContextError, outside, trajectory),
        ("a trajectory that is too short", InvalidTrajectoryError, context, trajectory[:-1]),
        ("a trajectory with a nan", InvalidTrajectoryError, context, holed),
    )
    for what, error, bad_context, bad_trajectory in cases:
        try:
            it.task.simulate(bad_context, bad_trajectory)
        except error:
            continue
        raise TaskContractError(
            f"{it.name}.simulate took {what}; it must raise {error.__name__}: call check_context "
            "and check_trajectories, as Task.simulate does."
        )
