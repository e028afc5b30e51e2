"""The bases of all policies that answer a context with a whole trajectory."""

import warnings
from abc import abstractmethod
from typing import Any, Self, cast

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import PyTorchObs
from stable_baselines3.common.utils import ConstantSchedule, get_device

from sb3_nmp.common import files
from sb3_nmp.common.elites import EliteMemory
from sb3_nmp.common.exceptions import (
    ConfigurationError,
    ContextWarning,
    InvalidDataError,
    UnsafeFileError,
)
from sb3_nmp.common.repertoire import Repertoire
from sb3_nmp.common.shown import ShownDemonstrations


class TrajectoryPolicy(BasePolicy):
    """SB3 policy whose observation is a context (C,) and whose action is a trajectory (T, D)."""

    @property
    def trajectory_shape(self) -> tuple[int, int]:
        """Return (T, D)."""
        n_time_points, n_dimensions = cast(spaces.Box, self.action_space).shape
        return n_time_points, n_dimensions

    @property
    def context_dim(self) -> int:
        """Return C."""
        return cast(spaces.Box, self.observation_space).shape[0]

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {
            "observation_space": self.observation_space,
            "action_space": self.action_space,
            "lr_schedule": ConstantSchedule(0.0),  # a loaded policy is not trained further
        }

    def save(self, path: files.AnyPath) -> None:
        """Write the policy without the algorithm; see SB3.

        :param path: of the file, or an open one
        """
        parts = {"data": self._get_constructor_parameters(), "state": self.state_dict()}
        files.write(path, "policy", parts)

    @classmethod
    def load(
        cls,
        path: files.AnyPath,
        device: th.device | str = "auto",
        *,
        allow_pickle: bool = False,
    ) -> Self:
        """Read a policy; see SB3. No code from the file is run.

        :param path: of a file that `save` wrote, or an open one
        :param device: of the policy
        :param allow_pickle: read files with pickles too, which **can run any code**
        :raises UnsafeFileError: the file holds pickles, and ``allow_pickle`` is False
        :raises FileFormatError: it is no policy, or damaged
        """
        try:
            saved = files.read(path, "policy", allow_pickle=allow_pickle)
        except UnsafeFileError:
            if not allow_pickle:
                raise
            return super().load(path, device)  # pyright: ignore[reportArgumentType]
        policy = cls(**saved["data"])
        policy.load_state_dict(saved["state"])
        return policy.to(get_device(device))

    @property
    def answers_by_network(self) -> bool:
        """Whether its greedy answers are PyTorch from contexts to trajectories, as ONNX needs."""
        return False

    def own_answer(self, contexts: NDArray[np.floating]) -> NDArray[np.float64] | None:
        """Return what was learned, without any rollout remembered, inside the space, (N, T, D).

        It is what a search leaves in the model itself. Where the greedy answer is a remembered
        rollout, the two differ.

        :param contexts: shape (N, C), or (C,) for one
        :return: None where there is no model, or where it has learned nothing
        :raises InvalidDataError: contexts of another shape, or not finite
        """
        with th.no_grad():
            answered = self._learned(self._rows(contexts))
        return None if answered is None else self._inside(answered)

    def _learned(self, contexts: th.Tensor) -> th.Tensor | None:
        """Return the model's greedy answers, shape (N, T, D); None, the default, where none is.

        :param contexts: shape (N, C)
        """
        return None

    def _rows(self, contexts: NDArray[np.floating]) -> th.Tensor:
        return th.tensor(self._checked_contexts(contexts), device=self.device)

    def _inside(self, trajectories: th.Tensor) -> NDArray[np.float64]:
        space = cast(spaces.Box, self.action_space)
        return np.clip(trajectories.cpu().numpy(), space.low, space.high).astype(np.float64)

    def obs_to_tensor(
        self, observation: NDArray[Any] | dict[str, NDArray[Any]]
    ) -> tuple[PyTorchObs, bool]:
        """Return the contexts that `predict` was asked, and whether these are several; see SB3.

        A `ContextWarning` tells of contexts outside the observation space.

        :param observation: context of shape (C,), or (N, C), of any precision
        :return: float32, shape (N, C)
        :raises InvalidDataError: no numbers, another shape, or a value that is not finite
        """
        rows = self._checked_contexts(observation)
        self._warn_of_contexts(rows)
        observed, vectorized = super().obs_to_tensor(np.asarray(observation))
        return cast(th.Tensor, observed).float(), vectorized

    def _checked_contexts(self, contexts: object) -> NDArray[np.float32]:
        """Return contexts as rows, shape (N, C).

        :param contexts: shape (C,), or (N, C), of any precision
        :raises InvalidDataError: no numbers, another shape, or a value that is not finite
        """
        given = np.asarray(contexts)
        shapes = ((self.context_dim,), (*given.shape[:1], self.context_dim))
        if given.dtype.kind not in "fiub" or given.shape not in shapes:
            raise InvalidDataError(
                f"the context is {contexts!r}, of shape {given.shape}; it must be numbers of "
                f"shape (C,) or (N, C), where C is {self.context_dim}."
            )
        if len(given) == 0:
            raise InvalidDataError("no context was given: the array has no rows.")
        with np.errstate(over="ignore"):  # told below
            rows = given.astype(np.float32).reshape(-1, self.context_dim)
        finite = np.isfinite(rows).all(axis=1)
        if not finite.all():
            raise InvalidDataError(
                f"context {rows[finite.argmin()].tolist()} holds a value that is not finite; give "
                f"{self.context_dim} finite numbers."
            )
        return rows

    def _warn_of_contexts(self, rows: NDArray[np.float32]) -> None:
        """Warn, once, where contexts, shape (N, C), lie outside the observation space."""
        space = cast(spaces.Box, self.observation_space)
        low, high = (bound.astype(np.float32) for bound in (space.low, space.high))
        outside = ~((rows >= low) & (rows <= high))
        if outside.any():
            row, dimension = np.argwhere(outside)[0]
            n_outside = int(outside.any(axis=1).sum())
            others = "" if n_outside == 1 else f" ({n_outside} of {len(rows)} contexts are outside)"
            warnings.warn(
                f"context {rows[row].tolist()} has {rows[row, dimension]:.4g} in dimension "
                f"{dimension}, outside the observation space's {space.low[dimension]:.4g} to "
                f"{space.high[dimension]:.4g}: the answer is an extrapolation{others}.",
                ContextWarning,
                stacklevel=5,
            )

    def forward(self, observation: PyTorchObs, deterministic: bool = False) -> th.Tensor:
        """Return a trajectory for each context, shape (N, T, D).

        :param observation: contexts, shape (N, C)
        :param deterministic: the greedy trajectory instead of a sample
        """
        return self._predict(observation, deterministic)


class ElitePolicy(TrajectoryPolicy):
    """Answers a context with the best trajectory seen in it, else with what it generalises to.

    A trajectory that achieved the context when another one was asked for counts as seen in it.

    :param observation_space: contexts, shape (C,)
    :param action_space: trajectories, shape (T, D)
    """

    def __init__(self, observation_space: spaces.Box, action_space: spaces.Box) -> None:
        super().__init__(observation_space, action_space)
        self.elites = EliteMemory(self.context_dim, self.trajectory_shape)
        self.ways = EliteMemory(1, self.trajectory_shape)  # by number instead of context
        self.repertoire = Repertoire(self.context_dim, self.trajectory_shape)
        self.shown = ShownDemonstrations(self.context_dim, self.trajectory_shape)

    @abstractmethod
    def generalise(self, contexts: th.Tensor, deterministic: bool = True) -> th.Tensor:
        """Return the learned trajectory for each context, shape (N, T, D).

        :param contexts: shape (N, C)
        :param deterministic: the mean instead of a sample
        """

    def _learned(self, contexts: th.Tensor) -> th.Tensor | None:
        return self.generalise(contexts)

    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> th.Tensor:
        contexts = cast(th.Tensor, observation)
        trajectories = self.generalise(contexts, deterministic)
        if deterministic:
            known = self.repertoire.find(contexts)
            trajectories[known >= 0] = self.repertoire.trajectories[known[known >= 0]]
            for row, context in enumerate(contexts):
                elite = self.elites.find(context)
                if elite is not None and self._may_answer(elite):
                    trajectories[row] = self.elites.trajectories[elite]
        return trajectories

    def modes(
        self, contexts: NDArray[np.floating]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the best trajectory of each mode found (N, K, T, D), and its reward (N, K).

        The first one found comes first; `predict` answers with the best. They are of the one
        context that was pinned in training, and are returned for each context that is asked.

        :param contexts: shape (N, C), or (C,) for one
        :raises ConfigurationError: no modes were looked for, or none has been found yet
        :raises InvalidDataError: contexts of another shape, or not finite
        """
        n_found = len(self.ways.rewards)
        if n_found == 0:
            raise ConfigurationError(
                "no modes are known: train with n_modes above 1, until a rollout succeeds."
            )
        order = self.ways.contexts[:, 0].argsort().cpu()
        trajectories = self.ways.trajectories.cpu().numpy()[order].astype(np.float64)
        shape = (len(self._checked_contexts(contexts)), n_found)
        return (
            np.broadcast_to(trajectories, (*shape, *self.trajectory_shape)).copy(),
            np.broadcast_to(self.ways.rewards.cpu().numpy()[order], shape).copy(),
        )

    def _may_answer(self, elite: int) -> bool:
        """Return whether a remembered trajectory goes before what has been learned."""
        return True

    def greedy(self, contexts: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the greedy trajectories inside the action space, shape (N, T, D).

        :param contexts: shape (N, C), or (C,) for one
        :raises InvalidDataError: contexts of another shape, or not finite
        """
        with th.no_grad():
            return self._inside(self._predict(self._rows(contexts), deterministic=True))
