"""The settings of ACNMP: where it explores, and how its network goes on."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, get_args

from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.common.settings import Presets, settings_name

#: ``"to_go"``: the reward from each time on (Eq. 5.2); ``"step"``: the reward at each time (the
#: original code); ``"place"``: by place among all rollouts of the context
Advantage = Literal["to_go", "step", "place"]


@settings_name("acnmp-exploration")
@dataclass(frozen=True)
class ACNMPExploration(Presets):
    """Where ACNMP explores and how far, in units of ``exploration_scale``; a 0 switches a part off.

    Presets: ``"push"`` for demonstrations that span what is to be found, ``"stream"`` for streams
    of contexts.

    >>> from sb3_nmp import ACNMPExploration
    >>> ACNMPExploration.preset("push").shaped
    0.99

    :param latent: along the principal axes of the demonstrations' representations: the root mean
        square over time along the first axis, the others in proportion to the demonstrations'
        spread along them
    :param n_latents: how many of these axes
    :param context: along the task parameters at which the CNMP is queried: the root mean square
        over time
    :param noise: of smooth noise: the root mean square over time
    :param n_bases: of the noise, per dimension
    :param shaped: share of the noise's variance that varies over time and couples the dimensions
        as the demonstrations do; the rest is alike everywhere. So less is explored where all
        demonstrations agree, such as at a common start. Near 1 is best where the demonstrations
        span what is to be found, less where they all lack it
    :param radius: of the first generation, and without a critic of all, in standard deviations
    :raises ConfigurationError: a value outside its range, or nothing to explore
    """

    latent: float = 0.5
    n_latents: int = 3
    context: float = 0.0
    noise: float = 1.0
    n_bases: int = 4
    shaped: float = 0.5
    radius: float = 0.7

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "push": {"shaped": 0.99},
        "stream": {"latent": 0.25, "n_bases": 6},
    }

    def __post_init__(self) -> None:
        """Check the values."""
        for name in ("latent", "n_latents", "context", "noise"):
            if not getattr(self, name) >= 0:
                raise ConfigurationError(f"{name} is {getattr(self, name)}; it must be >= 0.")
        if not 0 <= self.shaped <= 1:
            raise ConfigurationError(f"shaped is {self.shaped}; it must lie in [0, 1].")
        if self.n_bases < 2:
            raise ConfigurationError(f"n_bases is {self.n_bases}; at least 2 are needed.")
        if not self.radius > 0:
            raise ConfigurationError(f"radius is {self.radius}; it must be > 0.")
        if not (self.noise or self.context or (self.latent and self.n_latents)):
            raise ConfigurationError(
                "nothing is explored: one of latent, context, noise must be > 0."
            )


@settings_name("acnmp-adaptation")
@dataclass(frozen=True)
class ACNMPAdaptation(Presets):
    """How ACNMP's network goes on learning after each generation of a search.

    ``ACNMPAdaptation.preset("stream")`` learns from solutions alone, in longer training.

    >>> from sb3_nmp import ACNMPAdaptation
    >>> ACNMPAdaptation.preset("stream").n_assimilation_steps
    200

    :param advantage: of the policy gradient: ``"to_go"`` is the reward from each time on (Eq. 5.2),
        ``"step"`` the reward at each time (the original code), ``"place"`` goes by the place among
        the rollouts of the context
    :param supervised: train on demonstrations between the policy gradient steps; False is the
        thesis's RL-only ablation
    :param n_training_steps: pairs of alternating steps after a generation; 0 leaves the policy
        gradient out
    :param n_assimilation_steps: steps of supervised learning after contexts have been assimilated
    :raises ConfigurationError: a value outside its range
    """

    advantage: Advantage = "place"
    supervised: bool = True
    n_training_steps: int = 10
    n_assimilation_steps: int = 50

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "stream": {"n_training_steps": 0, "n_assimilation_steps": 200}
    }

    def __post_init__(self) -> None:
        """Check the values."""
        if self.advantage not in get_args(Advantage):
            raise ConfigurationError(
                f"no advantage '{self.advantage}'; there are {', '.join(get_args(Advantage))}."
            )
        for name in ("n_training_steps", "n_assimilation_steps"):
            if getattr(self, name) < 0:
                raise ConfigurationError(f"{name} is {getattr(self, name)}; it must be >= 0.")
