"""Rules about rollouts: what is measured, and what it may depend on."""

import inspect
from collections.abc import Mapping

import numpy as np
from gymnasium.utils.env_checker import check_env
from numpy.typing import ArrayLike

from benchmark_envs.checking.examined import Examined, built_again, require
from benchmark_envs.exceptions import TaskContractError
from benchmark_envs.rollouts import FloatArray, Measured, Rollouts
from benchmark_envs.trajectory_env import TrajectoryEnv


def what_is_measured_has_its_shapes(it: Examined) -> None:
    """`_execute` returns a `Measured` with one row per rollout."""
    contexts, trajectories = it.contexts[:2].copy(), it.trajectories[:2].copy()
    measured = it.task._execute(contexts, trajectories)
    require(
        isinstance(measured, Measured),
        f"{it.name}._execute returned a {type(measured).__name__}; it must be a Measured.",
    )
    for name in ("terms", "paths", "outcomes"):
        value = getattr(measured, name)
        require(
            isinstance(value, Mapping),
            f"{it.name} measured {name} = {value!r}; it must be a dictionary of arrays by name.",
        )
    _arrays_fit(it, measured, contexts, trajectories)
    for name in ("successes", "diverged", "clipped"):
        value = getattr(measured, name)
        kind = None if value is None else np.asarray(value).dtype.kind
        require(kind in (None, "b"), f"{it.name} measured {name} = {value}; it must be booleans.")
    for name, path in measured.paths.items():
        fits = np.ndim(path) == 3 and np.shape(path)[:2] == trajectories.shape[:2]
        require(
            fits and np.shape(path)[2] in (2, 3),
            f"{it.name} measured paths['{name}'] of shape {np.shape(path)}; it must be "
            f"{(*trajectories.shape[:2], '2 or 3')}: positions in m at the time points.",
        )


def _arrays_fit(
    it: Examined, measured: Measured, contexts: FloatArray, trajectories: FloatArray
) -> None:
    """Raise unless all that is measured is an array of numbers, of its shape."""
    n = (len(contexts),)
    shapes: dict[str, tuple[ArrayLike | None, tuple[int, ...]]] = {
        "executed": (measured.executed, trajectories.shape),
        "successes": (measured.successes, n),
        "diverged": (measured.diverged, n),
        "clipped": (measured.clipped, n),
        "step_rewards": (measured.step_rewards, trajectories.shape[:2]),
        "achieved_contexts": (measured.achieved_contexts, contexts.shape),
        **{f"terms['{key}']": (value, n) for key, value in measured.terms.items()},
        **{f"outcomes['{key}']": (value, n) for key, value in measured.outcomes.items()},
    }
    for name, (value, shape) in shapes.items():
        if value is None and name not in ("executed", "successes"):
            continue  # the others may be left out
        require(
            isinstance(value, np.ndarray | np.generic),
            f"{it.name} measured {name} = {value!r}; it must be an array of shape {shape}.",
        )
        found = np.asarray(value).shape
        require(
            found == shape,
            f"{it.name} measured {name} of shape {found}; it must have shape {shape}, a "
            "row for each of 2 rollouts.",
        )
        require(
            np.asarray(value).dtype.kind in "fiub",
            f"{it.name} measured {name} of dtype {np.asarray(value).dtype}; it must be numbers.",
        )


def the_terms_are_those_documented(it: Examined) -> None:
    """The reward's terms bear the names of ``reward_terms``, and summands are told of."""
    found, told = set(it.rollouts.terms) - {"diverged"}, set(it.task.reward_terms)
    require(
        found == told,
        f"{it.name} measured the terms {sorted(found)}, and reward_terms describes {sorted(told)}; "
        "describe each term that is measured, and no other.",
    )
    has_steps = it.rollouts.step_rewards is not None
    require(
        has_steps == bool(it.task.step_reward),
        f"{it.name} measured {'' if has_steps else 'no '}step_rewards, and step_reward is "
        f"'{it.task.step_reward}'; say what a summand means where there are summands, or leave "
        "both out.",
    )


def rewards_are_finite_and_in_range(it: Examined) -> None:
    """Each reward is a finite number that ``reward_range`` holds, and its summands add up to it."""
    (low, high), rewards = it.task.reward_range, it.rollouts.rewards
    wrong = ~np.isfinite(rewards) | (rewards < low - 1e-9) | (rewards > high + 1e-9)
    row = int(np.argmax(wrong))
    terms = {name: float(value[row]) for name, value in it.rollouts.terms.items()}
    require(
        not wrong.any(),
        f"{it.name} gave the reward {rewards[row]} in the context {it.contexts[row].tolist()} "
        f"(terms {terms}); it must be a finite number in reward_range, {low} to {high}. Widen "
        "the range, clip the term, or mark what broke down by Measured(diverged=...).",
    )
    steps = it.rollouts.step_rewards
    if steps is not None:
        require(
            np.allclose(steps.sum(axis=1), rewards, rtol=1e-6, atol=1e-9),
            f"{it.name}'s step_rewards add up to {float(steps[0].sum())}, and the reward is "
            f"{rewards[0]}; they must be the reward's summands over time.",
        )
    require(
        np.isfinite(it.rollouts.executed).all(),
        f"{it.name} executed a trajectory that holds a value that is not finite; mark what broke "
        "down by Measured(diverged=...).",
    )
    told = [("outcomes", key, value) for key, value in it.rollouts.outcomes.items()]
    told += [("paths", key, value) for key, value in it.rollouts.paths.items()]
    for kind, key, value in told:
        require(
            np.isfinite(value).all(),
            f"{it.name} measured {kind}['{key}'] with a value that is not finite; records and "
            "figures need numbers: give 0.0 or the last position where there is none.",
        )


def naive_trajectories_leave_something_to_learn(it: Examined) -> None:
    """Not every context is solved by the trajectory from which a search starts."""
    naive = np.stack([it.task.initial_trajectory(context) for context in it.contexts])
    solved = int(it.task.simulate(it.contexts, naive).successes.sum())
    require(
        solved < it.n_contexts,
        f"{it.name}'s initial_trajectory solves all of {it.n_contexts} contexts; nothing is left "
        "to learn. Start from a worse one, or ask more of a success.",
    )


def achievements_are_contexts(it: Examined) -> None:
    """What a rollout achieved lies in the context space, or is nan."""
    achieved = it.rollouts.achieved_contexts
    require(
        it.task.tells_achievement or achieved is None,
        f"{it.name} measured achieved_contexts, and tells_achievement is False; set it to True.",
    )
    if achieved is not None:
        told, space = achieved[np.isfinite(achieved).all(axis=1)], it.task.context_space
        require(
            ((told >= space.low - 1e-6) & (told <= space.high + 1e-6)).all(),
            f"{it.name} measured the achieved contexts {told.round(4).tolist()}, of which some lie "
            "outside the context space; give nan there: see Task.within_contexts.",
        )


def set_points_outside_are_clipped_and_reported(it: Examined) -> None:
    """What lies beyond the trajectory space is not executed, and ``clipped`` says so."""
    beyond = it.trajectories[0].copy()
    beyond[-1] = it.task.trajectory_space.high[-1] + 1.0
    rollouts = it.task.simulate(it.contexts[0], beyond)
    require(
        rollouts.clipped[0],
        f"{it.name} executed a set-point {beyond[-1].tolist()} outside its trajectory space and "
        "reports clipped = False; clip and report it, as Task.simulate does.",
    )


def rollouts_can_be_repeated(it: Examined) -> None:
    """Rollouts give the same bits again, also in a task that was built anew, on 1 or 2 threads."""
    few = slice(0, 3)
    again = it.task.simulate(it.contexts[few], it.trajectories[few])
    _same(it, again, "the same rollouts again", few)
    threaded = "n_threads" in inspect.signature(type(it.task)).parameters
    for threads in ({"n_threads": 1}, {"n_threads": 2}) if threaded else ({},):
        anew = built_again(it, **threads).simulate(it.contexts, it.trajectories)
        told = ", ".join(f"{name}={n}" for name, n in threads.items()) or "the same settings"
        _same(it, anew, f"the same rollouts in a task that was built anew, with {told}")


def rollouts_do_not_depend_on_their_batch(it: Examined) -> None:
    """Rollouts in another order, or alone, give the same bits."""
    backwards = it.task.simulate(it.contexts[::-1], it.trajectories[::-1])[::-1]
    _same(it, backwards, "the same batch in the reverse order")
    for row in range(2):
        alone = it.task.simulate(it.contexts[row], it.trajectories[row])
        _same(it, alone, "a rollout alone", slice(row, row + 1))


def _same(it: Examined, other: Rollouts, what: str, rows: slice = slice(None)) -> None:
    """Raise unless other rollouts equal the first ones to the bit."""
    first = it.rollouts[rows]
    for name in ("rewards", "successes", "executed"):
        one, two = getattr(first, name), getattr(other, name)
        if not np.array_equal(one, two):
            place = tuple(int(i) for i in np.argwhere(one != two)[0])
            raise TaskContractError(
                f"{it.name} gave {name}{list(place)} = {one[place]} and, for {what}, {two[place]}; "
                "a rollout must depend on its context and trajectory alone, to the bit: keep no "
                "state, draw nothing at random, and compute row by row."
            )


def executed_modes_are_known(it: Examined) -> None:
    """`mode_of` names one of ``modes``, or nothing."""
    known = (*it.task.modes, "")
    for context, executed in zip(it.contexts, it.rollouts.executed, strict=True):
        mode = it.task.mode_of(context, executed)
        require(
            isinstance(mode, str) and mode in known,
            f"{it.name}.mode_of returned {mode!r}; it must be one of modes, {it.task.modes}, or "
            "'' where it cannot tell.",
        )


def its_environment_is_one_of_gymnasiums(it: Examined) -> None:
    """Gymnasium's own checker accepts the environment that stands on the task."""
    try:
        check_env(TrajectoryEnv(it.task), skip_render_check=True)
    except Exception as error:  # a bare Exception or AssertionError, of whichever kind
        raise TaskContractError(
            f"Gymnasium's check_env refuses the environment of {it.name} ({type(error).__name__}: "
            f"{error}); see gymnasium.utils.env_checker for the rule."
        ) from error
