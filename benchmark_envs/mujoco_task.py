"""`MujocoTask`: a task whose rollouts MuJoCo simulates, a batch at a time."""

from abc import abstractmethod
from dataclasses import replace
from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark_envs.executor import CHUNK, BatchExecutor, SensorLog
from benchmark_envs.rendering import draw
from benchmark_envs.rollouts import FloatArray, Measured
from benchmark_envs.task import Task


class MujocoTask(Task):
    """A robot in a MuJoCo model that follows set-points.

    A subclass says how a rollout begins (`_initial_state`), what the actuators are commanded
    (`_controls`), and what the sensors tell about it (`_measure`). Where the model depends on the
    context or the robot has a speed limit, it overrides `_model` or `_follow`.

    >>> from benchmark_envs import make_task
    >>> task = make_task("nmp/Push-v0", reward="goal", n_threads=1)
    >>> target = task.targets[4]
    >>> rollouts = task.simulate(target, task.demonstrate(target))
    >>> rollouts.paths["object"].shape, bool(rollouts.successes[0])
    ((1, 300, 2), True)

    :param model: has a sensor of type ``clock`` that is named ``clock``
    :param substeps: simulation steps from one time point to the next
    :param n_threads: of the simulator; by default one per core
    :param chunk: rollouts that MuJoCo is handed at once
    """

    #: the camera of `frames`
    camera: ClassVar[str] = "overview"
    #: time points from one picture of `frames` to the next
    frame_every: ClassVar[float]

    def __init__(
        self,
        model: mujoco.MjModel,
        substeps: int,
        n_threads: int | None = None,
        chunk: int = CHUNK,
    ) -> None:
        self.model = model
        self.executor = BatchExecutor(model, substeps, n_threads, chunk)
        self.dt = substeps * float(model.opt.timestep)

    @property
    def frames_per_second(self) -> float:
        """At how many pictures a second the film of `frames` is as fast as the rollout."""
        return 1.0 / (self.dt * self.frame_every)

    @abstractmethod
    def _initial_state(self, context: FloatArray) -> FloatArray:
        """Return the full physics state at the start, shape (nstate,).

        :param context: shape (C,)
        """

    @abstractmethod
    def _controls(self, contexts: FloatArray, followed: FloatArray) -> FloatArray:
        """Return what the actuators are commanded, shape (N, steps, nu).

        There are ``substeps`` steps per time point, and there may be time points after the last
        set-point.

        :param contexts: shape (N, C)
        :param followed: set-points, shape (N, T, D)
        """

    @abstractmethod
    def _measure(self, contexts: FloatArray, trajectories: FloatArray, log: SensorLog) -> Measured:
        """Return what the sensors tell; divergence and clipping are added by the caller.

        :param contexts: shape (N, C)
        :param trajectories: the set-points as they were wanted, shape (N, T, D)
        :param log: the sensors' readings, 0 in rollouts that diverged
        """

    def _model(self, context: FloatArray) -> mujoco.MjModel:
        """Return the model for a context, by default the same for all.

        :param context: shape (C,)
        """
        return self.model

    def _follow(self, trajectories: FloatArray) -> FloatArray:
        """Return the set-points that the robot can follow, by default all, shape (N, T, D).

        :param trajectories: shape (N, T, D)
        """
        return trajectories

    def _drawn(self, context: FloatArray, states: FloatArray) -> tuple[mujoco.MjModel, FloatArray]:
        """Return the model and the states to draw, by default those of the simulation.

        :param context: shape (C,)
        :param states: full physics states, shape (K, nstate)
        """
        return self._model(context), states

    def _run(self, contexts: FloatArray, followed: FloatArray) -> SensorLog:
        """Simulate set-points that the robot can follow.

        :param contexts: shape (N, C)
        :param followed: shape (N, T, D)
        """
        unique, which = np.unique(contexts, axis=0, return_inverse=True)
        states = np.stack([self._initial_state(context) for context in unique])[which]
        models = [self._model(context) for context in unique]
        alike = all(model is self.model for model in models)
        own = None if alike else [models[i] for i in which]
        return self.executor.run(states, self._controls(contexts, followed), own)

    def _execute(self, contexts: FloatArray, trajectories: FloatArray) -> Measured:
        followed = self._follow(trajectories)
        log = self._run(contexts, followed)
        return replace(
            self._measure(contexts, trajectories, log),
            diverged=log.diverged,
            clipped=np.any(followed != trajectories, axis=(1, 2)),
        )

    def frames(
        self,
        context: ArrayLike,
        trajectory: ArrayLike,
        width: int = 480,
        height: int = 360,
        camera: str | None = None,
    ) -> list[NDArray[np.uint8]]:
        """Run one rollout and draw a picture every ``frame_every`` time points.

        :param context: shape (C,)
        :param trajectory: shape (T, D)
        :param width: of the picture, in pixels
        :param height: of the picture, in pixels
        :param camera: its name in the model; by default the task's ``camera``
        :return: pictures of shape (height, width, 3)
        :raises RenderingUnavailableError: no off-screen renderer on this machine
        :raises TaskError: no such camera, or a picture of no size
        """
        contexts = self.check_context(context)[None]
        low, high = self.trajectory_space.low, self.trajectory_space.high
        followed = self._follow(np.clip(self.check_trajectories(trajectory), low, high))
        controls = self._controls(contexts, followed)[0]
        begin, model = self._initial_state(contexts[0]), self._model(contexts[0])
        states = self.executor.states(begin, controls, model)
        shown = np.arange(self.frame_every - 1, len(states), self.frame_every).astype(int)
        model, drawn = self._drawn(contexts[0], states[shown])
        return draw(model, drawn, camera or self.camera, width, height)

    def first_frame(
        self, context: ArrayLike, width: int = 480, height: int = 360
    ) -> NDArray[np.uint8]:
        """Draw how a rollout begins, shape (height, width, 3).

        :param context: shape (C,)
        :param width: of the picture, in pixels
        :param height: of the picture, in pixels
        :raises RenderingUnavailableError: no off-screen renderer on this machine
        """
        checked = self.check_context(context)
        model, drawn = self._drawn(checked, self._initial_state(checked)[None])
        return draw(model, drawn, self.camera, width, height)[0]
