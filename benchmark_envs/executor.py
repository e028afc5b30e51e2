"""The batched MuJoCo executor: many open-loop rollouts in C threads."""

import os
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Any

import mujoco
import numpy as np
from mujoco.rollout import Rollout
from numpy.typing import NDArray

from benchmark_envs.exceptions import TaskError
from benchmark_envs.rollouts import BoolArray, FloatArray

#: rollouts handed to MuJoCo at once: enough to keep the threads busy, few enough to bound memory
CHUNK = 64


def available_cores() -> int:
    """Return the number of cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@dataclass(frozen=True)
class SensorLog:
    """What the sensors read in N rollouts, as `BatchExecutor.run` returns it.

    Readings, peaks and final states of rollouts that diverged are 0, so they need no special care.

    :param readings: by sensor name, shape (N, T, size of the sensor)
    :param peaks: by sensor name, the largest value since the last time point, same shapes
    :param diverged: MuJoCo gave up or a value is not finite, shape (N,)
    :param final_states: full physics states at the end, shape (N, nstate)
    """

    readings: dict[str, FloatArray]
    peaks: dict[str, FloatArray]
    diverged: BoolArray
    final_states: FloatArray


class BatchExecutor:
    """Runs batches of control sequences on one model, with a thread pool that is reused.

    A rollout may have a model of its own, which differs from that one in numbers alone: it has the
    same elements in the same order, and the same time step.

    Threads of a program may share it: they take turns. Every rollout starts with a zero warm-start,
    so its outcome depends neither on the batch it is in nor on the number of threads. A divergence
    shows in the model's ``clock`` sensor: MuJoCo ends a rollout at its first warning and repeats
    the last reading, so its clock stands still.

    >>> from benchmark_envs import make_task
    >>> model = make_task("nmp/Push-v0").model
    >>> executor = BatchExecutor(model, substeps=3, n_threads=1)
    >>> states = np.tile(executor.initial_state(np.zeros(model.nq)), (2, 1))
    >>> log = executor.run(states, controls=np.zeros((2, 30, model.nu)))
    >>> log.readings["joint_1"].shape, log.diverged.tolist()
    ((2, 10, 1), [False, False])

    :param model: must have a sensor of type ``clock`` that is named ``clock``
    :param substeps: simulation steps from one time point to the next
    :param n_threads: of the pool; 0 runs in the calling thread, by default one per core
    :param chunk: rollouts handed to MuJoCo at once; it keeps the state at every step of them all,
        so models with many joints need fewer
    :raises TaskError: ``n_threads`` is no whole number >= 0
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        substeps: int,
        n_threads: int | None = None,
        chunk: int = CHUNK,
    ) -> None:
        if n_threads is not None and not (isinstance(n_threads, Integral) and n_threads >= 0):
            raise TaskError(
                f"n_threads is {n_threads!r}; it must be a whole number >= 0, or None for one per "
                "core."
            )
        self.model = model
        self.substeps = substeps
        self.chunk = chunk
        self.n_threads = available_cores() if n_threads is None else n_threads
        self._pool: Rollout | None = None
        self._data: list[mujoco.MjData] = []
        self._scratch = mujoco.MjData(model)
        self._buffers = [np.empty((0, 0, 0)), np.empty((0, 0, 0))]
        self._turn = threading.RLock()  # of who uses the scratch memory, which MuJoCo fills

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process or a copy needs: threads and scratch memory are made anew."""
        return {name: getattr(self, name) for name in ("model", "substeps", "chunk", "n_threads")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over what `__getstate__` returned.

        :param state: by the names of the constructor's arguments
        """
        BatchExecutor.__init__(self, **state)

    def _reserve(self, n: int, steps: int, n_states: int) -> list[FloatArray]:
        """Return room for states and readings, the same as before where it is large enough.

        New memory for every chunk costs pick-and-place 6 % of its time.
        """
        for i, width in enumerate((n_states, self.model.nsensordata)):
            if self._buffers[i].shape[1:] != (steps, width) or len(self._buffers[i]) < n:
                self._buffers[i] = np.empty((n, steps, width))
        return [buffer[:n] for buffer in self._buffers]

    def _rollout(
        self, states: FloatArray, controls: FloatArray, models: Sequence[mujoco.MjModel] | None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the physics states and sensor readings at every step, (N, T * substeps, *).

        They are overwritten by the next call.
        """
        if self._pool is None:
            self._pool = Rollout(nthread=self.n_threads if self.n_threads > 1 else 0)
            self._data = [mujoco.MjData(self.model) for _ in range(max(1, self.n_threads))]
        model = self.model if models is None else list(models)
        states_out, sensors = self._reserve(len(states), controls.shape[1], states.shape[1])
        self._pool.rollout(
            model, self._data, states, controls, state=states_out, sensordata=sensors
        )
        return states_out, sensors

    def run(
        self,
        states: FloatArray,
        controls: FloatArray,
        models: Sequence[mujoco.MjModel] | None = None,
    ) -> SensorLog:
        """Run N rollouts.

        :param states: initial full physics states (`initial_state`), shape (N, nstate)
        :param controls: for every simulation step, shape (N, T * substeps, nu)
        :param models: one for each rollout, length N; None: the executor's model for all
        """
        logs: list[SensorLog] = []
        for i in range(0, len(states), self.chunk):
            chunk = slice(i, i + self.chunk)
            own = None if models is None else models[chunk]
            with self._turn:
                logs.append(self._log(*self._rollout(states[chunk], controls[chunk], own)))
        names = logs[0].readings
        return SensorLog(
            readings={name: np.concatenate([log.readings[name] for log in logs]) for name in names},
            peaks={name: np.concatenate([log.peaks[name] for log in logs]) for name in names},
            diverged=np.concatenate([log.diverged for log in logs]),
            final_states=np.concatenate([log.final_states for log in logs]),
        )

    def initial_state(self, qpos: FloatArray) -> FloatArray:
        """Return the full physics state, at rest, for given joint positions.

        :param qpos: shape (nq,)
        :return: shape (nstate,)
        """
        full = mujoco.mjtState.mjSTATE_FULLPHYSICS
        state = np.empty(mujoco.mj_stateSize(self.model, full))
        with self._turn:
            mujoco.mj_resetData(self.model, self._scratch)
            self._scratch.qpos[:] = qpos
            mujoco.mj_getState(self.model, self._scratch, state, full)
        return state

    def states(
        self, state: FloatArray, controls: FloatArray, model: mujoco.MjModel | None = None
    ) -> FloatArray:
        """Run one rollout and return its full physics states at the time points.

        :param state: shape (nstate,)
        :param controls: shape (T * substeps, nu)
        :param model: of this rollout; None: the executor's
        :return: shape (T, nstate)
        """
        own = None if model is None else [model]
        with self._turn:
            every_step = self._rollout(state[None], controls[None], own)[0][0]
            return every_step[self.substeps - 1 :: self.substeps].copy()

    def _log(self, states: NDArray[np.float64], data: NDArray[np.float64]) -> SensorLog:
        n, steps, _ = data.shape
        end = states[:, -1].copy()
        broken = ~np.isfinite(data).all(axis=(1, 2)) | ~np.isfinite(end).all(axis=1)
        diverged = broken | self._stopped(data)
        data[diverged], end[diverged] = 0.0, 0.0
        blocks = data.reshape(n, steps // self.substeps, self.substeps, -1)
        last, peak = blocks[:, :, -1].copy(), blocks.max(axis=2)
        readings: dict[str, FloatArray] = {}
        peaks: dict[str, FloatArray] = {}
        for i in range(self.model.nsensor):
            sensor = self.model.sensor(i)
            columns = slice(int(sensor.adr[0]), int(sensor.adr[0] + sensor.dim[0]))
            readings[sensor.name], peaks[sensor.name] = last[:, :, columns], peak[:, :, columns]
        return SensorLog(readings, peaks, diverged, end)

    def _stopped(self, data: FloatArray) -> BoolArray:
        """Tell which rollouts ended early, by the clock's last reading, shape (N,).

        :param data: all sensors' readings, shape (N, steps, number of readings)
        """
        clock = data[:, -1, int(self.model.sensor("clock").adr[0])]
        return ~(clock >= (data.shape[1] - 1.5) * self.model.opt.timestep)
