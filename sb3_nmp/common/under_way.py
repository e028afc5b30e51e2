"""`GenerationAlgorithm`: the generation under way, which goes on in the next ``learn`` or not."""

import warnings

from sb3_nmp.common.exceptions import ResumeWarning
from sb3_nmp.common.resumable import ResumableAlgorithm
from sb3_nmp.common.rollouts import Generation


class GenerationAlgorithm(ResumableAlgorithm):
    """Keeps what was done of a generation that the end of ``learn``, or a callback, has cut."""

    population_size: int
    _collected: list[Generation]
    _generation_started: bool
    #: rollouts of the generation under way, as it was begun
    _size_begun: int | None = None

    @property
    def generation_size(self) -> int:
        """How many rollouts the generation at hand has; a multiple of the environments."""
        return self.population_size

    @property
    def _n_collected(self) -> int:
        return sum(len(part.rewards) for part in self._collected)

    def _misfit(self, n_envs: int) -> str | None:
        """Return why the rest of a generation cannot be done as it was begun; None where it can."""
        size = self.generation_size
        if self._size_begun not in (None, size):
            return f"generations have {size} rollouts now"
        if (size - self._n_collected) % n_envs:
            return f"its rest cannot be shared out among {n_envs} environments"
        return None

    def _drop_what_does_not_fit(self, n_envs: int) -> None:
        """Begin a generation anew that cannot go on."""
        why = self._misfit(n_envs) if self._generation_started else None
        if why is not None:
            self._drop_generation(why)

    def _drop_generation(self, why: str) -> None:
        """Begin the generation under way anew, without the rollouts of it that were done."""
        size = self._size_begun or self.generation_size
        done, self._collected, self._generation_started = self._n_collected, [], False
        if done:
            warnings.warn(
                f"{done} of {size} rollouts of a generation were done, and {why}: it begins anew, "
                "without them. Go on with the same environments and population to lose none, or "
                "learn by whole generations.",
                ResumeWarning,
                stacklevel=5,
            )

    def _leave_environment(self) -> None:
        """Drop what was begun in the environment before."""
        if self._generation_started:
            self._drop_generation("the environment was exchanged")
