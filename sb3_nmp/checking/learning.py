"""Rules about `learn`: what a run may spend, and what it may depend on."""

import random
from typing import cast

import numpy as np
import torch as th
from stable_baselines3.common.vec_env import DummyVecEnv

from sb3_nmp.checking.environments import Recording, Telling
from sb3_nmp.checking.examined import Examined, first_difference, require
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.rollouts import Information


def the_budget_is_spent_and_no_more(it: Examined) -> None:
    """``learn(n)`` executes n rollouts, counts them, and returns the model."""
    for budget in (3, it.budget):
        env = Recording(it.make_env())
        model = it.build(env)
        returned, done = model.learn(budget), len(env.trajectories)
        require(
            done == budget,
            f"{it.name}.learn({budget}) executed {done} rollouts; it must execute {budget}, also "
            "where that cuts a generation: costs are counted in rollouts, and a run that spends "
            "more than others compares with none.",
        )
        require(
            model.num_timesteps == budget,
            f"{it.name} counts num_timesteps = {model.num_timesteps} after {budget} rollouts; add "
            "one per rollout: callbacks and logs rely on it.",
        )
        require(
            returned is model,
            f"{it.name}.learn returned {returned!r}; it must return the model (return self).",
        )


def trajectories_are_executable(it: Examined) -> None:
    """What is executed lies in the action space; `Recording` tells where it does not."""
    it.run(3)


def a_seed_repeats_a_run(it: Examined) -> None:
    """Equal seeds give equal runs, to the bit; other seeds give others."""
    _, first = it.reference
    told = first_difference(first, it.run()[1])
    require(
        not told,
        f"{it.name} with seed 0 gave two runs that differ: {told}; all chance must come from "
        "generators that the seed sets, such as self.rng.",
    )
    require(
        first_difference(first, it.run(seed=1)[1]),
        f"{it.name} gave the same run for the seeds 0 and 1; draw from a generator that the seed "
        "sets, or runs over seeds say nothing about chance.",
    )


def global_generators_do_not_matter(it: Examined) -> None:
    """Whoever else draws from Python's, NumPy's or PyTorch's generators changes no run."""
    env = Recording(it.make_env())
    model = it.build(env)
    random.seed(99)
    np.random.seed(99)
    th.manual_seed(99)
    model.learn(it.budget)
    told = first_difference(it.reference[1], env.trajectories)
    require(
        not told,
        f"{it.name}'s run changes when global generators are seeded anew after its construction: "
        f"{told}; draw from a generator of the model's own, such as self.rng.",
    )


def looking_changes_nothing(it: Examined) -> None:
    """Greedy answers that are asked for during a run leave it as it is."""

    def look(found: dict[str, object], _: dict[str, object]) -> bool:
        model = cast("object", found["self"])
        model.predict(it.contexts, deterministic=True)  # pyright: ignore[reportAttributeAccessIssue]
        return True

    told = first_difference(it.reference[1], it.run(callback=look)[1])
    require(
        not told,
        f"{it.name}'s run changes when predict(contexts, deterministic=True) is called after each "
        f"rollout: {told}; a greedy answer must draw nothing and store nothing, or evaluation "
        "changes what it measures.",
    )


def two_calls_are_one(it: Examined) -> None:
    """``learn(a)`` and ``learn(b, reset_num_timesteps=False)`` are ``learn(a + b)``."""
    env = Recording(it.make_env())
    model = it.build(env)
    cut = it.population + 1
    model.learn(cut).learn(it.budget - cut, reset_num_timesteps=False)
    told = first_difference(it.reference[1], env.trajectories)
    require(
        not told,
        f"{it.name}'s run in two calls of learn, {cut} and {it.budget - cut} rollouts, is not the "
        f"one in a single call: {told}; keep what a generation needs in attributes, not in learn.",
    )


def a_callback_ends_a_run(it: Examined) -> None:
    """A callback that returns False after its third step ends the run there."""
    calls: list[int] = []

    def stop(found: dict[str, object], _: dict[str, object]) -> bool:
        calls.append(0)
        return len(calls) < 3

    _, done = it.run(callback=stop)
    require(
        len(done) == 3,
        f"{it.name} executed {len(done)} rollouts, though a callback returned False after the "
        "third; call the callback after each rollout, and end learn where it returns False.",
    )


def environments_side_by_side_give_the_same_run(it: Examined) -> None:
    """Two environments of one pinned context give the run of a single one."""
    if it.draws_contexts or it.population % 2:
        return
    both = [Recording(it.make_env()) for _ in range(2)]
    model = it.build(DummyVecEnv([lambda env=env: env for env in both]))
    model.learn(2 * it.population)
    done = [each for pair in zip(*(env.trajectories for env in both), strict=True) for each in pair]
    told = first_difference(it.reference[1][: 2 * it.population], done)
    require(
        not told,
        f"{it.name}'s run in two environments side by side is not the one in a single environment: "
        f"{told}; propose a generation's members independently of how many are executed at once.",
    )


def contexts_may_be_drawn(it: Examined) -> None:
    """It learns where every episode has another context too, if the environment allows it."""
    env = it.make_env().unwrapped
    if it.draws_contexts or not hasattr(env, "pinned"):
        return
    env.pinned = None  # pyright: ignore[reportAttributeAccessIssue]
    drawing = Recording(env)
    it.build(drawing).learn(it.budget)
    require(
        len(drawing.trajectories) == it.budget,
        f"{it.name}.learn({it.budget}) executed {len(drawing.trajectories)} rollouts where "
        "contexts are drawn; it must spend its budget there as well.",
    )


def it_learns_from_what_it_says(it: Examined) -> None:
    """What ``information`` does not name changes no run."""
    said = getattr(it.build(), "information", None)
    if said is None:
        return
    unknown = set(said) - set(Information)
    require(
        not unknown,
        f"{it.name}.information names {sorted(map(str, unknown))}; there are "
        f"{', '.join(Information)}.",
    )
    reference = _told(it, None)
    for kind in set(Information) - set(said):
        told = first_difference(reference, _told(it, kind))
        require(
            not told,
            f"{it.name} learns from {kind}, which its information does not name "
            f"({', '.join(sorted(said))}): {told} where that is told otherwise; add "
            f"Information.{kind.name}, so that tables compare like with like.",
        )


def _told(it: Examined, altered: Information | None) -> list[np.ndarray]:
    """Return what is executed where one kind of information is told otherwise."""
    env = Recording(Telling(it.make_env(), altered))
    changes = {}
    shown = it.settings.get("demonstrations")
    if altered is Information.DEMONSTRATIONS and shown is not None:
        changes["demonstrations"] = Demonstrations(shown.contexts, 0.9 * shown.trajectories)
    it.build(env, **changes).learn(it.budget)
    return env.trajectories
