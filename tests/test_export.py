"""Exported files hold what was learned: read again, they give the same trajectory or answers."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import benchmark_envs
from baselines import REPS
from results.cli import USAGE_ERROR, main
from sb3_nmp import (
    ACNMP,
    RCNMP,
    ACNMPAdaptation,
    ACNMPPolicy,
    CNMPPretraining,
    ConfigurationError,
    Demonstrations,
    FileFormatError,
    InvalidDataError,
    RCNMPTraining,
)
from sb3_nmp.common.mcap_files import read_mcap, write_mcap
from sb3_nmp.common.onnx_files import export_onnx
from tests.registry import DEMONSTRATIONS, ENV_ID, SMALL


@pytest.fixture(scope="module")
def model() -> ACNMP:
    made = ACNMP(
        "MlpPolicy",
        gym.make(ENV_ID, random_bottles=True),
        demonstrations=DEMONSTRATIONS,
        pretraining=CNMPPretraining(20),
        adaptation=ACNMPAdaptation(n_training_steps=2, n_assimilation_steps=2),
        policy_kwargs={"cnmp": SMALL},
        seed=0,
    )
    return made.learn(3)


def reward_of(context: np.ndarray, trajectory: np.ndarray) -> float:
    env = gym.make(ENV_ID, random_bottles=True)
    env.reset(options={"context": context})
    return float(env.step(np.asarray(trajectory, np.float32))[1])


@pytest.mark.parametrize("ending", ["csv", "mcap"])
def test_an_exported_trajectory_is_executed_as_the_models_own(
    ending: str, model: ACNMP, tmp_path: Path
) -> None:
    """From the saved model through the command line to a file, and from that to a rollout."""
    if ending == "mcap":
        pytest.importorskip("mcap_ros2", reason="mcap-ros2-support is not installed (extra ros)")
    model.save(tmp_path / "model.zip")
    out = tmp_path / "new" / f"path.{ending}"
    source = [ENV_ID, "--model", str(tmp_path / "model.zip"), "--algorithm", "acnmp"]
    assert main(["export", *source, "--seed", "3", "--out", str(out), "--names", "x", "y"]) == 0
    task = benchmark_envs.make_task(ENV_ID)
    context = task.sample_context(np.random.default_rng(3)).astype(np.float32)
    own, _ = model.predict(context, deterministic=True)
    if ending == "csv":
        read = Demonstrations.from_csv(out)
        np.testing.assert_array_equal(read.contexts[0], context)
        trajectory = read.trajectories[0]
    else:
        names, times, trajectory = read_mcap(out)
        assert names == ["x", "y"]
        np.testing.assert_allclose(times, task.times, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(trajectory, own)
    assert reward_of(context, trajectory) == reward_of(context, own)


@pytest.mark.parametrize(
    ("limit", "said"),
    [
        (["--max-velocity", "3.5"], []),
        (
            ["--max-velocity", "0.1", "0.15", "9"],
            ["joint 1: velocity", "joint 2: velocity", "as long"],
        ),
        (["--max-jerk", "1e-9"], ["joint 3: jerk", "rad/s³"]),
        (["--max-velocity", "0"], ["velocity is [0.0]; it must be positive"]),
        (["--max-velocity", "1", "1"], ["one for each of the 3 dimensions"]),
    ],
)
def test_a_trajectory_beyond_the_limits_of_a_robot_is_not_written(
    limit: list[str], said: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "path.csv"
    status = main(["export", "nmp/Push-v0", "--expert", "default", "--out", str(out), *limit])
    told = capsys.readouterr().err
    assert (status, out.exists()) == ((0, True) if not said else (USAGE_ERROR, False))
    assert all(part in told for part in said), told


# -- ONNX ------------------------------------------------------------------------------------------


def answers(path: Path, contexts: np.ndarray) -> np.ndarray:
    runtime = pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
    session = runtime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    return session.run(["trajectories"], {"contexts": contexts.astype(np.float32)})[0]


def test_acnmps_policy_answers_alike_as_onnx(model: ACNMP, tmp_path: Path) -> None:
    pytest.importorskip("onnx", reason="onnx is not installed (extra onnx)")
    model.policy.save(tmp_path / "policy")
    policy = ACNMPPolicy.load(tmp_path / "policy")
    space: Any = model.observation_space
    rng = np.random.default_rng(0)
    contexts = rng.uniform(space.low, space.high, (40, space.shape[0])).astype(np.float32)
    known = contexts[:2]  # where rollouts far from the network's answers are remembered
    policy.elites.update(known, policy.greedy(known) + 0.1, np.full(2, 9.0), np.ones(2, bool))
    export_onnx(policy, tmp_path / "policy.onnx")
    for asked in (contexts, contexts[:1], contexts[5:6]):
        expected, _ = policy.predict(asked, deterministic=True)
        np.testing.assert_allclose(answers(tmp_path / "policy.onnx", asked), expected, atol=1e-5)
    own = policy.own_answer(known)
    assert own is not None and np.abs(own - policy.greedy(known)).mean() > 0.01


def test_rcnmps_policy_of_one_context_answers_alike_as_onnx(tmp_path: Path) -> None:
    pytest.importorskip("onnx", reason="onnx is not installed (extra onnx)")
    small = {"population_size": 8, "n_crossover": 4, "training": RCNMPTraining(5)}
    model = RCNMP("MlpPolicy", ENV_ID, seed=0, **small).learn(16)
    export_onnx(model.policy, tmp_path / "policy.onnx")
    context = gym.make(ENV_ID).reset(seed=0)[0][None]
    for asked in (context, context + 0.01):
        expected, _ = model.policy.predict(asked, deterministic=True)
        np.testing.assert_allclose(answers(tmp_path / "policy.onnx", asked), expected, atol=1e-5)


def test_policies_that_onnx_has_no_words_for_say_so(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"GaussianPrimitivePolicy .*\.csv or \.mcap"):
        export_onnx(REPS("MlpPolicy", ENV_ID).policy, tmp_path / "policy.onnx")


def test_a_model_in_the_place_of_its_policy_is_told(tmp_path: Path) -> None:
    model: Any = REPS("MlpPolicy", ENV_ID)
    with pytest.raises(ConfigurationError, match=r"give model\.policy, not the model"):
        export_onnx(model, tmp_path / "policy.onnx")


# -- wrong use -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--expert", "s", "--out", "path.txt"], "its ending must be one of .csv, .mcap, .onnx"),
        (["--expert", "s", "--out", "path.csv", "--names", "x"], "--names has 1 names; 2 are"),
        (["--expert", "s", "--out", "p.mcap", "--names", "x", "x"], "--names is ['x', 'x']; each"),
        (["--expert", "s", "--out", "p.csv", "--names", "x", ""], "--names is ['x', '']; each"),
        (["--expert", "s", "--out", "p.mcap", "--names", "x", " "], "--names is ['x', ' ']; each"),
        (["--expert", "s", "--out", "p.onnx", "--names", "x", "y"], "leave --names out"),
        (["--expert", "s", "--out", "p.onnx", "--context", "1"], "leave --context out"),
        (["--expert", "s", "--out", "p.csv", "--names", "time", "y"], "needs a name of its own"),
        (["--expert", "s", "--out", "policy.onnx"], "give its model (--model)"),
        (["--model", "missing.zip", "--out", "path.csv"], "there is no model 'missing.zip'"),
    ],
)
def test_wrong_use_of_export_is_said(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", ENV_ID, *arguments]) == USAGE_ERROR
    assert message in capsys.readouterr().err


def test_messages_and_files_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("mcap_ros2", reason="mcap-ros2-support is not installed (extra ros)")
    path = tmp_path / "path.mcap"
    with pytest.raises(InvalidDataError, match=r"shape \(3, 2\), times of shape \(2,\) and 2"):
        write_mcap(path, np.zeros((3, 2)), [0.0, 0.1])
    with pytest.raises(InvalidDataError, match="times increase"):
        write_mcap(path, np.zeros((2, 2)), [0.1, 0.1])
    with pytest.raises(InvalidDataError, match="positions must be finite"):
        write_mcap(path, np.full((2, 2), np.nan), [0.1, 0.2])
    path.write_bytes(b"no such file")
    with pytest.raises(FileFormatError, match="no MCAP file"):
        read_mcap(path)
