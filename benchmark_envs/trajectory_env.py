"""`TrajectoryEnv`: a task as a Gymnasium environment whose episode is one rollout."""

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark_envs.exceptions import InvalidTrajectoryError, NoPicturesError, TaskError
from benchmark_envs.registry import make_task
from benchmark_envs.rollouts import FloatArray, Rollouts
from benchmark_envs.task import Task


def draws(task: Task) -> bool:
    """Return whether a task has pictures of its rollouts: `Task.frames` has none.

    >>> draws(make_task("nmp/Bottles-v0")), draws(make_task("nmp/ViaPoints-v0"))
    (True, False)

    :param task: any
    """
    return type(task).frames is not Task.frames


class TrajectoryEnv(gym.Env[NDArray[Any], NDArray[Any]]):
    """Contextual bandit: observe a context, answer with a whole trajectory, get one reward.

    ``reset`` returns the context, shape (C,); ``step`` takes the trajectory, shape (T, D), and
    always terminates. ``info`` holds ``is_success``, ``executed_trajectory`` and the reward's
    terms (`Rollouts.info`).

    >>> env = TrajectoryEnv("nmp/Bottles-v0", n_threads=1)
    >>> context, _ = env.reset(seed=0)
    >>> _, reward, terminated, _, info = env.step(env.demonstrate(context))
    >>> round(reward, 2), terminated, info["is_success"]
    (-0.13, True, True)

    :param task: a task or its id
    :param context: pins the context of every episode, shape (C,); by default the task draws it
    :param render_mode: ``"rgb_array_list"``: `render` returns the frames of the last rollout;
        ``"rgb_array"``: its last frame
    :param settings: arguments of `make_task`, where ``task`` is an id
    :raises TaskError: an unknown id or setting, or a context outside the context space
    :raises NoPicturesError: a render mode for a task that draws no pictures
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array_list", "rgb_array"]}  # noqa: RUF012

    def __init__(
        self,
        task: str | Task,
        context: ArrayLike | None = None,
        render_mode: str | None = None,
        **settings: Any,  # noqa: ANN401
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise TaskError(
                f"no render mode '{render_mode}'; there are None and "
                f"{', '.join(self.metadata['render_modes'])}."
            )
        if isinstance(task, Task) and settings:
            raise TaskError(
                f"{', '.join(settings)} was given beside a task that is built already; build it "
                "with these settings, or give its id."
            )
        self.task = task if isinstance(task, Task) else make_task(task, **settings)
        modes = self.metadata["render_modes"] if draws(self.task) else []
        self.metadata = {"render_modes": modes, "render_fps": self.task.frames_per_second}
        if render_mode is not None and not modes:
            raise NoPicturesError(
                f"render_mode is '{render_mode}', and {type(self.task).__name__} draws no pictures "
                "of its rollouts: leave it out. Tasks that MuJoCo simulates draw, such as "
                "nmp/Bottles-v0; 'nmp-bench plot' draws the paths of runs."
            )
        self.render_mode = render_mode
        self.observation_space = self.task.context_space
        self.action_space = self.task.trajectory_space
        self.pinned_context = None if context is None else self.task.check_context(context)
        self.context: FloatArray | None = None
        self._last: Rollouts | None = None
        self._prefetched: Rollouts | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode: draw a context.

        :param seed: of the generator that draws contexts
        :param options: ``{"context": c}`` sets this episode's context, shape (C,)
        :return: the context, shape (C,), and an empty info
        :raises TaskError: an unknown option, or a context outside the context space
        """
        super().reset(seed=seed)
        options = options or {}
        if not isinstance(options, dict):
            raise TaskError(f"options is {options!r}; it must be a dictionary: {{'context': c}}.")
        unknown = sorted(set(options) - {"context"})
        if unknown:
            raise TaskError(f"no reset option '{unknown[0]}'; the only one is 'context'.")
        if "context" in options:
            self.context = self.task.check_context(options["context"])
        elif self.pinned_context is not None:
            self.context = self.pinned_context
        else:
            self.context = self.task.sample_context(self.np_random)
        self._prefetched = None  # it was of the context before
        return self.context.astype(np.float32), {}

    def step(
        self, action: NDArray[Any]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Execute a trajectory.

        :param action: shape (T, D)
        :return: the context, the reward, True, False, and the rollout's info
        :raises InvalidTrajectoryError: wrong shape, more than one, or non-finite value
        """
        context = self._current_context()
        trajectories = self.task.check_trajectories(action)
        if len(trajectories) != 1:
            raise InvalidTrajectoryError(
                f"step was given {len(trajectories)} trajectories; an episode executes one, of "
                f"shape (T, D) = {self.action_space.shape}: give each to an episode of its own."
            )
        trajectory = trajectories[0]
        fetched, self._prefetched = self._prefetched, None
        if fetched is not None and np.array_equal(fetched.trajectories[0], trajectory):
            self._last = fetched
        else:
            self._last = self.task.simulate(context, trajectory)
        reward = float(self._last.rewards[0])
        return context.astype(np.float32), reward, True, False, self._last.info(0)

    def prefetch(self, rollout: Rollouts) -> None:
        """Hand over a rollout that was simulated in a batch; `step` uses it if it fits.

        :param rollout: a batch of one, made in this episode's context
        """
        self._prefetched = rollout

    def initial_trajectory(self) -> FloatArray:
        """Return the naive trajectory for the current context, shape (T, D)."""
        return self.task.initial_trajectory(self._current_context())

    def demonstrate(self, context: ArrayLike, mode: str | None = None) -> FloatArray:
        """Solve a context with the task's scripted expert; return its trajectory, shape (T, D).

        :param context: shape (C,)
        :param mode: one of the task's ``modes``; the first one by default
        """
        return self.task.demonstrate(context, mode)

    def sample_context(self, rng: np.random.Generator) -> FloatArray:
        """Draw a context as the task does, shape (C,).

        :param rng: the generator to draw from
        """
        return self.task.sample_context(rng)

    @property
    def tells_achievement(self) -> bool:
        """Whether ``info`` may hold ``achieved_context``; see `Task.tells_achievement`."""
        return self.task.tells_achievement

    @property
    def exploration_scale(self) -> FloatArray:
        """Standard deviation at which a search may begin, by dimension, shape (D,)."""
        return np.array(self.task.exploration_scale)

    def render(self) -> Any:  # noqa: ANN401
        """Draw the last rollout; before the first one, how it would begin.

        :return: a list of pictures of shape (H, W, 3), or the last one in mode ``"rgb_array"``;
            None without a render mode
        :raises RenderingUnavailableError: no off-screen renderer on this machine
        :raises TaskError: `reset` has not been called
        """
        if self.render_mode is None:
            return None
        if self._last is None:
            frames = [self.task.first_frame(self._current_context())]
        else:
            frames = self.task.frames(self._last.contexts[0], self._last.trajectories[0])
        return frames if self.render_mode == "rgb_array_list" else frames[-1]

    def _current_context(self) -> FloatArray:
        if self.context is None:
            raise TaskError("there is no context yet: call reset() before step().")
        return self.context
