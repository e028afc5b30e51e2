"""Rules about what a task says of itself."""

import json
from collections.abc import Iterable, Mapping

import numpy as np
from gymnasium import spaces

from benchmark_envs.checking.examined import Examined, built_again, numbers, require
from benchmark_envs.task import unit_of

DECLARED = (
    "context_names", "trajectory_names", "exploration_scale", "reward_terms", "context_space",
    "trajectory_space", "dt",
)  # fmt: skip


def everything_is_declared(it: Examined) -> None:
    """Names, spaces, scale, terms and time step are there."""
    missing = [name for name in DECLARED if not hasattr(it.task, name)]
    require(
        not missing,
        f"{it.name} does not say its {' and '.join(missing)}; a task declares "
        f"{', '.join(DECLARED)}: set them on the class, or in its constructor.",
    )


def spaces_are_finite_boxes(it: Examined) -> None:
    """Contexts are a finite box of shape (C,), trajectories one of shape (T, D)."""
    wanted = (("context_space", 1, "(C,)"), ("trajectory_space", 2, "(T, D)"))
    for name, n_axes, shape in wanted:
        space = getattr(it.task, name)
        finite = isinstance(space, spaces.Box) and np.isfinite([space.low, space.high]).all()
        require(
            finite and len(space.shape) == n_axes and space.dtype == np.float32,
            f"{it.name}.{name} is {space}; it must be a Box of shape {shape} and dtype float32 "
            "with finite bounds: spaces.Box(low, high, shape, np.float32).",
        )


def every_entry_has_a_name_with_its_unit(it: Examined) -> None:
    """There are C names of contexts and D of trajectories, such as ``"goal x [m]"``."""
    wanted = (
        ("context_names", it.task.context_space),
        ("trajectory_names", it.task.trajectory_space),
    )
    for kind, space in wanted:
        names = getattr(it.task, kind)
        require(
            isinstance(names, list | tuple) and _texts(names),
            f"{it.name}.{kind} is {names!r}; it must be a tuple of texts, such as ('goal x [m]',).",
        )
        require(
            len(names) == space.shape[-1],
            f"{it.name}.{kind} holds {len(names)} names, {names}, for {space.shape[-1]} entries "
            f"of a space of shape {space.shape}; give one for each.",
        )
        for name in names:
            require(
                unit_of(name),
                f"{it.name}.{kind} holds '{name}'; a name ends with its unit in brackets, such as "
                "'goal x [m]', 'wrist [rad]' or, without one, 'phase [1]'.",
            )


def what_is_said_is_text(it: Examined) -> None:
    """Terms are texts by name, modes a tuple of texts, the optimum a name and its reward."""
    terms, modes, optimum = it.task.reward_terms, it.task.modes, it.task.optimum
    require(
        isinstance(terms, Mapping) and _texts([*terms, *terms.values()]),
        f"{it.name}.reward_terms is {terms!r}; it must be a dictionary from each term's name to "
        "what it means, such as {'distance': 'minus the distance to the target [m]'}.",
    )
    require(
        isinstance(modes, list | tuple) and modes and _texts(modes),
        f"{it.name}.modes is {modes!r}; it must be a tuple of texts, at least one: ('default',).",
    )
    for name in ("step_reward", "error_unit"):
        require(
            isinstance(getattr(it.task, name), str),
            f"{it.name}.{name} is {getattr(it.task, name)!r}; it must be a text, '' for none.",
        )
    named = isinstance(optimum, list | tuple) and len(optimum) == 2 and isinstance(optimum[0], str)
    require(
        optimum is None or (named and numbers(optimum[1]).shape == ()),
        f"{it.name}.optimum is {optimum!r}; it must be a name and a reward, such as "
        "('the shortest way', -0.1), or None.",
    )


def _texts(values: Iterable[object]) -> bool:
    return all(isinstance(value, str) for value in values)


def the_scale_has_an_entry_per_dimension(it: Examined) -> None:
    """Exploration begins at a finite scale above 0 in each dimension."""
    scale, n_dimensions = numbers(it.task.exploration_scale), it.task.trajectory_space.shape[1]
    require(
        scale.shape == (n_dimensions,) and np.isfinite(scale).all() and (scale > 0).all(),
        f"{it.name}.exploration_scale is {it.task.exploration_scale}; it must be {n_dimensions} "
        "finite numbers > 0: a standard deviation per dimension, in the trajectory's unit.",
    )


def time_goes_on(it: Examined) -> None:
    """The time step is finite and above 0."""
    dt = numbers(it.task.dt)
    require(
        dt.shape == () and np.isfinite(dt) and dt > 0,
        f"{it.name}.dt is {it.task.dt!r}; it must be a finite number of seconds > 0: the time from "
        "one set-point to the next.",
    )


def the_rewards_have_a_range(it: Examined) -> None:
    """The worst reward is finite and below the best one."""
    ends = numbers(it.task.reward_range)
    require(
        ends.shape == (2,) and np.isfinite(ends).all() and ends[0] < ends[1],
        f"{it.name}.reward_range is {it.task.reward_range!r}; it must be two finite numbers, the "
        "worst reward before the best: a rollout that breaks down is given the worst.",
    )


def settings_build_the_same_task(it: Examined) -> None:
    """Each argument of the constructor is kept under its name, as a JSON value."""
    missing = [name for name in it.task.setting_names() if not hasattr(it.task, name)]
    require(
        not missing,
        f"{it.name} takes the argument '{', '.join(missing)}' and keeps no attribute of that name; "
        "keep it as it was given: records and workers build the task from its settings.",
    )
    settings = it.task.settings
    again = built_again(it).settings
    require(
        again == settings,
        f"{it.name} built from its settings {settings} has the settings {again}; an attribute that "
        "bears an argument's name must keep what was given.",
    )
    _plain_json(it, "settings", settings)


def what_is_told_is_plain_json(it: Examined) -> None:
    """Metadata, and the scene of a planar task, can be written into a record."""
    _plain_json(it, "metadata()", it.task.metadata())
    scene = it.task.scene(it.contexts[0])
    require(
        scene is None or isinstance(scene, dict),
        f"{it.name}.scene(context) is {scene!r}; it must be a dictionary (Task.scene), or None.",
    )
    _plain_json(it, "scene(context)", scene)


def _plain_json(it: Examined, what: str, value: object) -> None:
    try:
        same = json.loads(json.dumps(value, allow_nan=False)) == value
    except (TypeError, ValueError):
        same = False
    require(
        same,
        f"{it.name}.{what} is {value}; it must be plain JSON: finite numbers, text, booleans, "
        "lists and dictionaries. Turn arrays into lists (.tolist()), tuples too.",
    )
