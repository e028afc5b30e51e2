"""`CNMPArchitecture`: sizes and kinds of a CNMP's layers."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from torch import nn

from sb3_nmp.common.settings import Rules, Settings, layers, settings_name, whole


@settings_name("cnmp-architecture")
@dataclass(frozen=True)
class CNMPArchitecture(Settings):
    """Architecture of a CNMP.

    Training begins with the linear regression of the demonstrations on their contexts, and learns
    what that leaves, with smooth layers: those with corners go astray beyond the demonstrations
    (``results/experiments/acnmp.md``). What is met badly goes on to count (``beta_nll``).
    ``CNMPArchitecture.preset("latent")`` has none of that, nor the context in the decoder: all that
    tells trajectories apart is in the representation, as where two robots share one, or a latent
    space is looked at. ``CNMPArchitecture.preset("moment")`` is the same with smooth layers, for
    representations of moments (`SkillTransfer`).

    >>> from sb3_nmp import CNMPArchitecture
    >>> CNMPArchitecture.preset("latent").context_in_decoder
    False

    :param representation_dim: Z
    :param encoder_arch: hidden layers of the encoder
    :param context_arch: hidden layers from the context to the representation
    :param decoder_arch: hidden layers of the decoder
    :param context_in_decoder: give the context to the decoder too, as the thesis does
    :param linear_trend: whether the mean has a trend that is linear in the decoder's inputs
    :param fitted_trend: whether training begins with the trend that is the demonstrations' linear
        regression on their contexts, and with nothing added to it; Adam comes near to that
        regression, but does not meet it. The trend is then linear in the context, too, where the
        decoder is not given it. Without effect where there is no trend
    :param n_frequencies: of the time features; 0 feeds time as it is, as the thesis does
    :param min_std: smallest standard deviation of the output, in units of the demonstrations'
        own; without it, Eq. 4.1 has no bound once the demonstrations are met exactly
    :param beta_nll: in the training on demonstrations and solutions each point's likelihood is
        weighed by its predicted variance to this power (Seitzer et al., "On the pitfalls of
        heteroscedastic uncertainty estimation", 2022, who recommend 0.5), but where it alternates
        with a policy gradient. 0 is Eq. 4.1 alone: a point that is met badly is given a large
        standard deviation, and hardly counts from then on
    :param activation_fn: between the layers
    :param n_members: of an ensemble of such networks, each with its own first weights and batches:
        it answers with their mean, and their spread tells what the demonstrations leave open
    :param n_modes: the most ways to do the task that are told apart among the demonstrations, by a
        categorical latent (chapter 7 names it as future work). 1 takes all for one way: two ways,
        such as left and right of an obstacle, are averaged
    :raises ConfigurationError: a value outside its range
    """

    representation_dim: int = 16
    encoder_arch: tuple[int, ...] = (128, 128)
    context_arch: tuple[int, ...] = (64,)
    decoder_arch: tuple[int, ...] = (128, 128)
    context_in_decoder: bool = True
    linear_trend: bool = True
    n_frequencies: int = 8
    min_std: float = 0.02
    activation_fn: type[nn.Module] = nn.SiLU
    n_members: int = 5
    n_modes: int = 1
    fitted_trend: bool = True
    beta_nll: float = 0.5

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "latent": {
            "context_in_decoder": False,
            "fitted_trend": False,
            "activation_fn": nn.ReLU,
            "beta_nll": 0.0,
        },
        "moment": {"context_in_decoder": False, "fitted_trend": False, "beta_nll": 0.0},
    }

    @property
    def has_fitted_trend(self) -> bool:
        """Whether there is a trend, and training begins with a fitted one."""
        return self.linear_trend and self.fitted_trend

    def rules(self) -> Rules:
        """Return the rules of the values."""
        return {
            "representation_dim": whole(self.representation_dim, least=1),
            "encoder_arch": layers(self.encoder_arch),
            "context_arch": layers(self.context_arch),
            "decoder_arch": layers(self.decoder_arch),
            "n_frequencies": whole(self.n_frequencies, least=0),
            "min_std": (self.min_std >= 0, ">= 0"),
            "n_members": whole(self.n_members, least=1),
            "n_modes": whole(self.n_modes, least=1),
            "beta_nll": (
                0 <= self.beta_nll <= 1,
                "in [0, 1]: 0 is the likelihood alone, 1 weighs all errors of the mean alike",
            ),
        }
