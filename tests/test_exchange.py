"""Runs of others come in as records, and ours go out to IOHanalyzer."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.monitor import Monitor

from benchmark_envs import ViaPointsTask
from results.cli import main
from results.exceptions import BenchmarkError
from results.exchange.iohprofiler import export_iohprofiler
from results.exchange.sb3_evaluations import Source, import_evaluations
from results.harness.record_files import read_record, write_record
from results.harness.records import ProtocolRecord, RolloutRecord, SuiteRecord
from tests.records_fakes import curve_of, failed_run, finished_run, specification
from tests.results_fakes import HillClimber

TASK = "nmp/ViaPoints-v0"


def test_what_an_eval_callback_wrote_stands_in_a_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A stranger's run, made with SB3 alone, beside one of the harness with the same budget."""
    env = Monitor(gym.make(TASK))
    context = env.reset(seed=0)[0]
    pinned = Monitor(gym.make(TASK, context=context))
    seen = EvalCallback(pinned, eval_freq=5, n_eval_episodes=2, verbose=0, log_path=str(tmp_path))
    HillClimber("MlpPolicy", gym.make(TASK, context=context), seed=0).learn(20, callback=seen)
    runs = str(tmp_path / "runs")
    ours = ["run", "--task", TASK, "--algorithm", "random-search", "--seeds", "1", "--budget", "20"]
    assert main([*ours, "--workers", "1", "--out", runs]) == 0
    theirs = ["import-sb3", str(tmp_path / "evaluations.npz"), "--task", TASK, "--label", "Hers"]
    assert main([*theirs, "--out", runs]) == 0
    record = read_record(next(Path(runs).glob("hers*.json")))
    assert record.curve["rollouts"] == [5, 10, 15, 20] and record.specification.budget == 20
    assert record.curve["greedy_reward"][-1] == pytest.approx(seen.last_mean_reward)
    assert record.provenance.commit is None and record.seconds.training is None
    capsys.readouterr()
    assert main(["table", "--runs", runs]) == 0 and main(["plot", "--runs", runs]) == 0
    lines = Path(runs, "table.md").read_text().splitlines()
    row = next(line for line in lines if line.startswith("| Hers"))
    assert f"{record.curve['greedy_reward'][-1]:.4f}" in row and row.endswith("| – | – | – | – |")
    assert (Path(runs) / "curves_viapoints-v0.png").exists()


def evaluations(folder: Path, **changes: Any) -> Path:
    arrays = {
        "timesteps": np.array([10, 20, 30]),
        "results": np.array([[-3.0, -3.0], [-1.0, -1.0], [-2.0, -2.0]]),
        "ep_lengths": np.ones((3, 2), int),
        "successes": np.array([[False, False], [True, True], [False, False]]),
    } | changes
    kept = {name: value for name, value in arrays.items() if value is not None}
    np.savez(folder / "evaluations.npz", **kept)
    return folder / "evaluations.npz"


def test_a_curve_holds_what_the_evaluations_tell(tmp_path: Path) -> None:
    path = import_evaluations(Source(evaluations(tmp_path), TASK, "Hers", 7), tmp_path / "runs")
    assert path.name == "hers_viapoints-v0_seed-007.json"
    assert read_record(path).curve == {
        "rollouts": [10, 20, 30],
        "best_reward": [-3.0, -1.0, -1.0],
        "best_success": [False, True, True],
        "any_success": [False, True, True],
        "greedy_reward": [-3.0, -1.0, -2.0],
        "greedy_success": [False, True, False],
    }


def test_no_sign_of_a_reward_is_a_success(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A task whose rewards are positive: successes alone say what is solved."""
    monkeypatch.setattr(ViaPointsTask, "reward_range", (-3.0, 9.0))
    results = np.array([[3.0, 3.0], [5.0, 5.0], [4.0, 4.0]])
    for label, solved in (("Never", [0, 0, 0]), ("Last", [0, 0, 1])):
        told = np.repeat(np.array(solved, bool)[:, None], 2, axis=1)
        path = evaluations(tmp_path, results=results, successes=told)
        curve = read_record(import_evaluations(Source(path, TASK, label), tmp_path / "runs")).curve
        assert curve["greedy_success"] == [bool(each) for each in solved]
        assert curve["best_reward"] == [3.0, 5.0, 5.0] and not any(curve["best_success"])
    assert main(["table", "--runs", str(tmp_path / "runs")]) == 0
    capsys.readouterr()
    lines = (tmp_path / "runs" / "table.md").read_text().splitlines()
    rows = {line.split(" | ")[0]: line.split(" | ")[2] for line in lines if " % |" in line}
    assert rows["| Never"].startswith("0/1") and rows["| Last"].startswith("1/1")


def test_a_budget_leaves_later_evaluations_out_and_steps_are_divided(tmp_path: Path) -> None:
    lengths = np.full((3, 2), 10)
    source = Source(evaluations(tmp_path, ep_lengths=lengths), TASK, "Hers", budget=2, steps=10)
    record = read_record(import_evaluations(source, tmp_path / "runs"))
    assert record.curve["rollouts"] == [1, 2] and record.specification.budget == 2


#: by fault: arrays, what the source says otherwise, and parts of the message
BAD: dict[str, tuple[dict[str, Any], dict[str, Any], tuple[str, ...]]] = {
    "no successes": ({"successes": None}, {}, ("has no successes", "is_success")),
    "ragged episodes": (
        {"results": np.array([[1.0], [1.0, 2.0]], object)}, {},
        ("no readable evaluations.npz", "equally many episodes"),
    ),
    "half of the rows": (
        {"results": np.zeros((2, 2))}, {}, ("(2, 2)", "a row per evaluation"),
    ),
    "nothing": (
        {"timesteps": np.zeros(0), "results": np.zeros((0, 2))}, {},
        ("a time step per evaluation",),
    ),
    "time backwards": ({"timesteps": np.array([10, 5, 30])}, {}, ("[10, 5, 30]", "ascend")),
    "steps in words": ({"timesteps": np.array(["a", "b", "c"])}, {}, ("dtype <U1", "be numbers")),
    "no budget at all": ({}, {"budget": 0}, ("--budget is 0", "at least 1 rollout")),
    "half a step": ({"timesteps": np.array([10.5, 20, 30])}, {}, ("[10.5, 20.0", "whole number")),
    "a reward of nan": ({"results": np.full((3, 2), np.nan)}, {}, ("nan", "finite")),
    "rewards above the task's best": (
        {"results": np.array([[-3.0, -3.0], [5.0, 5.0], [4.0, 4.0]])}, {},
        ("the reward 5, and none of nmp/ViaPoints-v0 is above 0", "--task", "norm_reward=False"),
    ),
    "long episodes": (
        {"ep_lengths": np.full((3, 2), 50)}, {},
        ("last [50] steps", "counted in rollouts", "--steps"),
    ),
    "half a rollout": (
        {"ep_lengths": np.full((3, 2), 4)}, {"steps": 4},
        ("after [10, 20, 30] steps", "lasts 4", "eval_freq"),
    ),
    "several contexts": (
        {"results": np.array([[-3.0, -1.0]] * 3)}, {},
        ("[-3.0, -1.0]", "several contexts", "context=c"),
    ),
    "a budget too small": ({}, {"budget": 5}, ("first evaluation after 10", "budget of 5")),
    "shares of successes": (
        {"successes": np.full((3, 2), 0.5)}, {}, ("successes of [0.5]", "must be 0 or 1"),
    ),
    "a label of nothing": ({}, {"label": ""}, ("--label is ''", "a letter or a digit")),
    "a seed below 0": ({}, {"seed": -3}, ("--seed is -3", "in [0, 4294967295]")),
    "an unknown task": ({}, {"task": "nmp/ViaPoint-v0"}, ("nmp/ViaPoints-v0",)),
}  # fmt: skip


@pytest.mark.parametrize("kind", BAD)
def test_evaluations_that_tell_no_run_are_refused(kind: str, tmp_path: Path) -> None:
    changes, said, parts = BAD[kind]
    source = Source(**{"path": evaluations(tmp_path, **changes), "task": TASK, "label": "H"} | said)
    with pytest.raises(ValueError) as caught:
        import_evaluations(source, tmp_path / "runs")
    assert [part for part in parts if part not in str(caught.value)] == [], str(caught.value)
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04 damaged"])
def test_a_damaged_file_is_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "evaluations.npz").write_bytes(content)
    with pytest.raises(BenchmarkError, match=r"no readable evaluations\.npz"):
        import_evaluations(Source(tmp_path / "evaluations.npz", TASK, "H"), tmp_path)


def test_nothing_is_replaced_or_mixed_unasked(tmp_path: Path) -> None:
    runs, source = tmp_path / "runs", Source(evaluations(tmp_path), TASK, "Hers")
    import_evaluations(source, runs)
    with pytest.raises(BenchmarkError, match=r"is there already.*--overwrite"):
        import_evaluations(source, runs)
    import_evaluations(source, runs, overwrite=True)
    shorter = Source(source.path, TASK, "Hers", 1, budget=20)
    with pytest.raises(BenchmarkError, match=r"budget of 30 rollouts.*ends at 20"):
        import_evaluations(shorter, runs)


# -- IOHanalyzer -----------------------------------------------------------------------------------


def records() -> list[Any]:
    """Two algorithms, two seeds, two variants; one run failed."""
    line = RolloutRecord([[0.0, 1.0]] * 5, None, True)
    made = []
    for label, start in (("A", -4.0), ("B, judged", -8.0)):
        for seed in (3, 4):
            for variant in ("", "hard"):
                curve = curve_of([start, start / 2, start - seed], [False, True, False])
                asked = specification(label, seed, budget=3, variant=variant)
                made.append(finished_run(asked, curve, rollouts={"greedy": line}))
    return [*made, failed_run(specification("A", 9))]


def test_the_files_for_iohanalyzer_hold_every_run_from_its_first_rollout(tmp_path: Path) -> None:
    written = export_iohprofiler(records(), tmp_path / "ioh")
    names = sorted(str(path.relative_to(tmp_path / "ioh")) for path in written)
    assert names == [
        f"{folder}/IOHprofiler_f{number}_bottles-v0{ending}.json"
        for folder in ("a", "b-judged") for number, ending in ((1, ""), (2, "-hard"))
    ]  # fmt: skip
    content = json.loads((tmp_path / "ioh" / names[0]).read_text())
    (scenario,) = content["scenarios"]
    assert content["maximization"] is True and scenario["dimension"] == 10
    assert [run["instance"] for run in scenario["runs"]] == [3, 4]
    assert scenario["runs"][0]["best"] == {"evals": 2, "y": -2.0, "x": []}
    rows = (tmp_path / "ioh/a" / scenario["path"]).read_text().splitlines()
    assert rows[:3] == [
        "evaluations raw_y greedy_reward greedy_success",
        "1 -4.0000000000 -4.0000000000 0",
        "2 -2.0000000000 -2.0000000000 1",
    ]
    assert [row.split()[0] for row in rows[1:]] == ["1", "2", "3"] * 2


def of_several_tasks() -> list[Any]:
    """Two tasks in two contexts each; names that are written alike; a seed of 17 bits."""
    line = RolloutRecord([[0.0, 1.0]] * 5, None, True)
    made = []
    for label, told, suite in (("GA", True, "push"), ("GA+", True, "push"), ("Hers", False, "")):
        for task in ("nmp/Push-v0", "nmp/Bottles-v0"):
            for number in (1, 2):
                for seed in (3, 70000):
                    protocol = ProtocolRecord("leave-one-out", number=number)
                    of = SuiteRecord(suite)
                    asked = specification(label, seed, task, 3, protocol, of)
                    curve = curve_of([-4.0, -2.0], [False, True])
                    held = {"greedy": line} if told else None
                    made.append(finished_run(asked, curve, rollouts=held))
    return made


def test_a_function_has_one_number_dimension_and_suite_in_all_files(tmp_path: Path) -> None:
    written = export_iohprofiler(of_several_tasks(), tmp_path / "ioh")
    assert len(set(written)) == len(written) == 3 * 4
    assert sorted({path.parent.name for path in written}) == ["ga", "ga-2", "hers"]
    read = [json.loads(path.read_text()) for path in written]
    numbers = {(each["function_id"], each["function_name"]) for each in read}
    assert numbers == {
        (1, "nmp/Bottles-v0, target 1"), (2, "nmp/Bottles-v0, target 2"),
        (3, "nmp/Push-v0, target 1"), (4, "nmp/Push-v0, target 2"),
    }  # fmt: skip
    assert {each["suite"] for each in read} == {"sb3-nmp"}
    assert {each["scenarios"][0]["dimension"] for each in read} == {10}
    instances = [[run["instance"] for run in each["scenarios"][0]["runs"]] for each in read]
    assert instances == [[1, 2]] * 12, "the seeds' places, as 70000 is too large for the reader"


def test_the_command_counts_functions_and_algorithms(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number, record in enumerate(of_several_tasks()):
        write_record(tmp_path / f"{number}.json", record)
    out = str(tmp_path / "ioh")
    assert main(["export-ioh", "--runs", str(tmp_path), "--out", out]) == 0
    assert "Written: 4 functions, with runs of 3 algorithms, in" in capsys.readouterr().out


@pytest.mark.filterwarnings("ignore")  # of polars and of the reader
def test_iohinspector_reads_several_tasks_and_contexts(tmp_path: Path) -> None:
    iohinspector: Any = pytest.importorskip("iohinspector", reason="reads the export back")
    export_iohprofiler(of_several_tasks(), tmp_path / "ioh")
    manager = iohinspector.DataManager()
    manager.add_folder(str(tmp_path / "ioh"))
    seen = manager.overview
    assert len(seen) == 3 * 4 * 2 and seen["data_id"].n_unique() == len(seen)
    functions = seen.select("suite", "function_id", "function_name", "dimension").unique()
    assert len(functions) == 4
    assert sorted(seen["algorithm_name"].unique()) == ["GA", "GA+", "Hers"]


@pytest.mark.filterwarnings("ignore")  # of polars and of the reader
def test_iohinspector_reads_what_was_exported(tmp_path: Path) -> None:
    iohinspector: Any = pytest.importorskip("iohinspector", reason="reads the export back")
    for number, record in enumerate(records()):
        write_record(tmp_path / f"{number}.json", record)
    out = str(tmp_path / "ioh")
    assert main(["export-ioh", "--runs", str(tmp_path), "--out", out]) == 0
    manager = iohinspector.DataManager()
    manager.add_folder(out)
    seen = manager.overview
    assert len(seen) == 8 and set(seen["algorithm_name"]) == {"A", "B, judged"}
    assert sorted(seen["best_y"].to_list()) == [-4.0] * 4 + [-2.0] * 4
    data = manager.select(algorithms=["A"], function_ids=[1]).load(include_meta_data=True)
    one = data.filter(data["instance"] == 4).sort("evaluations")
    assert one["raw_y"].to_list() == [-4.0, -2.0]  # rows that repeat are left out


def no_first(folder: Path) -> list[Any]:
    return [finished_run(specification("A", 0), curve_of([-1.0], [True], first=10))]


def a_stream(folder: Path) -> list[Any]:
    asked = specification("A", 0, protocol=ProtocolRecord("stream"))
    return [finished_run(asked, {"rollouts": [1], "failure_rate": [0.5]})]


def occupied(folder: Path) -> list[Any]:
    (folder / "ioh").mkdir()
    (folder / "ioh/notes.txt").touch()
    return records()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (no_first, "tells nothing before rollout 10.*leave this run out"),
        (a_stream, "has no best_reward"),
        (occupied, "name a new folder"),
        (lambda _: [failed_run(specification("A", 0))], "no run has finished"),
    ],
)
def test_what_cannot_be_exported_is_told(
    make: Callable[[Path], list[Any]], message: str, tmp_path: Path
) -> None:
    made = make(tmp_path)
    with pytest.raises(BenchmarkError, match=message):
        export_iohprofiler(made, tmp_path / "ioh")
