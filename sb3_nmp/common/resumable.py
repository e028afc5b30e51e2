"""`ResumableAlgorithm`: a run that was saved and loaded goes on as if nothing had happened."""

import inspect
from typing import Any, Self, cast

import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3.common.base_class import maybe_make_env
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.type_aliases import GymEnv
from stable_baselines3.common.vec_env import VecEnv

from sb3_nmp.common import environment, stream
from sb3_nmp.common.argument_types import check_types
from sb3_nmp.common.arguments import check_names, check_seed
from sb3_nmp.common.exceptions import ConfigurationError, InvalidDataError
from sb3_nmp.common.saving import SafeFiles

#: under which names SB3 keeps arguments
ATTRIBUTES = {"stats_window_size": "_stats_window_size"}
#: whether the user chose a number, which is not rounded up to the environments then
GIVEN = {"population_size": "_population_given", "n_contexts": "_n_contexts_given"}


class ResumableAlgorithm(SafeFiles):
    """Saves with a model where its environments stand in their streams of contexts.

    So a run that was interrupted, and loaded in another process, executes the very rollouts of an
    uninterrupted one, bit for bit, whether the context is pinned or drawn. The environment must
    draw at random in its reset alone, from Gymnasium's ``np_random``; and a replay buffer, which is
    a file of its own as in SB3, must be loaded too.
    """

    #: of the file that the model was loaded from, until `learn` has gone on from there
    _stream: stream.Stream | None = None
    #: whether the user chose a population, which is not rounded up then
    _population_given: bool = False
    #: generators of the environments before their last reset; None where that seeded them
    _before_reset: list[stream.State] | None = None
    #: generators of the environments when `learn` ended
    _standing: list[stream.State] | None = None

    def _reset(self, env: VecEnv) -> NDArray[np.float32]:
        """Reset the environments; return the contexts that they draw, shape (n_envs, C).

        :param env: the environments
        :raises InvalidDataError: a context that is not finite
        """
        self._before_reset = stream.generator_states(env)
        return self._finite(env.reset())

    def _finite(self, observed: object) -> NDArray[np.float32]:
        """Return contexts that environments observe; where one is not finite, they begin anew.

        :param observed: shape (n_envs, C)
        :raises InvalidDataError: a value that is not finite; `learn` can be called again
        """
        contexts = np.array(observed, np.float32)
        try:
            environment.check_contexts(contexts)
        except InvalidDataError:
            self._last_obs = None  # so that SB3 resets
            raise
        return contexts

    def _setup_learn(self, *args: Any, **kwargs: Any) -> tuple[int, BaseCallback]:  # noqa: ANN401
        if self._stream is not None and self.env is not None:
            self._last_obs = stream.resume(self.env, self._stream)
            fits = len(self._stream["now"] or ()) == self.env.num_envs
            self._before_reset = self._stream["before"] if fits else None
            self._stream = None
        waiting = self._last_obs
        ready = super()._setup_learn(*args, **kwargs)
        if self._last_obs is not waiting:  # SB3 has reset the environments
            self._before_reset = None
        return ready

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "_before_reset", "_standing"]

    def save(self, path: Any, *args: Any, **kwargs: Any) -> None:  # noqa: ANN401
        """Write the model to a zip file; see SB3.

        :param path: of the file
        :param args: see SB3
        :param kwargs: see SB3
        """
        loaded = self._stream
        if loaded is None and self.env is not None and self._last_obs is not None:
            closed = getattr(self.env.unwrapped, "closed", False)  # as SubprocVecEnv's are
            now = self._standing if closed else stream.generator_states(self.env)
            self._stream = {"before": self._before_reset, "now": now}
        try:
            super().save(path, *args, **kwargs)
        finally:
            self._stream = loaded

    @classmethod
    def load(
        cls,
        path: Any,  # noqa: ANN401
        env: GymEnv | str | None = None,
        device: th.device | str = "cpu",
        *args: Any,  # noqa: ANN401
        **changes: Any,  # noqa: ANN401
    ) -> Self:
        """Read a model from a zip file; see SB3.

        :param path: of the file
        :param env: to go on in, or the id of one; not needed for `predict`
        :param device: of the policy; the constructor's default
        :param args: see SB3
        :param changes: arguments of SB3's ``load``, and of the constructor those to be changed
        :raises UnknownArgumentError: there is none of that name
        :raises ConfigurationError: one of a wrong type, one that can no longer be changed, or no
            environment
        """
        of_load = inspect.signature(super().load).parameters
        given = {name: value for name, value in changes.items() if name not in of_load}
        check_names(cls, given)
        check_types(cls, given)
        if "seed" in given:
            changes["seed"] = check_seed(given["seed"])
        changes |= {ATTRIBUTES[name]: value for name, value in given.items() if name in ATTRIBUTES}
        changes |= {GIVEN[name]: True for name in given if name in GIVEN}
        environment.check_env(env, needed=False)
        made = cast(GymEnv | None, maybe_make_env(cast(GymEnv, env), 0))
        model = super().load(path, made, device, *args, **changes)
        for name, value in model._made_with().items():
            if given.get(name, value) != value:
                raise ConfigurationError(
                    f"{name} is {given[name]!r}, but the model was made with {value!r}, which can "
                    "no longer be changed: leave it out, or train a new model."
                )
        model._tell_late(given)
        return model

    def _made_with(self) -> dict[str, Any]:
        """Return the constructor's arguments that no loading can change, with their values."""
        return {}

    def _tell_late(self, given: dict[str, Any]) -> None:
        """Tell of arguments that what is under way does not follow; by default, all is followed.

        :param given: what loading changes, by name
        """
