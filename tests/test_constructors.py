"""Constructors: every argument is shown, described, saved and refused where it does not exist."""

import inspect
import pydoc
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Unpack, get_args

import cloudpickle
import pytest
from stable_baselines3.common.base_class import BaseAlgorithm

import sb3_nmp
from baselines import BO, DREPS, GA, REPS, EwertonProMPRL, StarkProMPRL
from sb3_nmp import ACNMP, RCNMP, ConfigurationError, TrajectoryAlgorithm, UnknownArgumentError
from sb3_nmp.common.adaptive import AdaptiveAlgorithm
from sb3_nmp.common.arguments import SB3Arguments, SharedArguments
from sb3_nmp.common.population import PopulationSearch
from sb3_nmp.common.settings import settings_name, stable_name
from sb3_nmp.models.networks import ACTIVATIONS
from tests.registry import ALGORITHMS, ENV_ID
from tests.test_algorithms import build

BASES = [TrajectoryAlgorithm, AdaptiveAlgorithm, PopulationSearch]
EVERY = pytest.mark.parametrize("algorithm", ALGORITHMS, ids=lambda a: a.__name__)
EVERY_AND_BASES = pytest.mark.parametrize(
    "algorithm", [*ALGORITHMS, *BASES], ids=lambda a: a.__name__
)
SETTINGS = [
    sb3_nmp.ACNMPAdaptation,
    sb3_nmp.ACNMPCritic,
    sb3_nmp.ACNMPExploration,
    sb3_nmp.CNMPArchitecture,
    sb3_nmp.CNMPPretraining,
    sb3_nmp.PDController,
    sb3_nmp.RCNMPTraining,
    sb3_nmp.ShapedExploration,
    sb3_nmp.SmoothNoise,
]


def parameters(algorithm: Any) -> dict[str, inspect.Parameter]:
    return dict(inspect.signature(algorithm).parameters)


# -- what is shown ---------------------------------------------------------------------------------


@EVERY_AND_BASES
def test_the_signature_names_every_argument_and_the_docstring_describes_it(algorithm: Any) -> None:
    shown = parameters(algorithm)
    assert {*SharedArguments.__annotations__, "policy", "env", "population_size"} <= {*shown}
    for name, parameter in shown.items():
        assert parameter.kind is not parameter.VAR_KEYWORD
        assert algorithm.__doc__.count(f":param {name}:") == 1, name
        if name not in ("policy", "env"):
            assert parameter.kind is parameter.KEYWORD_ONLY, name
    described = [line for line in algorithm.__doc__.splitlines() if line.startswith(":param")]
    assert [line.split()[1].rstrip(":") for line in described] == [*shown]


@EVERY
def test_every_argument_but_policy_and_environment_has_a_default(algorithm: Any) -> None:
    without = [n for n, p in parameters(algorithm).items() if p.default is p.empty]
    assert without == ["policy", "env"]
    assert parameters(algorithm)["device"].default == "cpu"


def test_defaults_that_differ_by_algorithm_are_visible() -> None:
    sizes = {a.__name__: parameters(a)["population_size"].default for a in ALGORITHMS}
    if find_spec("ribs"):
        assert sizes.pop("CMAME") == 20
    assert sizes == {
        "RCNMP": 20, "GA": 20, "REPS": 20, "DREPS": 20, "StarkProMPRL": 20, "EwertonProMPRL": 10,
        "ACNMP": 1, "BO": 1, "CMAES": 5, "ContextualREPS": 50, "ContextualCMAES": 50,
        "RandomSearch": 5, "TuRBO": 5, "LogEI": 5,
    }  # fmt: skip
    longest = [parameters(a)["max_generations"].default for a in (ACNMP, BO, StarkProMPRL)]
    assert longest == [60, 60, 50]
    assert parameters(RCNMP)["n_crossover"].default == 16
    assert parameters(GA)["n_crossover"].default == 18
    assert parameters(DREPS)["epsilon"].default == parameters(REPS)["epsilon"].default == 1.5


def test_help_shows_the_descriptions_that_are_written_once() -> None:
    text = pydoc.plain(pydoc.render_doc(REPS))
    assert "class REPS(" in text
    for part in (":param seed: of Python", ":param epsilon: bound on KL", "verbose: int = 0"):
        assert part in text
    assert "a tenth of the" in (EwertonProMPRL.__doc__ or "")
    assert "What is known from demonstrations" not in (ACNMP.__doc__ or "")


def test_the_shared_arguments_are_those_of_sb3_and_of_the_base_class() -> None:
    assert {*SB3Arguments.__annotations__} <= {*inspect.signature(BaseAlgorithm).parameters}
    for algorithm in [*ALGORITHMS, *BASES]:
        init = algorithm.__dict__.get("__init__")
        for parameter in inspect.signature(init).parameters.values() if init else ():
            if parameter.kind is parameter.VAR_KEYWORD:
                (passed_on,) = get_args(parameter.annotation)
                known = {*parameters(algorithm.__mro__[1])}
                assert {*passed_on.__annotations__} <= known, algorithm


# -- what is refused -------------------------------------------------------------------------------


@EVERY
def test_an_argument_that_does_not_exist_is_refused_with_the_alternatives(algorithm: Any) -> None:
    with pytest.raises(UnknownArgumentError, match=r"has no argument 'populaton_size'; did you"):
        algorithm("MlpPolicy", ENV_ID, populaton_size=20)
    with pytest.raises(TypeError, match=r"no argument 'wings'\. It has policy, env, .*exploration"):
        algorithm("MlpPolicy", "nmp/no-such-task", wings=2)
    with pytest.raises(TypeError, match="positional"):
        algorithm("MlpPolicy", ENV_ID, 20)


def test_an_argument_of_another_algorithm_is_refused() -> None:
    with pytest.raises(UnknownArgumentError, match="GA has no argument 'learning_rate'"):
        GA("MlpPolicy", ENV_ID, learning_rate=0.1)  # pyright: ignore[reportCallIssue]
    with pytest.raises(UnknownArgumentError, match="REPS has no argument 'xi'"):
        REPS("MlpPolicy", ENV_ID, xi=5.0)  # pyright: ignore[reportCallIssue]


@EVERY
@pytest.mark.parametrize("scale", [0.0, -0.1, float("nan"), (0.1, 0.1, 0.1)])
def test_a_wrong_exploration_scale_is_refused(algorithm: Any, scale: Any) -> None:
    with pytest.raises(ConfigurationError, match=r"exploration_scale is .* a tuple of 2: one per"):
        build(algorithm, exploration_scale=scale)


@EVERY
def test_the_exploration_scale_is_the_environments_unless_one_is_given(algorithm: Any) -> None:
    found = build(algorithm).first_scale()
    assert build(algorithm, exploration_scale=0.05).first_scale() == (0.05, 0.05)
    assert build(algorithm, exploration_scale=(0.05, 0.1)).first_scale() == (0.05, 0.1)
    env_scale = build(RCNMP).get_env().get_attr("exploration_scale")[0]
    assert found == pytest.approx(tuple(env_scale * algorithm.default_exploration))


# -- subclasses, saving ----------------------------------------------------------------------------


class Timid(REPS):
    """REPS that explores less.

    :param boldness: share of the scale
    """

    def __init__(
        self, policy: str, env: Any, *, boldness: float = 0.5, **shared: Unpack[SharedArguments]
    ) -> None:
        self.boldness = boldness
        super().__init__(policy, env, **shared)


class Loose(REPS):
    def __init__(self, policy: str, env: Any, **anything: Any) -> None:
        super().__init__(policy, env, **anything)


def test_a_subclass_passes_on_what_it_names() -> None:
    assert {"boldness", "seed", "device"} <= {*parameters(Timid)}
    assert "epsilon" not in parameters(Timid)
    assert ":param boldness: share" in (Timid.__doc__ or "")
    assert ":param seed: of Python" in (Timid.__doc__ or "")
    with pytest.raises(UnknownArgumentError, match="Timid has no argument 'epsilon'"):
        Timid("MlpPolicy", ENV_ID, epsilon=1.0)  # pyright: ignore[reportCallIssue]
    assert Loose("MlpPolicy", ENV_ID, epsilon=1.0).epsilon == 1.0
    assert Loose.__doc__ is None


def test_bases_may_be_mixed_in_and_undocumented() -> None:
    class Talkative:
        """No algorithm."""

    class Mixed(Talkative, Loose):
        """REPS that talks."""

    class Strict(Mixed, REPS):
        """REPS again."""

        def __init__(self, policy: str, env: Any, **shared: Unpack[SharedArguments]) -> None:
            super().__init__(policy, env, **shared)

    assert "anything" in parameters(Mixed)
    assert ":param seed: of Python" in (Strict.__doc__ or "")


class Wings(SharedArguments, total=False):
    wings: int


def test_a_class_that_passes_on_what_its_base_does_not_have_is_refused() -> None:
    with pytest.raises(UnknownArgumentError, match="Lost passes on 'wings', which Timid does not"):

        class Lost(Timid):
            def __init__(self, policy: str, env: Any, **shared: Unpack[Wings]) -> None: ...


@EVERY
def test_classes_and_models_are_pickled_and_loaded(algorithm: Any, tmp_path: Path) -> None:
    model = build(algorithm, seed=3)
    again = cloudpickle.loads(cloudpickle.dumps(algorithm))
    assert inspect.signature(again) == inspect.signature(algorithm)
    model.save(tmp_path / "model")
    loaded = again.load(tmp_path / "model", env=model.get_env())
    assert loaded.seed == 3
    assert loaded.population_size == model.population_size
    assert loaded.exploration_scale is None


# -- settings and their names ----------------------------------------------------------------------


def test_every_settings_class_has_a_name_of_its_own_and_is_found_at_the_top() -> None:
    names = [stable_name(cls) for cls in SETTINGS]
    assert names == [
        "acnmp-adaptation", "acnmp-critic", "acnmp-exploration", "cnmp-architecture",
        "cnmp-pretraining", "pd-controller", "rcnmp-training", "shaped-exploration",
        "smooth-noise",
    ]  # fmt: skip
    for algorithm in ALGORITHMS:
        for name, parameter in parameters(algorithm).items():
            if hasattr(parameter.default, "__dataclass_fields__"):
                assert stable_name(type(parameter.default)), name
    assert [stable_name(activation) for activation in ACTIVATIONS.values()] == [*ACTIVATIONS]


def test_a_class_without_a_name_is_refused_and_a_name_is_given_once() -> None:
    class Nameless: ...

    with pytest.raises(ConfigurationError, match=r"Nameless has no name for files: .*smooth-noise"):
        stable_name(Nameless)
    with pytest.raises(ConfigurationError, match="'smooth-noise' belongs to SmoothNoise"):
        settings_name("smooth-noise")(Nameless)
    assert stable_name(settings_name("smooth-noise")(sb3_nmp.SmoothNoise)) == "smooth-noise"


def test_presets_are_had_by_name() -> None:
    for cls in SETTINGS:
        for name in getattr(cls, "presets", ()):
            assert cls.preset(name) != cls()  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(ConfigurationError, match="has no preset 'brook'; it has push"):
        sb3_nmp.ACNMPExploration.preset("brook")
