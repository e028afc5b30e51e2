"""Demonstrations in Minari datasets: of trajectory bandits, or of environments with many steps."""

from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, cast

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from sb3_nmp.common.exceptions import ConfigurationError, InvalidDataError
from sb3_nmp.common.resampling import of_one_length

if TYPE_CHECKING:
    from sb3_nmp.common.demonstrations import Demonstrations

FloatArray = NDArray[np.float64]


def read_minari(dataset: Any, n_steps: int | None, context: str | None) -> tuple[FloatArray, ...]:  # noqa: ANN401
    """Return contexts (N, C) and trajectories (N, T, D) of a dataset, an episode each.

    :param dataset: a ``minari.MinariDataset`` or the id of a local one
    :param n_steps: T, to which the actions of episodes with many steps are resampled; None: every
        episode is one step, whose action is the whole trajectory
    :param context: the entry of the first observation that is the context, where observations are
        dictionaries
    :raises ConfigurationError: Minari is not installed
    :raises InvalidDataError: no dataset; an episode has many steps, and ``n_steps`` is None; or
        observations that hold no such entry
    """
    check_minari()
    import minari

    dataset = minari.load_dataset(dataset) if isinstance(dataset, str) else dataset
    if not hasattr(dataset, "iterate_episodes"):
        raise InvalidDataError(
            f"dataset is {dataset!r}; it must be a minari.MinariDataset, or the id of a local one, "
            "such as 'lab/press-v0'."
        )
    episodes = list(dataset.iterate_episodes())
    contexts = np.array([_first(each.observations, context, each.id) for each in episodes])
    if n_steps is not None:
        actions = [np.asarray(each.actions, np.float64) for each in episodes]
        return contexts, of_one_length(actions, None, n_steps, "the dataset")
    for episode in episodes:
        if len(episode.actions) != 1:
            raise InvalidDataError(
                f"episode {episode.id} has {len(episode.actions)} steps; a demonstration of a "
                "trajectory bandit is one step whose action is the whole trajectory. Give n_steps, "
                "such as n_steps=100, to take the actions of all steps as the trajectory."
            )
    return contexts, np.array([each.actions[0] for each in episodes])


def _first(observations: Any, context: str | None, episode: int) -> NDArray[Any]:  # noqa: ANN401
    """Return the context of an episode, shape (C,)."""
    if not isinstance(observations, dict):
        if context is not None:
            raise InvalidDataError(
                f"context is '{context}', but the observations are arrays without names; leave it "
                "out to take the first one."
            )
        return np.ravel(observations[0])
    if context not in observations:
        raise InvalidDataError(
            f"the observations of episode {episode} are dictionaries with "
            f"{', '.join(observations)}; name one of them as context, and not {context!r}."
        )
    return np.ravel(observations[context][0])


def write_minari(
    shown: "Demonstrations", dataset_id: str, env: gym.Env | str, metadata: dict[str, Any]
) -> Any:  # noqa: ANN401
    """Write demonstrations as a local dataset: an episode of one step a demonstration.

    :param shown: the demonstrations
    :param dataset_id: such as ``"push/expert-v0"``
    :param env: the environment that they are for, or its id
    :param metadata: further arguments of ``minari.create_dataset_from_buffers``
    :return: the ``minari.MinariDataset``
    :raises ConfigurationError: Minari is not installed
    """
    check_minari()
    import minari
    from minari.data_collector import EpisodeBuffer

    env = gym.make(env) if isinstance(env, str) else env
    action, observation = env.action_space, env.observation_space
    shown.check_fits(cast(tuple[int], observation.shape)[0], cast(tuple[int, int], action.shape))
    buffers = [
        EpisodeBuffer(
            id=index,
            observations=list(np.stack([context, context]).astype(observation.dtype)),
            actions=trajectory[None].astype(action.dtype),
            rewards=[0.0],
            terminations=[True],
            truncations=[False],
        )
        for index, (context, trajectory) in enumerate(
            zip(shown.contexts, shown.trajectories, strict=True)
        )
    ]
    further: dict[str, Any] = {"eval_env": env} | metadata
    return minari.create_dataset_from_buffers(dataset_id, buffers, env=env, **further)


def check_minari() -> None:
    """Raise unless Minari is installed.

    :raises ConfigurationError: it is not
    """
    if find_spec("minari") is None:
        raise ConfigurationError(
            "Minari is not installed; install it with 'pip install minari[hdf5]', or use save and "
            "load, which write .npz files."
        )
