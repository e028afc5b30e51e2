"""Where environments stand in their streams of contexts, so that a resumed run goes on there.

An environment draws its contexts from Gymnasium's ``np_random``. Loading a model seeds it again, as
SB3 does, and the contexts would be those of the run's first rollouts. So the generators' states are
saved with the model: before the environments were last reset, and now. Putting the first ones back
and resetting draws the contexts that are waiting for an answer; the second ones are what follows.
"""

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from sb3_nmp.common.codec import GENERATORS
from sb3_nmp.common.exceptions import FileFormatError

#: of a NumPy bit generator, as it describes itself
State = dict[str, Any]
#: ``before`` the last reset (None: the reset seeded them) and ``now``, a state per environment
Stream = dict[str, list[State] | None]


def generator_states(env: VecEnv) -> list[State] | None:
    """Return the states of the generators that environments draw from, one for each.

    :param env: of Gymnasium environments
    :return: None where they have none
    """
    if not env.has_attr("np_random"):
        return None
    return [_plain(each.bit_generator.state) for each in env.get_attr("np_random")]


def resume(env: VecEnv, stream: Stream) -> NDArray[np.float32]:
    """Reset environments such that they go on where a saved run stopped; return their contexts.

    They are the same, bit for bit, where an environment draws at random in its reset alone. With
    another number of environments than before, none draws a context again that was drawn before.

    :param env: the environments, seeded anew by loading
    :param stream: where those of the saved run stood
    :return: shape (n_envs, C)
    """
    waiting = env.reset()  # spends the seeds
    now, before = stream["now"], stream["before"]
    if now is None:
        return cast(NDArray[np.float32], waiting)
    if len(now) != env.num_envs:
        _set_generators(env, _further(now, env.num_envs))
        return cast(NDArray[np.float32], env.reset())
    if before is not None:
        _set_generators(env, [_generator(state) for state in before])
        waiting = env.reset()
    _set_generators(env, [_generator(state) for state in now])
    return cast(NDArray[np.float32], waiting)


def _further(states: list[State], n: int) -> list[np.random.Generator]:
    """Return n generators that go on after those of some states, with streams of their own."""
    parents = [_generator(state) for state in states]
    return [
        np.random.Generator(type(parent.bit_generator)(int(parent.integers(2**63))))
        for parent in (parents[index % len(parents)] for index in range(n))
    ]


def _generator(state: State) -> np.random.Generator:
    name = state.get("bit_generator")
    if name not in GENERATORS:  # a file may name anything
        raise FileFormatError(
            f"the model's file names {name!r} as its environments' generator; it must be one of "
            f"{', '.join(GENERATORS)}."
        )
    bits = getattr(np.random, name)()
    bits.state = state
    return np.random.Generator(bits)


def _set_generators(env: VecEnv, generators: list[np.random.Generator]) -> None:
    for index, generator in enumerate(generators):
        env.set_attr("np_random", generator, indices=[index])


def _plain(state: Any) -> Any:  # noqa: ANN401
    """Return a state as numbers, texts, lists and dictionaries, which any file can hold."""
    if isinstance(state, dict):
        return {name: _plain(value) for name, value in state.items()}
    return state.tolist() if isinstance(state, np.ndarray) else state
