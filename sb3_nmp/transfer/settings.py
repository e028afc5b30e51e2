"""How the two networks of a skill transfer are trained."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from sb3_nmp.common.settings import Rules, Settings, limits, settings_name, whole


@settings_name("transfer-training")
@dataclass(frozen=True)
class TransferTraining(Settings):
    """How two CNMPs with a shared latent space are trained on proxy skills (Eq. 5.4).

    The preset ``"moment"`` is for a latent space of moments: these are met far more exactly, and
    their likelihood weighs more beside the distance.

    >>> TransferTraining(n_steps=500).latent_weight
    100.0

    :param n_steps: steps of AdamW
    :param batch_size: proxy skills per step
    :param n_target_points: random time points of each robot's trajectory at which it is predicted;
        of moments, ``batch_size * n_target_points`` are drawn per step
    :param conditioning_points: each encoder sees at least and at most so many random points of its
        robot's trajectory; the numbers are drawn for each robot by itself. Without effect on
        moments
    :param latent_weight: of the distance between the two robots' representations, the third term
        of Eq. 5.4; 0 leaves two networks that know nothing of each other
    :param learning_rate: at the start; it falls to a hundredth along a cosine
    :param weight_decay: of AdamW
    :raises ConfigurationError: a value outside its range
    """

    n_steps: int = 3000
    batch_size: int = 8
    n_target_points: int = 10
    conditioning_points: tuple[int, int] = (9, 12)
    latent_weight: float = 100.0
    learning_rate: float = 3e-3
    weight_decay: float = 0.0

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {"moment": {"latent_weight": 1e4}}

    def rules(self) -> Rules:
        """Return the rules of the values."""
        return {
            "n_steps": whole(self.n_steps, least=1),
            "batch_size": whole(self.batch_size, least=1),
            "n_target_points": whole(self.n_target_points, least=1),
            "conditioning_points": limits(*self.conditioning_points, least=1),
            "latent_weight": (self.latent_weight >= 0, ">= 0"),
            "learning_rate": (self.learning_rate > 0, "> 0"),
            "weight_decay": (self.weight_decay >= 0, ">= 0"),
        }
