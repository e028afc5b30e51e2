"""The suites: which algorithms run on which tasks, and the settings they run with."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from benchmark_envs.tasks.pick_and_place_expert import EXTRAPOLATION_CONTEXTS as TALL
from benchmark_envs.tasks.pouring import EXTRAPOLATION_CONTEXTS as FULL
from benchmark_envs.tasks.push import EXTRAPOLATION_TARGETS, TARGETS
from results.exceptions import BenchmarkError
from results.protocols import Extrapolation, LeaveOneOut, OneContext, Protocol, Stream
from results.specification import Algorithm, RunSpecification, Suite
from sb3_nmp import (
    ACNMPAdaptation,
    ACNMPCritic,
    ACNMPExploration,
    CNMPArchitecture,
    CNMPPretraining,
    SmoothNoise,
)

# Hyper-parameters are chosen on seeds of 1000 and above, which no reported run uses.
ALGORITHMS: dict[str, Algorithm] = {
    "RC-NMP": Algorithm("sb3_nmp.rcnmp:RCNMP", description="reward-conditioned neural process"),
    "GA": Algorithm("baselines:GA", description="RC-NMP's operators without the network"),
    "DREPS": Algorithm("baselines:DREPS", description="dual REPS, repelled by bad clusters"),
    "REPS": Algorithm("baselines:REPS", description="relative entropy policy search"),
}


def _rcnmp(**settings: object) -> Algorithm:
    return Algorithm("sb3_nmp.rcnmp:RCNMP", settings)


# RC-NMP with one element switched off, or taken back to the original code's choice, at a time.
ABLATIONS: dict[str, Algorithm] = {
    "RC-NMP": ALGORITHMS["RC-NMP"],
    "no explorer": _rcnmp(n_explorers=0),
    "no network (GA)": ALGORITHMS["GA"],
    "no crossover": _rcnmp(n_crossover=0),
    "latent parents only": _rcnmp(elite_parents=0.0),
    "no mutation": _rcnmp(mutation=None),
    "dense mutation": _rcnmp(mutation_rate=1.0),
    "rough mutation": _rcnmp(mutation=SmoothNoise(n_bases=20)),
    "isotropic mutation": _rcnmp(exploration_scale=0.15),
    "no PD controller": _rcnmp(pd_controller=None),
    "no reward condition": _rcnmp(reward_conditioning=False),
    "no KL term": _rcnmp(beta=0.0),
    "latents from N(0, I)": _rcnmp(latent_std=1.0),
    "standardised rewards": _rcnmp(reward_scaling="standardize"),
    "greedy draws": _rcnmp(temperature=1.0),
    "uniform draws": _rcnmp(temperature=math.inf),
    "last generation only": _rcnmp(buffer_size=20, n_elites=0),
    "time as it is": _rcnmp(policy_kwargs={"n_frequencies": 0}),
}

_ACNMP = Algorithm("sb3_nmp.acnmp:ACNMP", description="adaptive conditional neural process")


def _acnmp(**settings: object) -> Algorithm:
    return replace(_ACNMP, settings=settings)


# The pushes shown span what is to be found: nearly all of the noise is like them.
_PUSH = ACNMPExploration.preset("push")
_EWERTON = Algorithm(
    "baselines:EwertonProMPRL",
    description="one ProMP, Gaussian processes, relevance-weighted policy optimisation",
)

# Adaptation to a held-out target (thesis 5.2.2, the first experiment).
PUSH_ALGORITHMS: dict[str, Algorithm] = {
    "ACNMP": _acnmp(exploration=_PUSH),
    "CMA-ES residual": Algorithm(
        "baselines:CMAES",
        {"n_bases": 5},
        description="CMA-ES over smooth changes of the CNMP's answer",
    ),
    "CMA-ES context": Algorithm(
        "baselines:CMAES",
        {"n_bases": 4, "context_std": 0.3},
        description="the same, and over the context that the CNMP is asked for",
    ),
    "ProMP+RL (Stark)": Algorithm(
        "baselines:StarkProMPRL",
        description="a ProMP a target, whose experience starts REPS on the next one",
        budget=400,
    ),
    "ProMP+RL (Ewerton)": replace(_EWERTON, budget=400),
    "REPS": replace(ALGORITHMS["REPS"], budget=400),
    # The PD controller would pull every trajectory to the demonstrations' mean end.
    "RC-NMP": replace(
        ALGORITHMS["RC-NMP"],
        settings={"pd_controller": None},
        pretrained=False,
    ),
}

# Extrapolation beyond a set of demonstrations (thesis 5.2.4). With a handful of rollouts in all,
# each one is chosen by all before it, and the Gaussians are fitted to as few as they can be.
_CMAES = PUSH_ALGORITHMS["CMA-ES context"]
POURING_ALGORITHMS: dict[str, Algorithm] = {
    "ACNMP": _acnmp(population_size=1),
    "CMA-ES context": _CMAES,
    "ProMP+RL (Stark)": replace(
        PUSH_ALGORITHMS["ProMP+RL (Stark)"], settings={"population_size": 6}, budget=None
    ),
    "ProMP+RL (Ewerton)": replace(_EWERTON, settings={"population_size": 9}),
    "REPS": replace(ALGORITHMS["REPS"], settings={"population_size": 9}),
    "DREPS": replace(ALGORITHMS["DREPS"], settings={"population_size": 9}),
    "RC-NMP": replace(
        PUSH_ALGORITHMS["RC-NMP"],
        settings={"pd_controller": None, "population_size": 6, "n_crossover": 2},
    ),
}
# Grasp, carry and release are apart in time: with fewer bases they move each other.
PICK_ALGORITHMS: dict[str, Algorithm] = {
    "ACNMP": _acnmp(population_size=1, exploration=ACNMPExploration(n_bases=8)),
    "CMA-ES context": replace(
        _CMAES, settings={"n_bases": 8, "context_std": 0.3, "population_size": 4}
    ),
    "ProMP+RL (Stark)": replace(
        PUSH_ALGORITHMS["ProMP+RL (Stark)"], settings={"population_size": 4}, budget=None
    ),
    "ProMP+RL (Ewerton)": replace(_EWERTON, settings={"population_size": 4}),
    "REPS": replace(ALGORITHMS["REPS"], settings={"population_size": 10}),
    "RC-NMP": PUSH_ALGORITHMS["RC-NMP"],
}


# ACNMP without one of its elements, or with the thesis's or the original code's choice instead.
# The last three sample around the policy's mean, as the thesis does.
PUSH_ABLATIONS: dict[str, Algorithm] = {
    "ACNMP": PUSH_ALGORITHMS["ACNMP"],
    "no latents": _acnmp(exploration=replace(_PUSH, latent=0.0)),
    "latents only": _acnmp(exploration=replace(_PUSH, noise=0.0, n_latents=6)),
    "contexts too": _acnmp(exploration=replace(_PUSH, context=0.5)),
    "noise not shaped": _acnmp(exploration=replace(_PUSH, shaped=0.0)),
    "noise half shaped": _acnmp(),
    "no pull": _acnmp(exploration=_PUSH, critic=ACNMPCritic(pull=0.0)),
    "thesis's decoder": _acnmp(
        exploration=_PUSH,
        policy_kwargs={"cnmp": CNMPArchitecture(context_in_decoder=True, linear_trend=False)},
    ),
    "policy gradient, to go": _acnmp(
        exploration=_PUSH, search="policy", adaptation=ACNMPAdaptation("to_go")
    ),
    "policy gradient, steps": _acnmp(
        exploration=_PUSH, search="policy", adaptation=ACNMPAdaptation("step")
    ),
    "policy gradient, pairs": _acnmp(
        exploration=_PUSH,
        search="policy",
        adaptation=ACNMPAdaptation("step"),
        population_size=2,
    ),
    "RL only": _acnmp(
        search="policy",
        adaptation=ACNMPAdaptation("to_go", supervised=False),
        exploration=replace(_PUSH, latent=0.0, shaped=0.0),
    ),
}

# Self-improvement over a stream of contexts (thesis 5.2.2, the second experiment).
_STREAM: dict[str, object] = {
    "n_contexts": 20,
    "population_size": 5,
    # A search begins where start and goal are missed by more than 0.1 m together, or the wall is
    # nearer than 0.63 m, and ends with half of that: what is learned is better than what suffices.
    "reward_threshold": (-0.1, -0.05),
    "max_generations": 15,
    "exploration_scale": 0.2,
    "exploration": ACNMPExploration.preset("stream"),
    "pretraining": CNMPPretraining.preset("stream"),
    "adaptation": ACNMPAdaptation.preset("stream"),
    "policy_kwargs": {"cnmp": CNMPArchitecture.preset("stream")},
}
APERTURE_ALGORITHMS: dict[str, Algorithm] = {
    "ACNMP": _acnmp(**_STREAM),
    "ProMP+RL (Ewerton)": _EWERTON,
}
APERTURE_ABLATIONS: dict[str, Algorithm] = {
    "ACNMP": APERTURE_ALGORITHMS["ACNMP"],
    "policy gradient too": _acnmp(
        **_STREAM | {"adaptation": replace(ACNMPAdaptation.preset("stream"), n_training_steps=10)}
    ),
    "no threshold": _acnmp(**_STREAM | {"reward_threshold": None}),
    "one threshold": _acnmp(**_STREAM | {"reward_threshold": -0.1}),
    "no latents": _acnmp(
        **_STREAM | {"exploration": replace(ACNMPExploration.preset("stream"), latent=0.0)}
    ),
    "context through latents": _acnmp(**_STREAM | {"policy_kwargs": {}}),
    "no linear trend": _acnmp(
        **_STREAM
        | {"policy_kwargs": {"cnmp": CNMPArchitecture(context_in_decoder=True, linear_trend=False)}}
    ),
}


@dataclass(frozen=True)
class Recipe:
    """What a suite is made of; `make_suite` multiplies it out.

    :param description: one line
    :param algorithms: by label, in the order of the tables
    :param tasks: task settings by task id
    :param budget: rollouts a run
    :param n_seeds: how many seeds by default, from 0 on
    :param protocols: each seed is run once in each
    """

    description: str
    algorithms: Mapping[str, Algorithm]
    tasks: Mapping[str, Mapping[str, object]]
    budget: int
    n_seeds: int
    protocols: tuple[Protocol, ...] = (OneContext(),)


BOTTLES: dict[str, dict[str, object]] = {"nmp/Bottles-v0": {}}
PUSH: dict[str, dict[str, object]] = {"nmp/Push-v0": {}}
APERTURE: dict[str, dict[str, object]] = {"nmp/Aperture-v0": {}}
POURING: dict[str, dict[str, object]] = {"nmp/Pouring-v0": {}}
PICK: dict[str, dict[str, object]] = {"nmp/PickAndPlace-v0": {}}
HELD_OUT = tuple(LeaveOneOut(t, t in EXTRAPOLATION_TARGETS) for t in range(len(TARGETS)))
BEYOND = tuple(protocol for protocol in HELD_OUT if protocol.extrapolation)

SUITES: dict[str, Recipe] = {
    "quick": Recipe("all methods on the bottles task", ALGORITHMS, BOTTLES, 400, 5),
    "bottles": Recipe("the same, for conclusions", ALGORITHMS, BOTTLES, 400, 50),
    "ablations": Recipe("RC-NMP without one of its elements", ABLATIONS, BOTTLES, 400, 20),
    "push": Recipe(
        "adaptation to each held-out pushing target", PUSH_ALGORITHMS, PUSH, 200, 5, HELD_OUT
    ),
    "push-ablations": Recipe(
        "ACNMP without one of its elements, pushing", PUSH_ABLATIONS, PUSH, 200, 5, BEYOND
    ),
    "aperture": Recipe(
        "self-improvement over a stream of apertures",
        APERTURE_ALGORITHMS,
        APERTURE,
        10_000,
        5,
        (Stream(),),
    ),
    "pouring": Recipe(
        "pouring amounts far beyond the demonstrated ones",
        POURING_ALGORITHMS,
        POURING,
        18,
        10,
        tuple(Extrapolation(target) for target in range(len(FULL))),
    ),
    "pick-and-place": Recipe(
        "objects and towers taller than the demonstrated ones",
        PICK_ALGORITHMS,
        PICK,
        100,
        10,
        tuple(Extrapolation(target) for target in range(len(TALL))),
    ),
    "aperture-ablations": Recipe(
        "ACNMP without one of its elements, apertures",
        APERTURE_ABLATIONS,
        APERTURE,
        10_000,
        5,
        (Stream(),),
    ),
}


def known_algorithms() -> dict[str, Algorithm]:
    """Return the algorithms of all suites by label; of equal labels the first suite's."""
    known: dict[str, Algorithm] = {}
    for recipe in SUITES.values():
        known |= {key: value for key, value in recipe.algorithms.items() if key not in known}
    return known


def make_suite(
    name: str,
    seeds: Iterable[int] | None = None,
    budget: int | None = None,
    labels: Sequence[str] | None = None,
) -> Suite:
    """Return the runs of a suite, seed by seed, so that an interrupted suite is balanced.

    :param name: one of `SUITES`
    :param seeds: the suite's own number of seeds, from 0 on, by default
    :param budget: rollouts a run; by default the suite's own, or the algorithm's where it has one
    :param labels: the algorithms to run; all by default. Case and punctuation do not matter
    :raises BenchmarkError: no such suite or algorithm, no seed, or a budget below 1
    """
    if name not in SUITES:
        raise BenchmarkError(f"no suite '{name}' is registered; there are {', '.join(SUITES)}.")
    recipe = SUITES[name]
    chosen = list(recipe.algorithms)
    if labels is not None:
        chosen = [find_label(label, chosen, f"the suite '{name}'") for label in labels]
    if budget is not None and budget < 1:
        raise BenchmarkError(f"the budget is {budget}; a run needs at least 1 rollout.")
    seeds = range(recipe.n_seeds) if seeds is None else list(seeds)
    specifications = [
        _specification(recipe, label, task, seed, budget, protocol)
        for task in recipe.tasks
        for seed in seeds
        for protocol in recipe.protocols
        for label in dict.fromkeys(chosen)
    ]
    return Suite(name, recipe.description, tuple(specifications))


def _specification(
    recipe: Recipe, label: str, task: str, seed: int, budget: int | None, protocol: Protocol
) -> RunSpecification:
    """Return one run of a suite; a budget given goes before the recipe's and the algorithm's."""
    algorithm = recipe.algorithms[label]
    own = budget is None and algorithm.budget is not None
    return RunSpecification(
        label,
        algorithm,
        task,
        seed,
        budget or algorithm.budget or recipe.budget,
        recipe.tasks[task],
        protocol=protocol,
        own_budget=own,
    )


def find_label(wanted: str, labels: Iterable[str], where: str) -> str:
    """Return the label that is meant, whatever its case and punctuation.

    >>> find_label("rcnmp", ["RC-NMP", "REPS"], "the suite")
    'RC-NMP'

    :param wanted: as the user typed it
    :param labels: those that exist
    :param where: for the message
    :raises BenchmarkError: none of them is meant
    """
    by_key = {_key(label): label for label in labels}
    if _key(wanted) not in by_key:
        raise BenchmarkError(
            f"{where} has no algorithm '{wanted}'; it has {', '.join(by_key.values())}."
        )
    return by_key[_key(wanted)]


def _key(label: str) -> str:
    return re.sub(r"[^a-z0-9]", "", label.lower())


def parse_seeds(text: str) -> list[int]:
    """Read seeds as users type them: how many, a range, or a list.

    >>> parse_seeds("3"), parse_seeds("10-12"), parse_seeds("7,9")
    ([0, 1, 2], [10, 11, 12], [7, 9])

    :param text: ``"N"`` for the first N, ``"A-B"`` for A to B inclusive, ``"A,B,C"`` for these
    :raises BenchmarkError: none of these, or no seed at all
    """
    seeds: list[int] = []
    if re.fullmatch(r"\d+", text):
        seeds = list(range(int(text)))
    elif match := re.fullmatch(r"(\d+)-(\d+)", text):
        seeds = list(range(int(match[1]), int(match[2]) + 1))
    elif re.fullmatch(r"\d+(,\d+)+,?|\d+,", text):
        seeds = sorted({int(part) for part in text.split(",") if part})
    if not seeds:
        raise BenchmarkError(
            f"the seeds '{text}' name no seed; write how many (5), a range (10-19) or a list "
            "(3,7; a single one as '3,')."
        )
    return seeds
