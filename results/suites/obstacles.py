"""Via-points beyond the demonstrations, among four ellipses (thesis 5.2.1), 5 seeds."""

from dataclasses import replace

from benchmark_envs.tasks.obstacles import EXTRAPOLATION_HEIGHTS
from results.adaptation.protocol import Extrapolation
from results.algorithms import (
    ACNMP,
    NETWORK_DRIVES,
    THESIS_NETWORK,
    thesis_acnmp,
    twins,
)
from results.harness.suite import Recipe
from sb3_nmp import ACNMPAdaptation, ACNMPExploration, ShapedExploration

#: as in the suite push: what is to be found is like what was shown
EXPLORATION = ACNMPExploration.preset("push")
OURS: dict[str, object] = {"exploration": EXPLORATION, "population_size": 3}
OF_TWINS = OURS | {"exploration": ShapedExploration.preset("push")}
OF_THESIS: dict[str, object] = {"policy_kwargs": {"cnmp": THESIS_NETWORK}}
#: one rollout, the answer itself, from which nothing is learned
NO_SEARCH: dict[str, object] = {
    "population_size": 1,
    "adaptation": ACNMPAdaptation(n_training_steps=0, n_assimilation_steps=0),
}
#: the policy gradient alone, and noise that is alike everywhere
RL: dict[str, object] = {
    **NETWORK_DRIVES,
    **OF_THESIS,
    "adaptation": ACNMPAdaptation(supervised=False),
    "exploration": ACNMPExploration(shaped=0.0),
}
#: of the thesis's code, for its obstacles: nearly independent noise, 50 supervised steps an update
THESIS_SEARCH: dict[str, object] = {
    "exploration_scale": 0.1,
    "exploration": ACNMPExploration(
        n_bases=50, shaped=0.0, radius=1.0, growth=1.0, shrinkage=1.0, retry_answer=True
    ),
    "adaptation": ACNMPAdaptation("step", n_training_steps=50, reward_weight=1.0),
}
ALGORITHMS = {
    "ACNMP": replace(ACNMP, settings=OURS),
    "ACNMP, network drives": replace(ACNMP, settings=OURS | NETWORK_DRIVES),
    "ACNMP, thesis's network": replace(ACNMP, settings=OURS | OF_THESIS),
    "ACNMP (thesis)": thesis_acnmp(**THESIS_SEARCH),
    **twins("nearest", "ridge", "Gaussian process", **OF_TWINS),
    "LfD alone": replace(
        ACNMP, settings=NO_SEARCH, budget=1, description="ACNMP's network, no search"
    ),
    "LfD alone, thesis's network": replace(
        ACNMP,
        settings=NO_SEARCH | OF_THESIS,
        budget=1,
        description="context in the decoder, time as it is, no linear parts; no search",
    ),
    "RL after LfD": replace(
        ACNMP,
        settings=RL,
        budget=100,
        description="demonstrations first, then the policy gradient without them",
    ),
    "RL alone": replace(
        ACNMP,
        settings=RL,
        budget=100,
        shown_initial=True,
        description="the same policy gradient from a flat line, no demonstrations",
    ),
}
TASKS: dict[str, dict[str, object]] = {"nmp/Obstacles-v0": {}}
PROTOCOLS = tuple(Extrapolation(target) for target in range(len(EXTRAPOLATION_HEIGHTS)))
#: rollouts that the thesis's ACNMP took
PUBLISHED = 35
RECIPE = Recipe(ALGORITHMS, TASKS, PUBLISHED, 5, PROTOCOLS, (0, 10, PUBLISHED), PUBLISHED)
