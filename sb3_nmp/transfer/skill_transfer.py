"""`SkillTransfer`: what one robot shows becomes a trajectory of another (thesis 5.1, Fig. 5.2)."""

from collections.abc import Callable
from typing import Any, Literal, Self, get_args, overload

import numpy as np
import torch as th
from numpy.typing import ArrayLike, NDArray

from sb3_nmp.common import files
from sb3_nmp.common.argument_types import check_types
from sb3_nmp.common.arguments import check_seed
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.exceptions import ConfigurationError, InvalidDataError
from sb3_nmp.common.finite_arrays import finite_array, numbers
from sb3_nmp.models.cnmp import CNMP, CNMPArchitecture
from sb3_nmp.transfer.proxy_skills import ProxySkills
from sb3_nmp.transfer.settings import TransferTraining
from sb3_nmp.transfer.training import MomentSampler, PairSampler, train_pair

Robot = Literal["source", "target"]
#: what a point of the latent space stands for
Shared = Literal["skill", "moment"]

FILE_KIND = "skill transfer"


class SkillTransfer:
    """Two CNMPs with one latent space, learned from proxy skills that both robots were shown.

    Each robot has an encoder and a decoder of its own. Both learn their robot's demonstrations
    (Eq. 4.1), and the representations of the same skill are drawn together (Eq. 5.4). A trajectory
    that only one robot can show is encoded by its own encoder and decoded by the other's decoder.
    The robots may differ in joints and time points, and any number of conditioning points is
    taken. As in the thesis, task parameters take no part: a context only says which skill a row
    is. From the translation, the target robot's ACNMP learns the skill: it is a set of
    demonstrations for its own environment.

    By default a point of the latent space is a whole skill, as in the thesis: the mean over the
    conditioning points. With ``shared="moment"`` it is a moment of one: each point of a trajectory
    is encoded, and decoded at the same time, by itself. Where both robots move in step, as where
    one path is followed by both, this is far more exact, and translates skills unlike the proxies,
    whose moments they share. Where each robot moves at a pace of its own, moments of the same time
    belong together less, and it translates about as well as by whole skills.

    Where this departs from the thesis: each network is an ensemble of five by default, trained on
    batches; the decoders have a linear trend and see time as waves (`CNMPArchitecture`); the
    weight of the distance is for data in units of their own spread (``results/experiments/
    transfer.md`` has the measurements).

    >>> import numpy as np
    >>> heights = np.linspace(-1, 1, 6)[:, None, None]
    >>> short, long = np.linspace(0, 1, 20)[:, None], np.linspace(0, 1, 50)[:, None]
    >>> one = Demonstrations(heights[:, 0], heights * short)  # a joint, 20 time points
    >>> two = Demonstrations(heights[:, 0], heights * np.hstack([long, -long]))  # 2 joints, 50
    >>> transfer = SkillTransfer(one, two, training=TransferTraining(n_steps=50), seed=0).fit()
    >>> transfer.translate(0.5 * short).shape
    (50, 2)

    :param source: proxy skills shown by one robot; its trajectories have shape (T, D)
    :param target: the same skills shown by the other, in the same order
    :param architecture: of both networks; None: the preset ``"latent"``, or ``"moment"``
    :param training: how they are trained; None: by the defaults, or the preset ``"moment"``
    :param seed: of first weights and batches; None draws one
    :param shared: what a point of the latent space stands for: ``"skill"`` or ``"moment"``
    :raises ConfigurationError: ``source`` or ``target`` is no `Demonstrations`, ``shared`` is
        neither, or architecture, training or seed are none
    :raises InvalidDataError: the robots show different skills, or in another order, or a skill of
        one robot only
    """

    def __init__(
        self,
        source: Demonstrations,
        target: Demonstrations,
        *,
        architecture: CNMPArchitecture | None = None,
        training: TransferTraining | None = None,
        seed: int | None = None,
        shared: Shared = "skill",
    ) -> None:
        if shared not in get_args(Shared):
            raise ConfigurationError(f"shared is {shared!r}; it must be 'skill' or 'moment'.")
        check_types(type(self), {"architecture": architecture, "training": training})
        self.shared: Shared = shared
        self.skills: ProxySkills | None = ProxySkills(source, target)
        of_moments = shared == "moment"
        usual = TransferTraining.preset("moment") if of_moments else TransferTraining()
        architecture = architecture or CNMPArchitecture.preset("moment" if of_moments else "latent")
        self.architecture, self.training, self.seed = architecture, training or usual, seed
        self.rng = np.random.default_rng(check_seed(seed))
        first_weights = int(self.rng.integers(2**31))
        self._networks = _networks(
            (source.trajectory_shape, target.trajectory_shape), architecture, first_weights
        )
        self.is_fitted = False

    @property
    def source_network(self) -> CNMP:
        """The source robot's CNMP."""
        return self._networks[0]

    @property
    def target_network(self) -> CNMP:
        """The target robot's CNMP."""
        return self._networks[1]

    def fit(self, watch: Callable[[int], None] | None = None) -> Self:
        """Train both networks on the proxy skills (Eq. 5.4); a second call goes on.

        :param watch: is told the number of steps that are done, from 0 on, and may `encode`,
            `decode` and `translate` by what has been learned until then
        :raises ConfigurationError: it was loaded, so its demonstrations are not at hand
        """
        if self.skills is None:
            raise ConfigurationError(
                "a saved SkillTransfer does not hold its demonstrations and cannot be trained "
                "further; make a new one with SkillTransfer(source, target)."
            )
        if watch is not None and not callable(watch):
            raise ConfigurationError(
                f"watch is {watch!r}; it must be a function that takes the number of steps."
            )
        robots = []
        for cnmp, shown in zip(
            self._networks, (self.skills.source, self.skills.target), strict=True
        ):
            cnmp.set_scale(Demonstrations(np.zeros((len(shown), 1)), shown.trajectories))
            values = cnmp.normalise(cnmp.times.new_tensor(shown.trajectories))
            robots.append((cnmp.train(), values))
        self.is_fitted = True  # as far as it is, for whoever watches
        kind = MomentSampler if self.shared == "moment" else PairSampler
        sampler = kind(self.training, robots, self.rng)
        train_pair(self._networks, sampler, self.training, watch)
        for cnmp in self._networks:
            cnmp.train(False)
        return self

    # -- translation ---------------------------------------------------------------------------

    def encode(
        self, trajectories: ArrayLike, times: ArrayLike | None = None, robot: Robot = "source"
    ) -> NDArray[np.float64]:
        """Return where trajectories lie in the shared latent space.

        :param trajectories: shape (N, O, D) or (O, D), in the robot's unit: O conditioning points
        :param times: of these points in [0, 1], shape (O,); equally spaced by default
        :param robot: whose trajectories they are
        :return: shape (N, E * Z); of moments, one for each point: (N, O, E * Z)
        :raises ConfigurationError: `fit` has not been called, or no such robot
        :raises InvalidDataError: a wrong shape, a value that is not finite, a time outside [0, 1]
        """
        cnmp = self._network(robot)
        values, at = _points(trajectories, times, cnmp, robot)
        n, n_points = values.shape[:2]
        if self.shared == "moment":  # each point is a set of its own
            values, at = values.reshape(n * n_points, 1, -1), np.tile(at, n)[:, None]
        shape = values.shape[:2]
        with th.no_grad():
            code = cnmp.network.encode(
                cnmp.times.new_tensor(at).expand(shape),
                cnmp.normalise(cnmp.times.new_tensor(values)),
                cnmp.times.new_zeros((len(values), 1)),
                cnmp.times.new_ones(shape),
            )
        found = code.numpy().astype(np.float64)
        return found.reshape(n, n_points, -1) if self.shared == "moment" else found

    def decode(self, latents: ArrayLike, robot: Robot = "target") -> NDArray[np.float64]:
        """Return a robot's trajectories for points of the latent space, shape (N, T, D).

        :param latents: shape (N, E * Z), as `encode` returns them; of moments, one for each of the
            robot's time points: (N, T, E * Z)
        :param robot: whose trajectories are wanted
        :raises ConfigurationError: `fit` has not been called, or no such robot
        :raises InvalidDataError: a wrong shape, a value that is not finite, or moments that are not
            as many as the robot's time points
        """
        cnmp = self._network(robot)
        code = cnmp.times.new_tensor(self._latents(latents))
        with th.no_grad():
            if self.shared == "skill":
                decoded = cnmp.mean(code.new_zeros((len(code), 1)), code)
            else:
                decoded = _decoded_moments(code, cnmp, robot)
        return decoded.numpy().astype(np.float64)

    @overload
    def translate(
        self, shown: Demonstrations, times: ArrayLike | None = None, *, to: Robot = "target"
    ) -> Demonstrations: ...
    @overload
    def translate(
        self, shown: ArrayLike, times: ArrayLike | None = None, *, to: Robot = "target"
    ) -> NDArray[np.float64]: ...
    def translate(
        self,
        shown: Demonstrations | ArrayLike,
        times: ArrayLike | None = None,
        *,
        to: Robot = "target",
    ) -> Demonstrations | NDArray[np.float64]:
        """Return what one robot showed as trajectories of the other.

        :param shown: shape (N, O, D) or (O, D); or `Demonstrations`, whose contexts are kept. Of
            moments, what lies between the points is interpolated
        :param times: of the O points in [0, 1], shape (O,); equally spaced by default
        :param to: the robot that is to move; the other one has shown
        :return: shape (N, T, D), or (T, D) for one; or `Demonstrations` for these
        :raises ConfigurationError: `fit` has not been called, or no such robot
        :raises InvalidDataError: a wrong shape, a value that is not finite, a time outside [0, 1]
        """
        if to not in get_args(Robot):
            raise ConfigurationError(f"to is {to!r}; it must be 'source' or 'target'.")
        by: Robot = "source" if to == "target" else "target"
        given = shown.trajectories if isinstance(shown, Demonstrations) else shown
        values, at = _points(given, times, self._network(by), by)
        if self.shared == "moment":
            asked = self._network(to).times.numpy().astype(np.float64)
            values, at = _interpolated(values, at, asked), asked
        found = self.decode(self.encode(values, at, by), to)
        if isinstance(shown, Demonstrations):
            return Demonstrations(shown.contexts, found)
        return found[0] if np.ndim(shown) == 2 else found

    def _latents(self, latents: ArrayLike) -> NDArray[np.float64]:
        """Return points of the latent space, checked."""
        width = self.architecture.n_members * self.architecture.representation_dim
        needed, n = (f"(N, {width})", 2) if self.shared == "skill" else (f"(N, T, {width})", 3)
        found = finite_array("latents", latents, needed, n)
        if found.shape[-1] != width:
            raise InvalidDataError(
                f"the latents have shape {found.shape}; they need {needed}, as encode returns them."
            )
        return found

    def _network(self, robot: Robot) -> CNMP:
        if robot not in get_args(Robot):
            raise ConfigurationError(f"robot is {robot!r}; it must be 'source' or 'target'.")
        if not self.is_fitted:
            raise ConfigurationError(
                "the networks have not been trained; call fit() first, which takes seconds."
            )
        return self._networks[get_args(Robot).index(robot)]

    # -- files ---------------------------------------------------------------------------------

    def save(self, path: files.AnyPath) -> None:
        """Write the trained networks to a file; the demonstrations are not in it.

        :param path: of the file, or an open one
        :raises ConfigurationError: `fit` has not been called
        """
        self._network("source")
        settings = {
            "architecture": self.architecture,
            "training": self.training,
            "shared": self.shared,
            "shapes": [(len(n.times), len(n.value_mean)) for n in self._networks],
        }
        weights = {
            robot: cnmp.state_dict()
            for robot, cnmp in zip(get_args(Robot), self._networks, strict=True)
        }
        files.write(path, FILE_KIND, {"settings": settings, "weights": weights})

    @classmethod
    def load(cls, path: files.AnyPath) -> "SkillTransfer":
        """Read what `save` wrote; it can translate, but not be trained further.

        :param path: of the file, or an open one. No code from it is run
        :raises FileFormatError: it is not such a file
        """
        saved = files.read(path, FILE_KIND)
        settings = saved["settings"]
        made = cls.__new__(cls)
        made.skills, made.seed, made.rng = None, None, np.random.default_rng()
        made.architecture, made.training = settings["architecture"], settings["training"]
        made.shared = settings.get("shared", "skill")  # older files have none
        made._networks = _networks(settings["shapes"], made.architecture, 0)
        for robot, cnmp in zip(get_args(Robot), made._networks, strict=True):
            cnmp.load_state_dict(saved["weights"][robot])
            cnmp.train(False)
        made.is_fitted = True
        return made


def _networks(shapes: Any, architecture: CNMPArchitecture, seed: int) -> tuple[CNMP, CNMP]:  # noqa: ANN401
    """Return two new networks; PyTorch's own generator is left as it was."""
    with th.random.fork_rng(devices=[]):
        th.manual_seed(seed)
        source, target = (CNMP(1, tuple(shape), architecture) for shape in shapes)
    return source, target


def _decoded_moments(code: th.Tensor, cnmp: CNMP, robot: Robot) -> th.Tensor:
    """Return what moments decode to, each at its own time, shape (N, T, D)."""
    n_points = len(cnmp.times)
    if code.shape[1] != n_points:
        raise InvalidDataError(
            f"latents have shape {tuple(code.shape)}; of moments there must be one for each of the "
            f"{robot} robot's {n_points} time points: (N, {n_points}, E * Z)."
        )
    flat = code.flatten(0, 1)
    times = cnmp.times.repeat(len(code))[:, None]
    found = cnmp.network.decode(times, flat, flat.new_zeros((len(flat), 1))).mean
    return (found * cnmp.value_std + cnmp.value_mean).view(len(code), n_points, -1)


def _interpolated(
    values: NDArray[np.float64], times: NDArray[np.float64], asked: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return points (N, O, D) at other times, linearly interpolated, shape (N, T, D)."""
    order = np.argsort(times, kind="stable")
    return np.stack(
        [[np.interp(asked, times[order], joint[order]) for joint in each.T] for each in values]
    ).transpose(0, 2, 1)


def _points(
    trajectories: ArrayLike, times: ArrayLike | None, cnmp: CNMP, robot: Robot
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return conditioning points, shape (N, O, D), and their times, shape (O,), checked."""
    values = numbers("trajectories", trajectories)
    values = values[None] if values.ndim == 2 else values
    n_joints = len(cnmp.value_mean)
    if values.ndim != 3 or values.shape[2] != n_joints or 0 in values.shape:
        raise InvalidDataError(
            f"the {robot} robot's trajectories have shape (N, T, {n_joints}) or (T, {n_joints}), "
            f"not {np.shape(trajectories)}."
        )
    if not np.isfinite(values).all():
        raise InvalidDataError("the trajectories hold a value that is not finite.")
    n = values.shape[1]
    at = np.linspace(0.0, 1.0, n) if times is None else numbers("times", times)
    if at.shape != (n,) or not ((at >= 0) & (at <= 1)).all():
        raise InvalidDataError(
            f"times has shape {at.shape}; it must be {n} times in [0, 1], one for each point."
        )
    return values, at
