"""What an algorithm asks of an environment, and the messages for one that does not fit."""

import warnings
from numbers import Real
from typing import cast

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, unwrap_vec_normalize

from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.exceptions import (
    AlgorithmContractError,
    ConfigurationError,
    DemonstrationWarning,
    InvalidDataError,
)

FloatArray = NDArray[np.float64]
#: a standard deviation in the trajectory's unit: one value, or one per dimension
Scale = float | tuple[float, ...]


#: share of a space's width by which demonstrations may lie outside of it without a warning
OVERHANG = 0.1


def check_shown(shown: Demonstrations, observations: gym.Space, actions: gym.Space) -> None:
    """Raise for demonstrations of other shapes, and warn of those that lie far outside the spaces.

    :param shown: contexts (N, C) and trajectories (N, T, D); recordings overshoot a little
    :param observations: of the contexts, shape (C,)
    :param actions: of the trajectories, shape (T, D)
    :raises InvalidDataError: they do not fit
    """
    seen, moved = cast(spaces.Box, observations), cast(spaces.Box, actions)
    shown.check_fits(seen.shape[0], (moved.shape[0], moved.shape[1]))
    for name, space in (("contexts", seen), ("trajectories", moved)):
        values = getattr(shown, name)
        low, high = space.low.astype(np.float64), space.high.astype(np.float64)
        far = np.maximum(low - values, values - high) > OVERHANG * (high - low)
        if far.any():
            index = tuple(int(i) for i in np.argwhere(far)[0])
            warnings.warn(
                f"the demonstrations' {name} hold {values[index]:.4g} at index {index}, far "
                f"outside the space's {low[index[1:]]:.4g} to {high[index[1:]]:.4g} "
                f"({far.mean():.0%} of their values are): are their units the environment's?",
                DemonstrationWarning,
                stacklevel=4,
            )


def check_env_id(env: object) -> None:
    """Raise a helpful error for an environment id that Gymnasium does not know.

    :param env: an id such as ``"nmp/Bottles-v0"`` or ``"module:id"``, or an environment
    :raises ConfigurationError: the id is not registered
    """
    if not isinstance(env, str) or ":" in env or env in gym.registry:
        return
    known = sorted(key for key in gym.registry if key.startswith("nmp/"))
    raise ConfigurationError(
        f"no environment '{env}' is registered with Gymnasium. "
        + (
            f"There are: {', '.join(known)}, besides Gymnasium's own."
            if known
            else "The nmp/* tasks are registered by 'import benchmark_envs'."
        )
    )


def check_env(env: object, needed: bool) -> None:
    """Raise for what is no environment.

    :param env: an environment, an id, or None
    :param needed: whether None is refused; a model that is loaded gets its environment later
    :raises ConfigurationError: it is none, or the id is not registered
    """
    check_env_id(env)
    if not isinstance(env, str | gym.Env | VecEnv) and (env is not None or needed):
        raise ConfigurationError(
            f"env is {env!r}; it must be an environment of Gymnasium or a VecEnv of SB3, not its "
            "class or a list, or an id such as 'nmp/Bottles-v0'."
        )


def to_learn_in(env: VecEnv | None, algorithm: str) -> VecEnv:
    """Return the environment of a model.

    :param env: the model's
    :param algorithm: its name, for the message
    :raises ConfigurationError: it has none
    """
    if env is None:
        raise ConfigurationError(
            f"this {algorithm} was loaded without an environment, which learn needs: give "
            f"{algorithm}.load(path, env=env), or model.set_env(env) before."
        )
    return env


def check_spaces(action: gym.Space, observation: gym.Space, algorithm: str) -> None:
    """Raise unless the spaces are those of a trajectory bandit.

    :param action: must have shape (T, D)
    :param observation: must be a box of shape (C,)
    :param algorithm: its name, for the message
    :raises ConfigurationError: they are not
    """
    if not isinstance(action, spaces.Box) or len(action.shape) != 2:
        raise ConfigurationError(
            f"the action space is {action}, of shape {action.shape}; {algorithm} answers with "
            "whole trajectories and needs (T, D): a Box of T time points, D dimensions."
        )
    if not isinstance(observation, spaces.Box) or len(observation.shape) != 1:
        raise ConfigurationError(
            f"the observation space is {observation}; {algorithm} needs a Box of "
            "shape (C,): the context."
        )
    for name, space in (("action", action), ("observation", observation)):
        box = cast(spaces.Box, space)
        if not (np.isfinite(box.low).all() and np.isfinite(box.high).all()):
            raise ConfigurationError(
                f"the {name} space is {box}, which has no bounds; {algorithm} draws and scales "
                "inside finite ones. Say how far values can go: wrap the environment so that its "
                f"{name}_space is a Box with finite low and high."
            )


def check_alike(env: VecEnv, observation: gym.Space, action: gym.Space, n_envs: int) -> None:
    """Raise unless a model can go on in an environment.

    :param env: the new one
    :param observation: the model's space of contexts
    :param action: the model's space of trajectories
    :param n_envs: how many environments the model has
    :raises ConfigurationError: it has other spaces, or is another number of environments
    """
    for name, has, asked in (
        ("observation", env.observation_space, observation),
        ("action", env.action_space, action),
    ):
        if has != asked:
            raise ConfigurationError(
                f"the spaces do not match: the {name} space of env is {has}, and the model's is "
                f"{asked}. Train a new model for another task."
            )
    if env.num_envs != n_envs:
        raise ConfigurationError(
            f"env is {env.num_envs} parallel environments, and the model has {n_envs}; give as "
            "many, or save the model and load it with the new env."
        )


def check_unnormalised(env: VecEnv | None) -> None:
    """Raise if contexts come normalised by statistics that change from episode to episode.

    :param env: any, or None
    :raises ConfigurationError: it is, or wraps, a VecNormalize with ``norm_obs=True``
    """
    normalised = None if env is None else unwrap_vec_normalize(env)
    if normalised is not None and normalised.norm_obs:
        raise ConfigurationError(
            "VecNormalize has norm_obs=True: the same context would look different in each "
            "episode, and one that is asked for could not be sent to reset. Networks and "
            "regressions here scale contexts by themselves: give VecNormalize(env, norm_obs=False)."
        )


def check_ended(dones: NDArray[np.bool_], algorithm: str) -> None:
    """Raise where an episode goes on after its first step.

    :param dones: of each environment after a step
    :param algorithm: its name
    :raises ConfigurationError: one is not over
    """
    if not dones.all():
        raise ConfigurationError(
            f"an episode went on after its first step: {algorithm} is made for trajectory bandits, "
            "where one step executes a whole trajectory and ends the episode."
        )


def rewards_of(env: VecEnv, rewards: FloatArray) -> FloatArray:
    """Return the environments' own rewards, which VecNormalize changes, shape (n,).

    Algorithms compare the rewards of all their rollouts, and VecNormalize's unit changes. They are
    in single precision, as DummyVecEnv keeps them, so that SubprocVecEnv gives the same bits.

    :param env: that was just stepped
    :param rewards: which it returned
    """
    normalised = unwrap_vec_normalize(env)
    if normalised is not None and normalised.norm_reward:
        rewards = cast(FloatArray, normalised.get_original_reward())
    return np.asarray(rewards, np.float32).astype(np.float64)


def rounded_up(value: int, n_envs: int) -> int:
    """Return the least multiple of the number of environments that is at least a number.

    >>> rounded_up(3, 4), rounded_up(8, 4)
    (4, 8)

    :param value: the number
    :param n_envs: of parallel environments
    """
    return -(-value // n_envs) * n_envs


def check_budget(total_timesteps: object, n_envs: int) -> int:
    """Return a budget as a whole number.

    :param total_timesteps: rollouts; a float such as ``1e4`` will do
    :param n_envs: of parallel environments
    :raises ConfigurationError: it is no whole number, or does not allow a single step
    """
    whole = isinstance(total_timesteps, Real) and float(total_timesteps).is_integer()
    if not whole or isinstance(total_timesteps, bool):
        raise ConfigurationError(
            f"total_timesteps is {total_timesteps!r}; it must be a whole number of rollouts."
        )
    budget = int(cast(float, total_timesteps))
    if budget < n_envs:
        raise ConfigurationError(
            f"total_timesteps is {budget}, but one step of {n_envs} parallel "
            f"environments spends {n_envs} rollouts; give at least that."
        )
    return budget


def executable(
    proposed: object, n_envs: int, space: spaces.Box, algorithm: str
) -> NDArray[np.float32]:
    """Return proposed trajectories as environments take them: clipped, float32, shape (n, T, D).

    :param proposed: one trajectory for each environment, shape (n, T, D)
    :param n_envs: n
    :param space: of the actions, shape (T, D)
    :param algorithm: its name, for the message
    :raises AlgorithmContractError: another shape, no array of numbers, or NaN
    """
    shape, found = (n_envs, *space.shape), getattr(proposed, "shape", None)
    if not isinstance(proposed, np.ndarray) or found != shape or proposed.dtype.kind not in "fiu":
        told = f"shape {found} and dtype {getattr(proposed, 'dtype', None)}"
        raise AlgorithmContractError(
            f"{algorithm}._propose returned a {type(proposed).__name__}"
            f"{'' if found is None else f' of {told}'}; it must be an array of numbers of shape "
            f"(n, T, D) = {shape}: a trajectory for each of the members that it is asked for."
        )
    for row in np.flatnonzero(np.isnan(proposed).any(axis=(1, 2)))[:1]:
        first = proposed[row]
        raise AlgorithmContractError(
            f"{algorithm}._propose returned {int(np.isnan(proposed).sum())} NaN: of the {n_envs} "
            f"asked for, rollout {row + 1} is a trajectory of shape {first.shape}, from "
            f"{first.min():.4g} to {first.max():.4g}; let no value become nan."
        )
    return np.clip(proposed, space.low, space.high).astype(np.float32)


def check_multiple(name: str, value: int, n_envs: int) -> None:
    """Raise unless a number of rollouts can be shared out among the environments.

    :param name: of the argument
    :param value: the number
    :param n_envs: of parallel environments
    :raises ConfigurationError: it is not a positive multiple of them
    """
    if value < 1 or value % n_envs:
        raise ConfigurationError(
            f"{name} of {value} does not fit {n_envs} parallel environments: it must be a positive "
            f"multiple of {n_envs}. Change it or n_envs."
        )


def check_scale(name: str, scale: Scale, n_dimensions: int) -> None:
    """Raise unless a standard deviation fits a trajectory.

    :param name: of the argument
    :param scale: one value or one per dimension
    :param n_dimensions: D
    :raises ConfigurationError: it does not
    """
    try:
        values = np.atleast_1d(np.asarray(scale, np.float64))
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape not in ((1,), (n_dimensions,)) or not np.all((values > 0) & (values < np.inf)):
        raise ConfigurationError(
            f"{name} is {scale}; it must be one finite number > 0, or a tuple of {n_dimensions}: "
            "one per dimension of the trajectory."
        )


def check_achieved(achieved: FloatArray | None, space: spaces.Box) -> None:
    """Raise where an achieved context lies outside the space of contexts.

    :param achieved: NaN where nothing was achieved, shape (N, C); None: not told
    :param space: of the contexts
    :raises InvalidDataError: one does
    """
    if achieved is None:
        return
    told = achieved[np.isfinite(achieved).all(axis=1)]
    outside = (told < space.low - 1e-5) | (told > space.high + 1e-5)
    if outside.any():
        row = told[outside.any(axis=1)][0]
        raise InvalidDataError(
            f"info['achieved_context'] is {row.round(6).tolist()}; it must lie within the space of "
            f"contexts, {space.low.tolist()} to {space.high.tolist()}, or be left out."
        )


def check_contexts(contexts: NDArray[np.floating]) -> None:
    """Raise unless what the environments observe is finite.

    :param contexts: one of each environment, shape (n, C)
    :raises InvalidDataError: it is not
    """
    finite = np.isfinite(contexts).all(axis=1)
    if not finite.all():
        number = int(finite.argmin())
        raise InvalidDataError(
            f"environment {number} observed the context {contexts[number].tolist()}; every "
            "number of it must be finite: look at what its reset returns."
        )


def ask_contexts(env: VecEnv, wanted: NDArray[np.float32], algorithm: str) -> NDArray[np.float32]:
    """Reset the environments in given contexts; return these as they are observed, shape (n, C).

    :param env: the environments
    :param wanted: one for each, shape (n, C)
    :param algorithm: its name, for the message
    :raises ConfigurationError: they do not take the reset option ``context``
    :raises InvalidDataError: a context that is not finite
    """
    env.set_options([{"context": context} for context in wanted])
    observed = cast(NDArray[np.float32], env.reset())
    check_contexts(np.asarray(observed))
    if not np.allclose(observed, wanted, atol=1e-5):
        raise ConfigurationError(
            f"{algorithm} asked the environments for the context {wanted[0].tolist()} and got "
            f"{np.asarray(observed)[0].tolist()}: their reset must take options={{'context': c}}, "
            "or pin the context."
        )
    return observed
