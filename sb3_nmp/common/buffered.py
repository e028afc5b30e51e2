"""`BufferedAlgorithm`: what all algorithms share that keep rollouts in a replay buffer."""

import warnings
from typing import Any

from sb3_nmp.common.algorithm import TrajectoryAlgorithm
from sb3_nmp.common.buffer import TrajectoryBuffer
from sb3_nmp.common.exceptions import ResumeWarning
from sb3_nmp.common.files import AnyPath
from sb3_nmp.common.policies import ElitePolicy


class BufferedAlgorithm(TrajectoryAlgorithm):
    """Base of the algorithms with a replay buffer, whose policy remembers the best trajectories.

    The buffer is not saved with the model: `save_replay_buffer` writes it to a file of its own.
    """

    policy: ElitePolicy
    replay_buffer: TrajectoryBuffer
    #: rollouts that the buffer had when the model was saved, until `learn` has looked at it
    _n_buffered: int = 0

    def _setup_model(self) -> None:
        super()._setup_model()
        self.replay_buffer = self._empty_buffer()

    def _empty_buffer(self) -> TrajectoryBuffer:
        return TrajectoryBuffer(self.policy.context_dim, self.policy.trajectory_shape)

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "replay_buffer"]

    def _setup_learn(self, *args: Any, **kwargs: Any) -> tuple[int, Any]:  # noqa: ANN401
        if len(self.replay_buffer) < self._n_buffered:
            warnings.warn(
                f"the saved run had {self._n_buffered} rollouts in its replay buffer, and this "
                f"model has {len(self.replay_buffer)}: it does not go on where that run stopped, "
                "but learns without them. Call load_replay_buffer(path) before learn, with the "
                "file that save_replay_buffer (or CheckpointCallback with save_replay_buffer=True) "
                "wrote beside the model.",
                ResumeWarning,
                stacklevel=4,
            )
            self._forget_rollouts()
        self._n_buffered = 0
        return super()._setup_learn(*args, **kwargs)

    def _forget_rollouts(self) -> None:
        """Forget what is known of rollouts by their rows in a replay buffer that is lost."""

    def save(self, path: Any, *args: Any, **kwargs: Any) -> None:  # noqa: ANN401
        """Write the model to a zip file; see SB3. The replay buffer is a file of its own.

        :param path: of the file
        :param args: see SB3
        :param kwargs: see SB3
        """
        loaded = self._n_buffered
        self._n_buffered = max(loaded, len(self.replay_buffer))
        try:
            super().save(path, *args, **kwargs)
        finally:
            self._n_buffered = loaded

    def save_replay_buffer(self, path: AnyPath) -> None:
        """Write the replay buffer as .npz; with it, a saved model resumes exactly.

        :param path: of the file; SB3's CheckpointCallback calls this too
        """
        self.replay_buffer.save(path)

    def load_replay_buffer(self, path: AnyPath, truncate_last_traj: bool = True) -> None:
        """Read a replay buffer: to resume, or to begin with rollouts of known reward.

        :param path: of a file that `save_replay_buffer` wrote
        :param truncate_last_traj: without effect, for SB3's callers: every episode is complete
        :raises FileFormatError: it is not such a file
        :raises InvalidDataError: its rollouts do not fit the environment
        """
        del truncate_last_traj
        self.replay_buffer.load(path)
