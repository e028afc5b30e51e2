"""The settings of ACNMP: where it explores, and how its network goes on."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from sb3_nmp.bayesian.settings import ShapedExploration
from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.common.settings import Rules, Settings, limits, settings_name

#: ``"to_go"``: the reward from each time on (Eq. 5.2); ``"step"``: the reward at each time (the
#: original code); ``"place"``: by place among all rollouts of the context
Advantage = Literal["to_go", "step", "place"]


@settings_name("acnmp-exploration")
@dataclass(frozen=True)
class ACNMPExploration(ShapedExploration):
    """Where ACNMP explores and how far, in units of ``exploration_scale``; a 0 switches a part off.

    Beside the noise of `ShapedExploration`, directions that the network gives. The preset
    ``"push"`` is for demonstrations that span what is to be found.

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
    :param growth: factor on the radius after a generation with a new best rollout, without a critic
    :param shrinkage: factor on the radius after any other generation, without a critic
    :param radius_limits: smallest and largest radius, without a critic
    :param retry_answer: without a critic, each generation tries the policy's answer too, as the
        thesis's pairs of rollouts do
    :raises ConfigurationError: a value outside its range, or nothing to explore
    """

    latent: float = 0.0
    n_latents: int = 3
    context: float = 0.0
    growth: float = 1.25
    shrinkage: float = 0.9
    radius_limits: tuple[float, float] = (0.02, 1.5)
    retry_answer: bool = False

    def rules(self) -> Rules:
        """Return the rules of the values."""
        return {
            **super().rules(),
            "latent": (self.latent >= 0, ">= 0"),
            "n_latents": (self.n_latents >= 0, ">= 0"),
            "context": (self.context >= 0, ">= 0"),
            "growth": (self.growth >= 1, ">= 1"),
            "shrinkage": (0 < self.shrinkage <= 1, "in (0, 1]"),
            "radius_limits": limits(*self.radius_limits),
        }

    def __post_init__(self) -> None:
        """Check the values, and that something is explored."""
        super().__post_init__()
        if not (self.noise or self.context or (self.latent and self.n_latents)):
            raise ConfigurationError(
                "nothing is explored: one of latent, context, noise must be > 0."
            )


@settings_name("acnmp-adaptation")
@dataclass(frozen=True)
class ACNMPAdaptation(Settings):
    """How ACNMP's network goes on learning after generations of a search.

    Presets: ``"to_go"`` and ``"step"`` have these advantages, in short training: what is pushed
    away from a bad rollout has no bound, so more of it leaves all that was learned.

    >>> from sb3_nmp import ACNMPAdaptation
    >>> ACNMPAdaptation.preset("to_go").n_training_steps
    30

    :param advantage: of the policy gradient: ``"to_go"`` is the reward from each time on (Eq. 5.2),
        ``"step"`` the reward at each time (the original code), both of the last generation;
        ``"place"`` goes by the place among all rollouts of the context, and among its successes
        once there are any
    :param temperature: of ``"place"``, in places: how fast the weight falls with the place
    :param reward_weight: of the policy gradient beside the likelihood. With too little the network
        stays behind its best rollouts, for its likelihood holds it back
    :param supervised: train on demonstrations between the policy gradient steps; False is the
        thesis's RL-only ablation
    :param n_training_steps: pairs of alternating steps after a generation; 0 leaves the policy
        gradient out
    :param n_final_steps: pairs of such steps when ``learn`` ends, where a critic has found a
        success in a pinned context: the network's own answer comes nearer to it by a third. So that
        answer depends on where a run was split into several calls; the search does not
    :param keep_answers: in a stream of contexts, train on the answers that satisfied too, so that a
        few solutions do not upset them. It pays where few demonstrations stand for many contexts
        and ways; where solutions come by the hundred it slows learning from these
    :param n_assimilation_steps: steps of supervised learning after contexts have been assimilated;
        none in a pinned context where the policy gradient `imitates` the solution
    :raises ConfigurationError: a value outside its range
    """

    advantage: Advantage = "place"
    temperature: float = 1.5
    reward_weight: float = 100.0
    supervised: bool = True
    n_training_steps: int = 20
    n_assimilation_steps: int = 50
    n_final_steps: int = 100
    keep_answers: bool = False

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        advantage: {"advantage": advantage, "reward_weight": 5.0, "n_training_steps": 30}
        for advantage in ("to_go", "step")
    }

    def rule_for(self, n_rollouts: int) -> tuple[bool, str]:
        """Return whether a generation has a policy gradient, and what has one.

        Advantages but ``"place"`` are centred over one generation: that of one rollout is 0.

        :param n_rollouts: of a generation
        """
        has = n_rollouts > 1 or self.advantage == "place" or self.n_training_steps == 0
        return has, (
            f"of advantage 'place' where the population_size is 1: '{self.advantage}' compares the "
            "rollouts of a generation"
        )

    def rules(self) -> Rules:
        """Return the rules of the values."""
        return {
            "temperature": (self.temperature > 0, "> 0"),
            "reward_weight": (self.reward_weight >= 0, ">= 0"),
            "n_training_steps": (self.n_training_steps >= 0, ">= 0"),
            "n_assimilation_steps": (self.n_assimilation_steps >= 0, ">= 0"),
            "n_final_steps": (self.n_final_steps >= 0, ">= 0"),
        }

    @property
    def imitates(self) -> bool:
        """Whether the policy gradient pulls the network to the best rollouts: it does by place.

        The other advantages push it away from the bad ones, too, and may leave a solution behind.
        """
        return self.n_training_steps > 0 and self.advantage == "place"
