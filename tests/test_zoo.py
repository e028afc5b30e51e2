"""Our algorithms in the RL Zoo."""

import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest
from stable_baselines3.common.env_util import make_vec_env

import benchmark_envs  # noqa: F401
from sb3_nmp import ACNMP, RCNMP, ConfigurationError, Demonstrations, SmoothNoise
from sb3_nmp.zoo import cli
from sb3_nmp.zoo.entries import ENTRIES, demonstrations
from tests.registry import ENV_ID

ZOO = Path(cli.__file__).parent


class Trial:
    """Stands for a trial of Optuna: it takes the lowest value, or the first choice."""

    def suggest_float(self, name: str, low: float, high: float, log: bool) -> float:
        assert 0 < low < high or not log
        return low

    def suggest_int(self, name: str, low: int, high: int, log: bool) -> int:
        return low

    def suggest_categorical(self, name: str, choices: list[Any]) -> Any:
        return choices[0]


@pytest.mark.parametrize("name", ENTRIES)
def test_the_shipped_files_and_every_sample_make_a_model(name: str) -> None:
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed (extra zoo)")
    env, entry = make_vec_env(ENV_ID, 1), ENTRIES[name]
    told = yaml.safe_load((ZOO / f"{name}.yml").read_text())
    assert set(told) - {"default"} <= set(gym.registry)
    drawn = entry.sample(Trial(), 2, 1, {})
    settings = told["default"] | drawn
    settings.pop("n_timesteps")
    model = entry(env, seed=0, **settings)
    assert type(model) is entry.algorithm
    for key, value in drawn.items():
        if not isinstance(value, dict):
            assert getattr(model, key) == value


def test_groups_of_settings_and_demonstrations_are_made_of_plain_values(tmp_path: Path) -> None:
    env = make_vec_env(ENV_ID, 1)
    model: Any = ENTRIES["rcnmp"](env, seed=0, mutation={"sigma": 0.3, "n_bases": 5})
    assert model.mutation == SmoothNoise(sigma=0.3, n_bases=5)
    assert ENTRIES["acnmp"].convert({"a.b": 1, "c": 2, "a.d": 3}) == {"a": {"b": 1, "d": 3}, "c": 2}
    shown = Demonstrations.from_task(ENV_ID, 2, seed=3)
    assert demonstrations(2, env, 3) == shown
    shown.save(tmp_path / "shown.npz")
    assert demonstrations(str(tmp_path / "shown.npz"), env, None) == shown
    with pytest.raises(ConfigurationError, match=r"mutation is .*no settings of SmoothNoise"):
        ENTRIES["rcnmp"](env, mutation={"speed": 1})
    with pytest.raises(ConfigurationError, match=r"demonstrations is 'mine\.txt'"):
        demonstrations("mine.txt", env, None)


def test_what_is_added_to_the_command_line_and_what_is_not() -> None:
    given = ["--algo", "rcnmp", "--env", "nmp/Bottles-v0"]
    assert cli.completed("train", given) == [
        *given, "--conf-file", str(ZOO / "rcnmp.yml"), "--gym-packages", "benchmark_envs",
    ]  # fmt: skip
    own = ["--algo", "rcnmp", "--env", "mine/Env-v0", "-conf", "mine.yml"]
    assert cli.completed("train", own) == own
    assert cli.completed("enjoy", ["--algo", "ppo"]) == ["--algo", "ppo"]
    assert cli.main(["dance"]) == 2


def test_without_the_zoo_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cli, "find_spec", lambda name: None)
    with pytest.raises(ConfigurationError, match=r"pip install 'sb3-nmp\[zoo\]'"):
        cli.run(["train"])


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("rcnmp", ["population_size:4", "n_crossover:2", "training:{'n_steps':3}"]),
        ("acnmp", ["demonstrations:3", "pretraining:{'n_steps':5}"]),
    ],
)
def test_a_model_is_trained_loaded_and_enjoyed_through_the_zoo(
    name: str, settings: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rl_zoo3", reason="rl-zoo3 is not installed (extra zoo)")
    common = ["--algo", name, "--env", ENV_ID, "-f", str(tmp_path)]
    command = ["train", *common, "-n", "8", "--eval-freq", "4", "--seed", "1", "--device", "cpu"]
    before = list(sys.argv)
    cli.run([*command, "--save-freq", "4", "-params", *settings])
    assert sys.argv == before
    run = tmp_path / name / "nmp-Bottles-v0_1"
    assert (run / "best_model.zip").exists() and (run / "rl_model_4_steps.zip").exists()
    model = {"rcnmp": RCNMP, "acnmp": ACNMP}[name].load(run / "nmp-Bottles-v0.zip")
    assert model.num_timesteps == 8
    enjoy = ["enjoy", *common, "-n", "2", "--no-render", "--device", "cpu"]
    cli.run(enjoy)
    assert "2 Episodes" in capsys.readouterr().out
    trained = ["-i", str(run / "nmp-Bottles-v0.zip"), "-params", *settings]
    cli.run([*command, *trained])
    assert (tmp_path / name / "nmp-Bottles-v0_2" / "nmp-Bottles-v0.zip").exists()


@pytest.mark.filterwarnings("default")
def test_hyper_parameters_are_tuned_through_the_zoo(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rl_zoo3", reason="rl-zoo3 is not installed (extra zoo)")
    settings = ["population_size:4", "n_crossover:2", "training:{'n_steps':2}"]
    cli.run(
        [
            "train", "--algo", "rcnmp", "--env", ENV_ID, "-f", str(tmp_path), "-n", "8",
            "--optimize", "--n-trials", "2", "--n-evaluations", "1", "--eval-episodes", "1",
            "--no-optim-plots", "--seed", "1", "--device", "cpu", "-params", *settings,
        ]
    )  # fmt: skip
    printed = capsys.readouterr().out
    assert "Number of finished trials:  2" in printed and "mutation.sigma" in printed
