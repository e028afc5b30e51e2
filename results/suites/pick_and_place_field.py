"""Object and goal anywhere on a field of 30 x 30 cm, six numbers a context: a stream; 3 seeds."""

from dataclasses import replace

from results.algorithms import ACNMP, twins
from results.harness.suite import Recipe
from results.stream.protocol import Stream
from sb3_nmp import ACNMPExploration, CNMPArchitecture, CNMPPretraining, ShapedExploration

#: settings of ACNMP and of its twins
SEARCH: dict[str, object] = {
    "n_contexts": 20,
    # 99 of 100 rollouts above the first one succeed (`PickAndPlaceTask`), and what is learned is to
    # be better than what suffices.
    "reward_threshold": (-0.04, -0.02),
}
# As in the suite pick-and-place: grasp, carry and release are apart in time.
OF_ACNMP = SEARCH | {"exploration": ACNMPExploration(n_bases=8)}
OF_TWINS = SEARCH | {"exploration": ShapedExploration(n_bases=8)}
OF_STREAMS = OF_ACNMP | {
    "pretraining": CNMPPretraining.preset("stream"),
    "policy_kwargs": {"cnmp": CNMPArchitecture.preset("stream")},
}
ALGORITHMS = {
    "ACNMP": replace(ACNMP, settings=OF_ACNMP),
    "ACNMP, context in decoder": replace(
        ACNMP,
        settings=OF_STREAMS,
        description="the context goes to the decoder too, and pre-training is longer",
    ),
    **twins("nearest", "ridge", "quadratic", "Gaussian process", **OF_TWINS),
}
TASKS: dict[str, dict[str, object]] = {"nmp/PickAndPlace-v1": {"field": True}}
RECIPE = Recipe(ALGORITHMS, TASKS, 1000, 3, (Stream(40, 5000, 500, n_evaluations=1),))
