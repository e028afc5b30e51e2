"""Rules about the constructor, `predict`, and what becomes of a model in a file."""

import inspect
import tempfile
from pathlib import Path
from typing import Any, cast

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.base_class import BaseAlgorithm

from sb3_nmp.checking.environments import Recording
from sb3_nmp.checking.examined import Examined, first_difference, require


def it_is_an_algorithm_of_sb3(it: Examined) -> None:
    """The class has SB3's methods, and defaults for all but policy and environment."""
    require(
        isinstance(it.algorithm, type) and issubclass(it.algorithm, BaseAlgorithm),
        f"{it.algorithm!r} is no subclass of SB3's BaseAlgorithm; give a class, such as sb3_nmp's "
        "TrajectoryAlgorithm with the three methods of its update.",
    )
    parameters = inspect.signature(it.algorithm).parameters.values()
    needed = [
        each.name
        for each in parameters
        if each.default is each.empty and each.kind not in (each.VAR_KEYWORD, each.VAR_POSITIONAL)
    ]
    require(
        set(needed) <= {"policy", "env"},
        f"{it.name} needs the arguments {', '.join(needed)}; all but policy and env must have "
        "defaults, since SB3's load gives no others.",
    )
    require(
        "MlpPolicy" in it.algorithm.policy_aliases,
        f"{it.name}.policy_aliases has {sorted(it.algorithm.policy_aliases)}; name its policy "
        "'MlpPolicy', which the benchmark asks for.",
    )


def answers_are_trajectories(it: Examined) -> None:
    """`predict` answers a context by a trajectory of the action space, and N by N."""
    model = it.reference[0]
    space = cast(spaces.Box, it.make_env().action_space)
    one, many = it.contexts[0], it.contexts
    for deterministic in (True, False):
        for asked, shape in ((one, space.shape), (many, (len(many), *space.shape))):
            returned = model.predict(asked, deterministic=deterministic)
            require(
                isinstance(returned, tuple) and len(returned) == 2,
                f"{it.name}.predict returned a {type(returned).__name__}; it must be the tuple "
                "(trajectories, None), as SB3's predict returns.",
            )
            answer, state = returned
            require(
                np.shape(answer) == shape,
                f"{it.name}.predict answered contexts of shape {asked.shape} by an array of shape "
                f"{np.shape(answer)}; it must be {shape}: (T, D) for one context, (N, T, D) for N.",
            )
            require(
                state is None, f"{it.name}.predict returned the state {state}; it must be None."
            )
            inside = all(space.contains(each) for each in answer.reshape(-1, *space.shape))
            require(
                inside,
                f"{it.name}.predict(deterministic={deterministic}) answered from "
                f"{answer.min():.4g} to {answer.max():.4g} as {answer.dtype}; it must be "
                f"float32 in {space}: clip it.",
            )


def greedy_answers_are_repeated(it: Examined) -> None:
    """A greedy answer is the same whenever it is asked, alone or among others."""
    model, asked = it.reference[0], it.contexts
    before = model.predict(asked, deterministic=True)[0]
    model.predict(asked, deterministic=False)
    again = model.predict(asked, deterministic=True)[0]
    require(
        np.array_equal(before, again),
        f"{it.name}.predict(deterministic=True) answered twice with up to "
        f"{np.abs(before - again).max():.3g} between the answers; a greedy answer draws nothing, "
        "and the networks are in evaluation mode.",
    )
    alone = np.stack([model.predict(each, deterministic=True)[0] for each in asked])
    scale = np.ptp(before) + 1e-12
    require(
        np.allclose(alone, before, atol=1e-4 * scale),
        f"{it.name}.predict answers a context otherwise when it is asked alone, by up to "
        f"{np.abs(alone - before).max():.3g}; a row of a batch depends on its context alone.",
    )


def a_file_keeps_the_answers(it: Examined) -> None:
    """A saved and loaded model gives the same greedy answers, and knows its rollouts."""
    model, asked = it.reference[0], it.contexts
    with tempfile.TemporaryDirectory() as folder:
        model.save(Path(folder) / "model.zip")
        loaded = cast(Any, it.algorithm).load(Path(folder) / "model.zip")
    before, after = (each.predict(asked, deterministic=True)[0] for each in (model, loaded))
    require(
        np.array_equal(before, after),
        f"{it.name} answers otherwise after save and load, by up to "
        f"{np.abs(before - after).max():.3g}; what predict needs belongs in the policy, as a "
        "parameter or a registered buffer, or into an attribute that is saved.",
    )
    require(
        loaded.num_timesteps == model.num_timesteps,
        f"{it.name} was saved after {model.num_timesteps} rollouts and loaded with num_timesteps = "
        f"{loaded.num_timesteps}; call super().save and super().load.",
    )


def a_run_goes_on_from_its_files(it: Examined) -> None:
    """A run that was saved, loaded and continued equals one that was not interrupted."""
    for cut in (it.population, it.population + 2):
        env = Recording(it.make_env())
        first = it.build(env).learn(cut)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "model.zip"
            first.save(path)
            buffered = hasattr(first, "save_replay_buffer")
            if buffered:
                first.save_replay_buffer(Path(folder) / "buffer")
            rest = Recording(it.make_env())
            loaded = cast(Any, it.algorithm).load(path, env=rest, **it.shown)
            if buffered:
                loaded.load_replay_buffer(Path(folder) / "buffer")
        loaded.learn(it.budget - cut, reset_num_timesteps=False)
        told = first_difference(it.reference[1], [*env.trajectories, *rest.trajectories])
        require(
            not told,
            f"{it.name}'s run that was saved after {cut} rollouts, loaded and continued, is not "
            f"the uninterrupted one: {told}; all that the next rollout depends on, generators too, "
            "belongs into attributes that are saved.",
        )
