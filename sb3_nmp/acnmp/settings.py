"""The settings of ACNMP: where it explores, and how its network goes on."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, get_args

from sb3_nmp.bayesian.settings import ShapedExploration
from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.common.settings import Presets, settings_name

#: ``"to_go"``: the reward from each time on (Eq. 5.2); ``"step"``: the reward at each time (the
#: original code); ``"place"``: by place among all rollouts of the context
Advantage = Literal["to_go", "step", "place"]


@settings_name("acnmp-exploration")
@dataclass(frozen=True)
class ACNMPExploration(ShapedExploration):
    """Where ACNMP explores and how far, in units of ``exploration_scale``; a 0 switches a part off.

    Beside the noise of `ShapedExploration`, directions that the network gives. Presets: ``"push"``
    for demonstrations that span what is to be found, ``"stream"`` for streams of contexts.

    >>> from sb3_nmp import ACNMPExploration
    >>> ACNMPExploration.preset("push").shaped
    0.99

    :param noise: see `ShapedExploration`, as are n_bases, shaped and radius
    :param latent: along the principal axes of the demonstrations' representations: the root mean
        square over time along the first axis, the others in proportion to the demonstrations'
        spread along them
    :param n_latents: how many of these axes
    :param context: along the task parameters at which the CNMP is queried: the root mean square
        over time
    :raises ConfigurationError: a value outside its range, or nothing to explore
    """

    latent: float = 0.5
    n_latents: int = 3
    context: float = 0.0

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        **ShapedExploration.presets,
        "stream": {**ShapedExploration.presets["stream"], "latent": 0.25},
    }

    def __post_init__(self) -> None:
        """Check the values."""
        super().__post_init__()
        for name in ("latent", "n_latents", "context"):
            if not getattr(self, name) >= 0:
                raise ConfigurationError(f"{name} is {getattr(self, name)}; it must be >= 0.")
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
