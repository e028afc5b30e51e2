"""The settings of RC-NMP: its training, its judge, and its skill over contexts."""

from dataclasses import dataclass

from sb3_nmp.common.settings import Rules, Settings, layers, limits, settings_name, whole
from sb3_nmp.models.ensemble import EnsembleTraining


@settings_name("rcnmp-training")
@dataclass(frozen=True)
class RCNMPTraining(Settings):
    """How long and on what mini-batches RC-NMP's network is trained after each generation.

    >>> from sb3_nmp import RCNMPTraining
    >>> RCNMPTraining(n_steps=30).batch_size
    16

    :param n_steps: steps of Adam
    :param batch_size: trajectories per step
    :param n_target_points: random time points of each trajectory at which it is predicted
    :param max_conditioning_points: the encoder sees 1 to this many random points
    """

    n_steps: int = 60
    batch_size: int = 16
    n_target_points: int = 20
    max_conditioning_points: int = 10

    def rules(self) -> Rules:
        """Return the rules of the values."""
        return {name: whole(value, least=1) for name, value in vars(self).items()}


@settings_name("rcnmp-reward-model")
@dataclass(frozen=True)
class RCNMPRewardModel(Settings):
    """The ensemble that judges candidates; it is trained anew after each generation.

    >>> from sb3_nmp import RCNMPRewardModel
    >>> RCNMPRewardModel(n_steps=50).n_members
    5

    :param n_members: E; they judge in turn
    :param arch: hidden layers of a member
    :param n_steps: of the optimizer
    :param temperature: half of the rows of a batch are drawn from all rollouts alike, the others
        with probability exp(-place / temperature)
    :param training: rate and batches
    :raises ConfigurationError: a value outside its range
    """

    n_members: int = 5
    arch: tuple[int, ...] = (64, 64)
    n_steps: int = 100
    temperature: float = 40.0
    training: EnsembleTraining = EnsembleTraining(batch_size=64)  # noqa: RUF009 (frozen)

    def rules(self) -> Rules:
        """Return the rules of the values."""
        return {
            "n_members": whole(self.n_members, least=1),
            "arch": layers(self.arch),
            "n_steps": whole(self.n_steps, least=1),
            "temperature": (self.temperature > 0, "> 0"),
        }


@settings_name("rcnmp-skill")
@dataclass(frozen=True)
class RCNMPSkill(Settings):
    """RC-NMP over contexts; chosen on bottles at random and on push, seeds from 1000 on.

    >>> RCNMPSkill(reward_conditioning=False).n_bases  # policy_kwargs={"skill": ...} takes it
    8

    :param n_bases: smooth bases of a trajectory, per dimension
    :param reward_conditioning: whether the reward conditions the answer; without, it is the prior's
    :param n_members: of the prior and of the reward model
    :param arch: their hidden layers
    :param prior_steps: least and most steps of the prior's training; 0.3 per rollout in between
    :param reward_steps: the same of the reward model's; 0.6 per rollout
    :param width: standard deviation of p(w | c) around its mean, in units of the exploration
    :param robustness: standard deviation of the perturbations under which the reward is predicted,
        in the same units; they keep the ascent off narrow peaks of the model
    :param n_perturbations: M, even
    :param ascent_steps: of Adam
    :param ascent_rate: its learning rate
    :param floor: standard deviation by which the reward model is uncertain at least
    :param n_modes: the most ways to do a task that are told apart; 1 takes all for one
    :raises ConfigurationError: a value outside its range
    """

    n_bases: int = 8
    reward_conditioning: bool = True
    n_members: int = 8
    arch: tuple[int, ...] = (64, 64)
    prior_steps: tuple[int, int] = (30, 150)
    reward_steps: tuple[int, int] = (60, 300)
    width: float = 1.0
    robustness: float = 0.7
    n_perturbations: int = 8
    ascent_steps: int = 30
    ascent_rate: float = 0.05
    floor: float = 0.1
    n_modes: int = 1

    def rules(self) -> Rules:
        """Return the rules of the values."""
        return {
            "n_bases": whole(self.n_bases, least=2),
            "n_members": whole(self.n_members, least=1),
            "arch": layers(self.arch),
            "prior_steps": limits(*self.prior_steps, least=1),
            "reward_steps": limits(*self.reward_steps, least=1),
            "width": (self.width > 0, "> 0"),
            "robustness": (self.robustness >= 0, ">= 0"),
            "n_perturbations": (
                self.n_perturbations >= 2 and self.n_perturbations % 2 == 0,
                "an even number >= 2",
            ),
            "ascent_steps": whole(self.ascent_steps, least=0),
            "ascent_rate": (self.ascent_rate > 0, "> 0"),
            "floor": (self.floor > 0, "> 0"),
            "n_modes": (
                self.n_modes >= 1,
                "a whole number >= 1, where 1 takes all that was right for one way to do the task",
            ),
        }


@settings_name("rcnmp-achievement")
@dataclass(frozen=True)
class RCNMPAchievement(Settings):
    """How RC-NMP learns from what was achieved; chosen on push, seeds from 1000 on.

    >>> RCNMPAchievement().n_starts  # policy_kwargs={"achievement": ...} takes it
    4

    :param n_members: of the ensemble
    :param arch: its hidden layers
    :param steps_per_rollout: of its training, which goes on from where it was
    :param training: rate and batches
    :param n_starts: nearest rollouts from which an answer begins
    :param width: standard deviation of a correction, in units of the exploration
    :param tolerance: of what is achieved, in standard deviations of what was
    :param correction_steps: of Adam
    :param correction_rate: its learning rate
    :raises ConfigurationError: a value outside its range
    """

    n_members: int = 5
    arch: tuple[int, ...] = (128, 128)
    steps_per_rollout: float = 4.0
    training: EnsembleTraining = EnsembleTraining(2e-3, batch_size=256, huber=0.2)  # noqa: RUF009
    n_starts: int = 4
    width: float = 1.5
    tolerance: float = 0.1
    correction_steps: int = 25
    correction_rate: float = 0.15

    def rules(self) -> Rules:
        """Return the rules of the values."""
        return {
            "n_members": whole(self.n_members, least=1),
            "arch": layers(self.arch),
            "steps_per_rollout": (self.steps_per_rollout > 0, "> 0"),
            "n_starts": whole(self.n_starts, least=1),
            "width": (self.width > 0, "> 0"),
            "tolerance": (self.tolerance > 0, "> 0"),
            "correction_steps": whole(self.correction_steps, least=0),
            "correction_rate": (self.correction_rate > 0, "> 0"),
        }
