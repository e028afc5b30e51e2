"""The algorithms of the benchmark, by stable name; suites give them settings and labels."""

from dataclasses import replace

from torch import nn

from results.harness.specification import Algorithm
from sb3_nmp import (
    ACNMPAdaptation,
    ACNMPCritic,
    ACNMPExploration,
    CNMPArchitecture,
    ShapedExploration,
)

RCNMP = Algorithm("rcnmp", "sb3_nmp:RCNMP", description="reward-conditioned neural process")
ACNMP = Algorithm("acnmp", "sb3_nmp:ACNMP", description="adaptive conditional neural process")
BO = Algorithm("bo", "baselines:BO", description="ACNMP's search without the network")
GA = Algorithm("ga", "baselines:GA", description="RC-NMP's operators without the network")
JUDGED_GA = Algorithm(
    "ga",
    "baselines:GA",
    settings={"n_candidates": 10},
    description="the same, ten candidates for each rollout judged by Gaussian processes",
)
DREPS = Algorithm("dreps", "baselines:DREPS", description="dual REPS, repelled by bad clusters")
REPS = Algorithm("reps", "baselines:REPS", description="relative entropy policy search")
CMAES = Algorithm(
    "cmaes",
    "baselines:CMAES",
    description="CMA-ES over smooth changes of the CNMP's answer, and over its context",
)
STARK = Algorithm(
    "stark-promp-rl",
    "baselines:StarkProMPRL",
    description="a ProMP per target, whose experience starts REPS on the next one",
)
EWERTON = Algorithm(
    "ewerton-promp-rl",
    "baselines:EwertonProMPRL",
    description="one ProMP, Gaussian processes, relevance-weighted policy optimisation",
)
RANDOM_SEARCH = Algorithm(
    "random-search",
    "baselines:RandomSearch",
    description="the best of smooth random bends",
    pretrained=False,
)
TURBO = Algorithm(
    "turbo",
    "baselines:TuRBO",
    description="BoTorch: Thompson sampling in a trust region",
    pretrained=False,
)
LOG_EI = Algorithm(
    "log-ei",
    "baselines:LogEI",
    description="BoTorch: logarithm of expected improvement",
    pretrained=False,
)
CMA_ME = Algorithm(
    "cma-me",
    "baselines:CMAME",
    description="pyribs: evolution strategies that fill an archive of different solutions",
    pretrained=False,
)
CONTEXTUAL_REPS = Algorithm(
    "contextual-reps",
    "baselines:ContextualREPS",
    description="REPS, one distribution over all contexts",
)
CONTEXTUAL_CMAES = Algorithm(
    "contextual-cmaes",
    "baselines:ContextualCMAES",
    description="CMA-ES, one distribution over all contexts",
)
PPO = Algorithm("ppo", "results.agents:PPO", description="SB3's PPO over a ProMP's weights")
SAC = Algorithm("sac", "results.agents:SAC", description="SB3's SAC over a ProMP's weights")
ARS = Algorithm("ars", "results.agents:ARS", description="sb3-contrib's ARS over a ProMP's weights")
BY_NAME = {
    algorithm.name: algorithm
    for algorithm in (
        RCNMP,
        ACNMP,
        BO,
        GA,
        DREPS,
        REPS,
        CMAES,
        STARK,
        EWERTON,
        RANDOM_SEARCH,
        TURBO,
        LOG_EI,
        CMA_ME,
        CONTEXTUAL_REPS,
        CONTEXTUAL_CMAES,
    )
}


#: by the end of a row's label: how a twin of ACNMP answers contexts
TWINS = {
    "nearest": "nearest",
    "ridge": "ridge",
    "quadratic": "quadratic",
    "Gaussian process": "gaussian-process",
}
#: settings of ACNMP without a critic: the policy gradient moves the network, the search follows
#: it. The network is the one that its committed rows were measured with
NETWORK_DRIVES: dict[str, object] = {
    "search": "policy",
    "population_size": 5,
    "policy_kwargs": {"cnmp": CNMPArchitecture.preset("latent")},
}
#: setting of a critic that sees the reward's sum alone
SUM_ALONE: dict[str, object] = {"critic": ACNMPCritic(terms=False, achieved=False)}


def twin(name: str, **settings: object) -> Algorithm:
    """Return ACNMP's search from a regression's answer instead of the network's.

    >>> twin("ridge", population_size=1).settings["policy_kwargs"]
    {'regression': 'ridge'}

    :param name: of `TWINS`
    :param settings: further constructor arguments: those of the suite's ACNMP that need no network
    """
    own = {"policy_kwargs": {"regression": TWINS[name]}}
    described = f"ACNMP's search, contexts answered by {name} instead of a network"
    return replace(BO, settings=settings | own, description=described)


def twins(*names: str, **settings: object) -> dict[str, Algorithm]:
    """Return rows of twins, by label.

    >>> list(twins("nearest", "Gaussian process"))
    ['twin, nearest', 'twin, Gaussian process']

    :param names: of `TWINS`
    :param settings: see `twin`
    """
    return {f"twin, {name}": twin(name, **settings) for name in names}


def without_network(**settings: object) -> dict[str, Algorithm]:
    """Return rows of RC-NMP's twins in one context, by label, with its settings.

    >>> list(without_network(pd_controller=None))
    ['GA', 'GA, judged']

    :param settings: constructor arguments: those of the suite's RC-NMP that need no network
    """
    return {
        "GA": replace(GA, settings=settings, pretrained=False),
        "GA, judged": replace(
            JUDGED_GA, settings=settings | dict(JUDGED_GA.settings), pretrained=False
        ),
    }


def hand_tuned(n_bases: int, shaped: float, population_size: int = 1) -> dict[str, Algorithm]:
    """Return rows of ACNMP, and of its nearest twin, with noise that was tuned on a task.

    >>> list(hand_tuned(n_bases=4, shaped=0.99))
    ['ACNMP, hand-tuned', 'twin, nearest, hand-tuned']

    :param n_bases: of the noise, see `ShapedExploration`
    :param shaped: share of the noise that is like the demonstrations
    :param population_size: rollouts per generation
    """
    size: dict[str, object] = {"population_size": population_size}
    own = size | {"exploration": ACNMPExploration(n_bases=n_bases, shaped=shaped)}
    ours = replace(ACNMP, settings=own, description="ACNMP with noise that was chosen on this task")
    theirs = twin("nearest", **size, exploration=ShapedExploration(n_bases=n_bases, shaped=shaped))
    return {"ACNMP, hand-tuned": ours, "twin, nearest, hand-tuned": theirs}


#: context in the decoder, time as it is, no trend, one network, Eq. 4.1 as it is
THESIS_NETWORK = CNMPArchitecture(
    linear_trend=False,
    fitted_trend=False,
    n_frequencies=0,
    n_members=1,
    activation_fn=nn.ReLU,
    beta_nll=0.0,
)


def thesis_acnmp(**settings: object) -> Algorithm:
    """Return ACNMP with the thesis's search and the constants of its published code for Push.

    Two rollouts per generation, the policy's answer and one with smooth noise in 20 knots that is
    alike everywhere; its advantage at each time; context in the decoder, time as it is, no trend.

    :param settings: further constructor arguments, or others
    """
    constants: dict[str, object] = {
        "search": "policy",
        "population_size": 2,
        "learning_rate": 5e-5,
        "adaptation": ACNMPAdaptation("step", n_training_steps=100, reward_weight=1.0),
        "exploration": ACNMPExploration(
            n_bases=20,
            shaped=0.0,
            radius=0.5,
            growth=1.0,
            shrinkage=1.0,
            retry_answer=True,
        ),
        "policy_kwargs": {"cnmp": THESIS_NETWORK},
    }
    described = "policy gradient, noise and network as in the thesis"
    return replace(ACNMP, settings=constants | settings, description=described)
