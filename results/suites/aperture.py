"""Self-improvement over a stream of 1000 apertures (thesis 5.2.2, second experiment), 5 seeds."""

from dataclasses import replace

from results.algorithms import (
    ACNMP,
    CONTEXTUAL_CMAES,
    CONTEXTUAL_REPS,
    EWERTON,
    SUM_ALONE,
    thesis_acnmp,
    twin,
    twins,
)
from results.harness.suite import Recipe
from results.stream.protocol import Stream
from results.tuning.streams import TuningStream
from sb3_nmp import (
    ACNMPAdaptation,
    ACNMPExploration,
    CNMPPretraining,
)

#: What is satisfactory, for ACNMP and its twins alike. A search begins where start and goal are
#: missed by more than 0.1 m together, or the wall is nearer than 0.63 m, and ends with half of
#: that: what is learned is better than what suffices. Then one solution is enough.
SEARCH: dict[str, object] = {"reward_threshold": (-0.1, -0.05), "n_successes": 1}
#: of the thesis, for its apertures: a search begins at a failure, whatever the reward
OF_THESIS: dict[str, object] = {
    "n_contexts": 20,
    "reward_threshold": (-60.0, -0.1),
    "max_generations": 1000,
    "n_successes": 1,
    "learning_rate": 1e-4,
    "exploration_scale": 0.1,
    "exploration": ACNMPExploration(
        n_bases=50, shaped=0.0, radius=1.0, growth=1.0, shrinkage=1.0, retry_answer=True
    ),
    "adaptation": ACNMPAdaptation("step", n_training_steps=50, reward_weight=1.0),
    "pretraining": CNMPPretraining(n_steps=4000, batch_size=32),
}
#: of the contextual searches: the budget is ten rollouts for each context, as much as a search may
#: spend there
SHARED: dict[str, object] = {"rollouts_per_context": 10, "exploration_scale": 0.2}
ALGORITHMS = {
    "ACNMP": replace(ACNMP, settings=SEARCH),
    "ACNMP, sum alone": replace(ACNMP, settings=SEARCH | SUM_ALONE),
    **twins("nearest", "quadratic", "Gaussian process", **SEARCH),
    "twin, Gaussian process, sum alone": twin("Gaussian process", **SEARCH, **SUM_ALONE),
    "ACNMP (thesis)": thesis_acnmp(**OF_THESIS),
    "ProMP+RL (Ewerton)": EWERTON,
    "contextual REPS": replace(CONTEXTUAL_REPS, settings=SHARED),
    "contextual CMA-ES": replace(CONTEXTUAL_CMAES, settings=SHARED),
}
TASKS: dict[str, dict[str, object]] = {"nmp/Aperture-v0": {}}
TUNING = (TuningStream(n_test=100, n_evaluations=12),)
RECIPE = Recipe(ALGORITHMS, TASKS, 10_000, n_seeds=5, protocols=(Stream(),), tuning=TUNING)
