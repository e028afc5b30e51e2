import io
import pickle
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.image import imread
from PIL import Image
from rich.console import Console

from baselines import GA
from benchmark_envs import MujocoTask, RenderingUnavailableError, TaskError, make_task
from results import render
from results.cli import main
from results.exceptions import BenchmarkError, RecordError, UnreadableRecordError
from results.export import export
from results.harness.record_files import read_record, read_records
from results.harness.records import labels_of
from results.harness.specification import Algorithm, plain
from results.harness.suite import Recipe, make_suite, parse_seeds
from results.one_context.figures import enlarged_limits, learning_curves
from results.one_context.protocol import OneContext
from results.one_context.summary import frame
from results.one_context.tables import tables
from results.render import Look, RenderRequest, chosen_rollout, render_rollout, write_film
from results.report.figure_style import line_style
from results.report.frames import curves_frame
from results.rollout_sheet import told
from results.suites import describe_suites, find_recipe, suite_names
from sb3_nmp.common.noise import SmoothNoise
from tests.results_fakes import suite_of

FAKES = {
    "Hill": Algorithm("hill", "tests.results_fakes:HillClimber", description="climbs"),
    "Broken": Algorithm("broken", "tests.results_fakes:Broken"),
    "Absent": Algorithm("absent", "tests.results_fakes:NoSuchClass"),
}


@pytest.fixture(scope="module", autouse=True)
def fake_suite():
    """A suite of cheap algorithms."""
    recipe = Recipe(FAKES, {"nmp/Bottles-v0": {}}, 12, 2, (OneContext(),))
    with suite_of({"fakes": recipe}):
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The fake suite's runs: two finished, one finished and one failed, two failed."""
    out = tmp_path_factory.mktemp("runs")
    assert main(["run", "--suite", "fakes", "--out", str(out), "--workers", "1"]) == 0
    return out


def shown(folder: Path, width: int) -> str:
    console = Console(file=io.StringIO(), width=width, color_system=None)
    console.print(tables(frame(read_records(folder).records), list(FAKES)).terminal(width))
    file = console.file
    assert isinstance(file, io.StringIO)
    return file.getvalue()


def test_table_shows_the_greedy_policy_and_the_best_rollout_alike(
    folder: Path, capsys: pytest.CaptureFixture[str]
):
    assert main(["table", "--runs", str(folder)]) == 0
    printed = capsys.readouterr().out
    markdown = (folder / "table.md").read_text()
    numbers = pd.read_csv(folder / "table.csv")
    for view in ("greedy", "best"):
        assert view in printed
        for column in ("solved", "rollouts", "reward", "IQM"):
            assert f"{view} {column}" in markdown
        assert {f"{view}_solved", f"{view}_rollouts_median", f"{view}_iqm_low"} <= set(numbers)
    assert numbers.set_index("label")["seeds"].to_dict() == {"Hill": 2, "Broken": 1, "Absent": 0}


def test_table_gives_the_reason_of_failed_runs_and_empty_cells(folder: Path):
    runs = frame(read_records(folder).records)
    for text in (shown(folder, 120), tables(runs).markdown()):
        assert "2 failed" in text and "Absent on nmp/Bottles-v0" in text
        assert "the matrix is singular (seeds 0)" in text
        assert "NoSuchClass" in text
        assert "one seed" in text
        assert "Commit" in text and "Hill: climbs." in text


def test_an_algorithm_of_the_suite_without_runs_is_shown(folder: Path):
    records = read_records(folder).records
    assert labels_of(records) == list(FAKES)
    assert "not run" in tables(frame(records), ["Other", *FAKES]).markdown()


@pytest.mark.parametrize("width", [80, 100, 120])
def test_table_fits_the_terminal(folder: Path, width: int):
    text = shown(folder, width)
    assert max(len(line.rstrip()) for line in text.splitlines()) <= width
    assert "…" not in text


def test_plots_are_drawn(folder: Path):
    assert main(["plot", "--runs", str(folder)]) == 0
    for name in ("curves_bottles-v0.png", "rollouts_bottles-v0.png"):
        picture = imread(folder / name)
        assert picture.shape[0] > 400 and picture.shape[1] > 900
        assert len(np.unique(picture[..., 0])) > 10


def test_curves_name_their_axes_and_seeds(folder: Path):
    figure = learning_curves(curves_frame(read_records(folder).records), list(FAKES))
    assert [axes.get_xlabel() for axes in figure.axes] == ["rollouts"] * 3
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["Hill (2 seeds)", "Broken (1 seed)"]


def test_enlarged_panel_shows_the_solved_runs():
    curves = pd.DataFrame(
        {
            "label": "A",
            "variant": "",
            "seed": [0, 0, 1, 1],
            "rollouts": [1, 2, 1, 2],
            "greedy_reward": [-8.0, -0.13, -8.0, -2.1],
            "greedy_success": [False, True, False, False],
        }
    )
    low, high = enlarged_limits(curves)
    assert -0.2 < low < -0.13 < high < -0.1


def test_an_algorithm_has_one_colour_in_all_figures_and_no_other_one_its_line():
    styles = {}
    for name in set(suite_names()) - {"fakes"}:
        labels = list(find_recipe(name).algorithms)
        styles[name] = {label: line_style(label, labels) for label in labels}
        looks = {tuple(map(str, style.values())) for style in styles[name].values()}
        assert len(looks) == len(labels), name
    for label in ("RC-NMP", "REPS", "GA", "ACNMP", "twin, nearest", "CMA-ES context"):
        found = {each[label]["color"] for each in styles.values() if label in each}
        assert len(found) == 1, label


def test_a_film_is_as_fast_as_the_rollout_or_says_its_speed(tmp_path: Path):
    frames = [np.full((120, 160, 3), 5 * i, np.uint8) for i in range(50)]
    asked = {1.0: 50, 0.5: 50, 1.5: 50, 3.0: 50, 10.0: 25}  # pictures
    for speed, n_pictures in asked.items():
        write_film(frames, tmp_path / "film.gif", 8.0, speed)
        with Image.open(tmp_path / "film.gif") as film:
            assert getattr(film, "n_frames", 1) == n_pictures
            lasts = 0.0
            for i in range(n_pictures):
                film.seek(i)
                lasts += film.info["duration"]
            assert lasts == pytest.approx(1000 * 50 / 8.0 / speed, abs=10)  # ms
            film.seek(0)
            corner = np.asarray(film.convert("RGB"))[:40, :120]
            assert (np.ptp(corner) > 0) == (speed != 1.0)


def test_a_rollout_is_drawn_as_asked_from_any_camera(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expert = RenderRequest("nmp/Bottles-v0", expert="s")
    try:
        render_rollout(expert, tmp_path / "film.gif", Look("top", (64, 48)))
    except RenderingUnavailableError as error:
        pytest.skip(str(error))
    render_rollout(expert, tmp_path / "usual.gif", Look(size=(64, 48)))
    with Image.open(tmp_path / "film.gif") as top, Image.open(tmp_path / "usual.gif") as usual:
        assert top.size == (64, 48)
        assert np.any(np.asarray(top.convert("RGB")) != np.asarray(usual.convert("RGB")))
    render_rollout(expert, tmp_path / "sheet.png", Look(size=(160, 120)))
    height, width = imread(tmp_path / "sheet.png").shape[:2]
    assert width > 1000 and height > 600
    with monkeypatch.context() as patch:
        patch.setattr(MujocoTask, "frames", lambda self, context, trajectory, width, height: [])
        with pytest.raises(BenchmarkError, match=r"--camera is 'top'.*takes no other"):
            render_rollout(expert, tmp_path / "own.gif", Look("top"))
    with pytest.raises(TaskError, match="no camera 'side'; there are overview, top"):
        render_rollout(expert, tmp_path / "film.gif", Look("side"))
    with pytest.raises(TaskError, match="5000 x 48 pixels cannot be drawn"):
        render_rollout(expert, tmp_path / "film.gif", Look(size=(5000, 48)))


def test_a_sheet_tells_context_and_outcome():
    task = make_task("nmp/Push-v0")
    context = task.sample_context(np.random.default_rng(0))
    still = task.simulate(context, task.initial_trajectory(context))
    assert told(task, still).startswith("target x [m] = ")
    assert "no success, reward -" in told(task, still)


def test_a_run_can_be_rendered_from_its_file(folder: Path):
    run = next(folder.glob("hill_*.json"))
    _, context, trajectory = chosen_rollout(RenderRequest("nmp/Bottles-v0", run=run))
    assert context.shape == (4,) and trajectory.shape == (200, 2)
    with pytest.raises(BenchmarkError, match="a failed run"):
        failed = next(folder.glob("broken_*.failed.json"))
        chosen_rollout(RenderRequest("nmp/Bottles-v0", run=failed))
    with pytest.raises(BenchmarkError, match="--context does not go with --run"):
        chosen_rollout(RenderRequest("nmp/Bottles-v0", run=run, context=(0.0,)))


def test_what_is_no_run_is_not_advised_to_be_removed(tmp_path: Path):
    model = tmp_path / "b.zip"
    GA("MlpPolicy", "nmp/Bottles-v0").save(model)
    for path, why in ((model, "is no record of a run"), (tmp_path / "x.json", "there is no file")):
        with pytest.raises(BenchmarkError, match=why) as caught:
            chosen_rollout(RenderRequest("nmp/Bottles-v0", run=path))
        assert "emove" not in str(caught.value)
    other = RenderRequest("nmp/Push-v0", model=model, algorithm="ga")
    with pytest.raises(BenchmarkError, match="name the model's task"):
        export(other, tmp_path / "policy.onnx")
    with pytest.raises(BenchmarkError, match=r"contexts of shape \(4,\).*name the model's task"):
        chosen_rollout(other)
    alike = RenderRequest("nmp/Aperture-v0", model=model, algorithm="ga")
    with pytest.raises(BenchmarkError, match=r"contexts of shape \(4,\).*name the model's task"):
        chosen_rollout(alike)


def test_no_model_is_drawn_whose_file_could_run_code(tmp_path: Path):
    model = tmp_path / "ppo.zip"
    model.touch()
    foreign = RenderRequest("nmp/Bottles-v0", model=model, algorithm="stable_baselines3:PPO")
    with pytest.raises(BenchmarkError, match=r"PPO is no TrajectoryAlgorithm.*\(--run\)"):
        chosen_rollout(foreign)


def test_a_damaged_run_and_an_older_one_are_told_apart(folder: Path, tmp_path: Path):
    """Whatever caused the error: who gives the exception another cause changes no message."""
    text = next(folder.glob("hill_*.json")).read_text()
    for content, kind, why in (
        (text[:-50], BenchmarkError, "is no record of a run"),
        (text.replace('"format": 2', '"format": 1'), RecordError, "is of format 1"),
        (text.replace('"format": 2', '"format": 9'), RecordError, "is of format 9.*update"),
    ):
        path = tmp_path / "run.json"
        path.write_text(content)
        with pytest.raises(RecordError) as read:
            read_record(path)
        damaged = kind is BenchmarkError
        assert isinstance(read.value, UnreadableRecordError) == damaged
        with pytest.raises(kind, match=why) as caught:
            chosen_rollout(RenderRequest("nmp/Bottles-v0", run=path))
        if damaged:
            assert isinstance(read.value, UnreadableRecordError) and read.value.why
            assert read.value.why in str(caught.value)
            again = pickle.loads(pickle.dumps(read.value))
            assert (str(again), again.why) == (str(read.value), read.value.why)


def test_a_record_error_without_a_cause_is_told_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def damaged(path: Path) -> None:
        raise UnreadableRecordError("remove it", why="half of it is missing")

    monkeypatch.setattr(render, "read_record", damaged)
    (tmp_path / "run.json").write_text("")
    with pytest.raises(BenchmarkError, match=r"no record of a run \(half of it is missing\)"):
        chosen_rollout(RenderRequest("nmp/Bottles-v0", run=tmp_path / "run.json"))


BOTTLES = ["nmp/Bottles-v0", "--expert", "s", "--out", "x.gif"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["run", "--suite", "nope"],
            "there are ablations, aperture, aperture-abl",
        ),
        (["table", "table-5.1"], "'nmp-bench run --suite push' and 'nmp-bench run --suite aper"),
        (["table", "table-5.1", "--suite", "push"], "leave out --suite"),
        (["run", "--suite", "fakes", "--algorithms", "nope"], "it has 'Hill', 'Broken', 'Absent'"),
        (["run", "--suite", "fakes", "--seeds", "0"], "write how many"),
        (["run", "--suite", "fakes", "--seeds", "5-3"], "write how many"),
        (["run", "--suite", "fakes", "--seeds", "99999999999"], "a range name at most 10000"),
        (["run", "--suite", "fakes", "--seeds", "4294967296,"], "must be below 2^32"),
        (["run", "--suite", "fakes", "--budget", "0"], "at least 1 rollout"),
        (["run", "--suite", "fakes", "--workers", "0"], "at least 1 process"),
        (["table", "--runs", "nowhere"], "holds no readable runs"),
        (
            ["plot", "--suite", "nope"],
            "there are ablations, aperture, aperture-abl",
        ),
        (["render", "nmp/Bottles-v0", "--expert", "s", "--out", "x.jpg"], ".gif, .mp4, .png"),
        (["render", "nmp/Bottles-v0", "--expert", "z", "--out", "x.gif"], "s, reverse_s"),
        (["render", "nmp/Bottle-v0", "--expert", "s", "--out", "x.gif"], "nmp/Bottles-v0"),
        (["render", *BOTTLES, "--speed", "0"], "--speed is 0.0; it must be between"),
        (["render", *BOTTLES, "--context", "1", "2"], "shape"),
    ],
)
def test_wrong_usage_is_told_in_one_line(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
):  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert message in error and error.startswith("nmp-bench: ") and error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_clash_of_settings_is_told_in_one_line(folder: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["run", "--suite", "fakes", "--budget", "13", "--out", str(folder)]) == 2
    assert "budget = 12" in capsys.readouterr().err


@pytest.mark.parametrize("command", [[], ["run"], ["table"], ["plot"], ["render"]])
def test_help_is_given(command: list[str], capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as caught:
        main([*command, "--help"])
    assert caught.value.code == 0
    assert "usage: nmp-bench" in capsys.readouterr().out


def test_algorithms_are_found_whatever_their_case_and_punctuation():
    quick = make_suite("quick", find_recipe("quick"), labels=["rcnmp", "reps"])
    assert quick.labels == ["RC-NMP", "REPS"]


@pytest.mark.parametrize("name", suite_names())
def test_runs_of_a_suite_have_files_of_their_own(name: str):
    runs = make_suite(name, find_recipe(name), seeds=range(3)).specifications
    assert len({run.stem for run in runs}) == len(runs)
    assert all(run.record for run in runs)
    assert "seeds" in describe_suites()[name]


def test_seeds_are_read():
    assert parse_seeds("2") == [0, 1]
    assert parse_seeds("8-10") == [8, 9, 10]
    assert parse_seeds("3,1,3") == [1, 3]
    assert parse_seeds("4,") == [4]


def test_settings_become_plain_values():
    noise = plain({"mutation": SmoothNoise(0.1), "sizes": (1, 2), "none": None})
    assert noise["mutation"]["settings"] == "smooth-noise"
    assert noise["mutation"]["sigma"] == 0.1 and noise["sizes"] == [1, 2]
    with pytest.raises(BenchmarkError, match="plain values"):
        plain({"function": lambda: None})
