"""Self-improvement over a stream of 1000 apertures (thesis 5.2.2, second experiment), 5 seeds."""

from dataclasses import replace

from results.algorithms import ACNMP, EWERTON
from results.harness.suite import Recipe
from results.stream.protocol import Stream
from sb3_nmp import ACNMPAdaptation, ACNMPExploration, CNMPArchitecture, CNMPPretraining

#: settings of ACNMP for a stream
STREAM: dict[str, object] = {
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
ALGORITHMS = {"ACNMP": replace(ACNMP, settings=STREAM), "ProMP+RL (Ewerton)": EWERTON}
TASKS: dict[str, dict[str, object]] = {"nmp/Aperture-v0": {}}
RECIPE = Recipe(ALGORITHMS, TASKS, budget=10_000, n_seeds=5, protocols=(Stream(),))
