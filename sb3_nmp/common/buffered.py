"""`BufferedAlgorithm`: what all algorithms share that keep rollouts in a replay buffer."""

from sb3_nmp.common.algorithm import TrajectoryAlgorithm
from sb3_nmp.common.buffer import TrajectoryBuffer
from sb3_nmp.common.policies import ElitePolicy


class BufferedAlgorithm(TrajectoryAlgorithm):
    """Base of the algorithms with a replay buffer, whose policy remembers the best trajectories.

    The buffer is not saved with the model: `save_replay_buffer` writes it to a file of its own.
    """

    policy: ElitePolicy
    replay_buffer: TrajectoryBuffer

    def _setup_model(self) -> None:
        super()._setup_model()
        self.replay_buffer = self._empty_buffer()

    def _empty_buffer(self) -> TrajectoryBuffer:
        return TrajectoryBuffer(self.policy.context_dim, self.policy.trajectory_shape)

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "replay_buffer"]

    def save_replay_buffer(self, path: str) -> None:
        """Write the replay buffer as .npz; with it, a saved model resumes exactly.

        :param path: of the file; SB3's CheckpointCallback calls this too
        """
        self.replay_buffer.save(path)

    def load_replay_buffer(self, path: str) -> None:
        """Read a replay buffer: to resume, or to begin with rollouts of known reward.

        :param path: of a file that `save_replay_buffer` wrote
        :raises FileFormatError: it is not such a file
        :raises InvalidDataError: its rollouts do not fit the environment
        """
        self.replay_buffer.load(path)
