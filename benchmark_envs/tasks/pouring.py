"""`nmp/Pouring-v1`: a wrist tilts a cup of marbles to pour some of them (thesis 5.2.4).

The thesis did this on a UR10: 16 demonstrations of cups that held 850 to 950 g, then the task to
pour 1322 of 1400 g. The CNMP's first answer was wrong by 591 g, ACNMP's after 18 rollouts by 27 g.

The demonstrated amounts to pour were not published. Here they are 150 to 600 g, a sixth to two
thirds of the content, all poured in the same time by peaks of 77 to 89 degrees. What makes the
extrapolation hard is the cup alone. Among the demonstrations a larger amount needs more tilt, and
a fuller cup less for the same amount. A CNMP that goes on like this lets the second outweigh the
first and answers the thesis's task with some 84 degrees (75 to 97), where 95 are needed: a cup must
be tilted beyond the horizontal to give its last marbles, however many they were. ACNMP's first
answer there was wrong by 612 g (median of 10 seeds), nearly always too little, before its network
began as a regression, and is by 162 g (worst 202) since.
Demonstrations of 100 to 400 g alone make the answers vary more: half of them pour nearly all.
"""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike

from benchmark_envs.cache import ContextCache
from benchmark_envs.exceptions import InvalidContextError, TaskError
from benchmark_envs.executor import SensorLog
from benchmark_envs.motion import interpolate, limit_speed
from benchmark_envs.mujoco_task import MujocoTask
from benchmark_envs.registry import register_task
from benchmark_envs.rollouts import FloatArray, Measured
from benchmark_envs.tasks.pouring_expert import peak_tilt, plan
from benchmark_envs.tasks.pouring_grains import (
    CUP,
    GRAIN,
    RECEIVER,
    count_inside,
    grain_positions,
    initial_state,
    load_model,
    settle,
    settle_lowest,
    shares,
)

T = 200
SUBSTEPS = 2  # of 8 ms: 16 ms per time point, 3.2 s per trajectory
UPRIGHT = np.zeros(1)  # rad
RETURN = 63  # time points, 1 s, after the trajectory: the cup goes upright, and what falls lands
LOWEST, HIGHEST = -0.35, 2.2  # rad; of the wrist: 0 is upright, and it pours at positive angles
FASTEST = 0.016 * np.pi  # rad per time point; a UR10's wrist turns by 180 degrees per second
LEAST, MOST = 500.0, 1500.0  # g; in the cup at first: it is then filled to 48 and 116 mm of 150
LEAST_TARGET = 50.0  # g
TOLERANCE = 27.0  # g; the thesis's error after adaptation
CHUNK = 8  # rollouts, 4 MB of states each

#: contexts are drawn from these: least and most of initial amount and amount to pour, in g
DEMONSTRATED = np.array([[850.0, 150.0], [950.0, 600.0]])
#: far from the demonstrations, in g; the first one is the thesis's
EXTRAPOLATION_CONTEXTS = np.array(
    [
        [1400.0, 1322.0],
        [1400.0, 1000.0],
        [1200.0, 1100.0],
        [1300.0, 700.0],
        [1100.0, 1000.0],
        [1450.0, 1200.0],
    ]
)

REFINEMENTS = 12  # simulations in which the expert corrects its aim
ACCURACY = 15.0  # g; the expert is content with this
CACHED_SOLUTIONS = 4096  # of the expert; 2 kB each


def demonstration_contexts() -> FloatArray:
    """Return what the 16 demonstrations show: 4 initial amounts x 4 targets, shape (16, 2) in g."""
    initial, target = (np.linspace(low, high, 4) for low, high in DEMONSTRATED.T)
    return np.stack(np.meshgrid(initial, target, indexing="ij"), axis=-1).reshape(16, 2)


@register_task("nmp/Pouring-v1")
class PouringTask(MujocoTask):
    """A cup with 50 to 150 marbles that a wrist tilts, and a second cup that is to catch some.

    The initial amount decides how many marbles are in play, one for about 10 g, so a fuller cup
    pours at smaller angles. Which of them fall is chance, though a trajectory always pours the
    same: what nearly equal ones pour scatters by 18 g (standard deviation). After the trajectory
    the cup returns upright; a marble then lies in the receiver (poured), in the cup (kept) or
    elsewhere (spilled), and ``info`` holds these ``poured``, ``kept`` and ``spilled`` grams, whose
    sum is the initial amount exactly.

    What a rollout achieved (`Rollouts.achieved_contexts`) is the initial amount and what was poured
    of it, if that is an amount that can be asked for.

    Reward: ``short + excess``, minus the absolute difference of poured and wanted grams. Success:
    it is at most 27 g.

    The wrist turns by at most 180 degrees per second: it follows faster set-points, and a first one
    away from upright, as quickly as it can. ``clipped`` reports that as well, and ``executed`` has
    the angles that were reached.

    >>> task = PouringTask(n_threads=1)
    >>> rollouts = task.simulate([900.0, 300.0], task.initial_trajectory([900.0, 300.0]))
    >>> float(rollouts.rewards[0]), float(rollouts.outcomes["kept"][0])
    (-300.0, 900.0)

    :param n_threads: of the simulator; by default one per core
    """

    context_names: tuple[str, ...] = ("initial amount [g]", "amount to pour [g]")
    trajectory_names: ClassVar[tuple[str, ...]] = ("wrist angle [rad]",)
    tells_achievement: bool = True
    exploration_scale: ClassVar[tuple[float, ...]] = (0.1,)
    reward_terms: Mapping[str, str] = {
        "short": "minus what was poured too little [g]",
        "excess": "minus what was poured too much [g]",
    }
    error_unit: str = "g"
    frame_every: ClassVar[float] = 2.5
    #: for `extrapolation`, shapes (16, 2) and (6, 2) in g
    demonstrated_contexts: ClassVar[FloatArray] = demonstration_contexts()
    extrapolation_contexts: ClassVar[FloatArray] = EXTRAPOLATION_CONTEXTS

    def __init__(self, n_threads: int | None = None) -> None:
        self.context_space = spaces.Box(
            np.array([LEAST, LEAST_TARGET], np.float32), np.array([MOST, MOST], np.float32)
        )
        self.trajectory_space = spaces.Box(LOWEST, HIGHEST, (T, 1), np.float32)
        super().__init__(load_model(), SUBSTEPS, n_threads, CHUNK)
        self._settled: FloatArray | None = None
        self._states: dict[int, FloatArray] = {}
        self._solutions = ContextCache(self._refine, CACHED_SOLUTIONS)

    @property
    def reward_range(self) -> tuple[float, float]:
        """As much as there can be in the cup is poured too little or too much; and no error."""
        return -MOST, 0.0

    def check_context(self, context: ArrayLike) -> FloatArray:
        """Check the context as `Task.check_context` does, and that the cup holds what is poured.

        :param context: initial amount and amount to pour, shape (2,) in g
        :raises InvalidContextError: as there, or more is to be poured than is in the cup
        """
        checked = super().check_context(context)
        if checked[1] > checked[0]:
            raise InvalidContextError(
                f"the amount to pour is {checked[1]:.6g} g, but the cup holds {checked[0]:.6g} g: "
                f"pour at most that, or begin with an initial amount of {checked[1]:.6g} to "
                f"{MOST:g} g."
            )
        return checked

    def _draw_context(self, rng: np.random.Generator) -> FloatArray:
        """Draw a context among the demonstrated ones, shape (2,) in g.

        The initial amount is uniform in 850 to 950 g and the amount to pour in 150 to 600 g.

        :param rng: the generator to draw from
        """
        return rng.uniform(*DEMONSTRATED)

    def initial_trajectory(self, context: ArrayLike) -> FloatArray:
        """Return the cup held upright, shape (T, 1) in rad.

        :param context: initial amount and amount to pour, shape (2,) in g
        """
        self.check_context(context)
        return np.zeros((T, 1))

    def demonstrate(self, context: ArrayLike, mode: str | None = None) -> FloatArray:
        """Return the expert's trajectory, shape (T, 1) in rad.

        It tilts the cup to a peak, holds it and brings it back (`pouring_expert`). The expert tries
        its plan in simulation and corrects its aim by the error it sees, until that is at most
        15 g. The same context gives the same trajectory.

        :param context: initial amount and amount to pour, shape (2,) in g
        :param mode: ``"default"``, the only one
        :raises TaskError: the expert finds no peak that pours the amount within 27 g
        """
        self.check_mode(mode)
        return self._solutions[self.check_context(context)].copy()

    def _refine(self, context: FloatArray) -> FloatArray:
        """Simulate plans, each aimed off by a part of the last one's miss, and return the best.

        The parts shrink (a half, a third, a quarter, ...), because most of a miss is the chance of
        an avalanche: equal parts can lead round and round the same few plans.
        """
        initial, target = context
        aim, best, least = target, None, TOLERANCE
        for k in range(REFINEMENTS):
            trajectory = plan(peak_tilt(initial, aim), self.times)
            miss = target - self.simulate(context, trajectory).outcomes["poured"][0]
            if abs(miss) <= least:
                best, least = trajectory, abs(miss)
            if least <= ACCURACY:
                break
            aim = float(np.clip(aim + miss / (k + 2), 0.0, initial))
        if best is None:
            raise TaskError(
                f"the expert cannot pour {target:.6g} of {initial:.6g} g within {TOLERANCE:g} g: "
                "some of the last marbles miss the receiver. Ask for at most 95 % of the content."
            )
        return best

    @staticmethod
    def _count(initial: float) -> int:
        """Return the number of grains in play for an initial amount in g."""
        return round(float(initial) / GRAIN)

    def _initial_state(self, context: FloatArray) -> FloatArray:
        """Return the state with the cup upright and the initial amount at rest in it."""
        return self._at_rest(self._count(context[0]))

    def _at_rest(self, n: int) -> FloatArray:
        """Return the state with the cup upright and n grains at rest in it; cached."""
        if n not in self._states:
            if self._settled is None:
                self._settled = settle(self.executor)
            rest = settle_lowest(self.executor, self._settled, n)
            self._states[n] = initial_state(self.executor, rest)
        return self._states[n]

    def _follow(self, trajectories: FloatArray) -> FloatArray:
        """Hold the wrist to its speed, beginning upright."""
        return limit_speed(UPRIGHT, trajectories, FASTEST)

    def _controls(self, contexts: FloatArray, followed: FloatArray) -> FloatArray:
        """Return what the servo is commanded, the return to upright after the trajectory included.

        MuJoCo reads its sensors at the beginning of a step, so each set-point is commanded a step
        earlier.

        :param contexts: shape (N, 2) in g
        :param followed: shape (N, T, 1) in rad
        :return: shape (N, (T + RETURN) * SUBSTEPS, 1) in rad
        """
        upright = np.broadcast_to(UPRIGHT, (len(followed), RETURN, 1))
        wanted = np.concatenate([followed, upright], axis=1)
        controls = interpolate(UPRIGHT, limit_speed(UPRIGHT, wanted, FASTEST), SUBSTEPS)
        return np.concatenate([controls[:, 1:], controls[:, -1:]], axis=1)

    def _measure(self, contexts: FloatArray, trajectories: FloatArray, log: SensorLog) -> Measured:
        initial, target = contexts.T
        poured, kept, spilled = self._amounts(log, initial)
        return Measured(
            executed=log.readings["wrist"][:, :T],
            terms={
                "short": -np.maximum(target - poured, 0.0),
                "excess": -np.maximum(poured - target, 0.0),
            },
            successes=np.abs(poured - target) <= TOLERANCE,
            outcomes={"poured": poured, "kept": kept, "spilled": spilled},
            achieved_contexts=self.within_contexts(np.column_stack([initial, poured]), poured > 0),
        )

    def _amounts(
        self, log: SensorLog, initial: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return poured, kept and spilled g, each of shape (N,); all is kept where it diverged."""
        counts = np.array([self._count(amount) for amount in initial])
        positions = grain_positions(self.model, log.final_states, int(counts.max()))
        in_play = np.arange(positions.shape[1]) < counts[:, None]
        positions = np.where(in_play[..., None], positions, -np.inf)
        poured = np.where(log.diverged, 0, count_inside(positions, RECEIVER))
        kept = np.where(log.diverged, counts, count_inside(positions, CUP))
        return shares(initial, counts, poured, kept)
