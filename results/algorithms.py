"""The algorithms of the benchmark, by stable name; suites give them settings and labels."""

from results.harness.specification import Algorithm

RCNMP = Algorithm("rcnmp", "sb3_nmp:RCNMP", description="reward-conditioned neural process")
ACNMP = Algorithm("acnmp", "sb3_nmp:ACNMP", description="adaptive conditional neural process")
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
BY_NAME = {
    algorithm.name: algorithm
    for algorithm in (RCNMP, ACNMP, GA, DREPS, REPS, CMAES, STARK, EWERTON)
}
