"""Demonstrations from CSV, from LeRobot and Minari datasets, and from recordings of any length."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sb3_nmp import Demonstrations, FileFormatError, InvalidDataError, resample
from sb3_nmp.common.csv_files import write_csv
from sb3_nmp.common.minari_files import read_minari

TABLE = """demonstration,time,context_x,context_y,q1,q2
a,0.0,0.5,-1,0.0,1.0
a,0.1,0.5,-1,0.2,1.5
b,0.0,0.7,2,3.0,0.0
a,0.4,0.5,-1,0.8,3.0
b,1.0,0.7,2,5.0,0.0
b,2.0,0.7,2,7.0,-4.0
"""


def table(folder: Path, text: str) -> Path:
    path = folder / "shown.csv"
    path.write_text(text)
    return path


# -- CSV -------------------------------------------------------------------------------------------


def test_a_table_is_read_by_demonstration_and_its_rows_may_be_mixed(tmp_path: Path) -> None:
    shown = Demonstrations.from_csv(table(tmp_path, TABLE))
    np.testing.assert_array_equal(shown.contexts, [[0.5, -1.0], [0.7, 2.0]])
    np.testing.assert_array_equal(shown.trajectories[0], [[0.0, 1.0], [0.2, 1.5], [0.8, 3.0]])
    np.testing.assert_array_equal(shown.trajectories[1], [[3.0, 0.0], [5.0, 0.0], [7.0, -4.0]])


def test_it_is_resampled_by_its_times(tmp_path: Path) -> None:
    shown = Demonstrations.from_csv(table(tmp_path, TABLE), n_steps=5)
    np.testing.assert_allclose(shown.trajectories[0, :, 0], [0.0, 0.2, 0.4, 0.6, 0.8])
    np.testing.assert_allclose(shown.trajectories[1, :, 1], [0.0, 0.0, 0.0, -2.0, -4.0])


def test_what_is_written_is_read_bit_for_bit(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    contexts = rng.standard_normal((3, 2)).astype(np.float32)
    trajectories = rng.standard_normal((3, 7, 4))
    write_csv(tmp_path / "new" / "x.csv", contexts, trajectories, np.linspace(0, 1, 7))
    read = Demonstrations.from_csv(tmp_path / "new" / "x.csv")
    np.testing.assert_array_equal(read.contexts, contexts)
    np.testing.assert_array_equal(read.trajectories, trajectories)
    header = (tmp_path / "new" / "x.csv").read_text().splitlines()[0]
    assert header == "demonstration,time,context_1,context_2,q1,q2,q3,q4"


def test_one_demonstration_without_times_and_contexts_given_apart(tmp_path: Path) -> None:
    path = table(tmp_path, "\ufeffq1, q2\n1,2\n\n3,4\n5,6\n")
    shown = Demonstrations.from_csv(path, contexts=[[9.0]])
    np.testing.assert_array_equal(shown.trajectories, [[[1, 2], [3, 4], [5, 6]]])
    assert shown.contexts.tolist() == [[9.0]]
    with pytest.raises(InvalidDataError, match="no column that begins with 'context'"):
        Demonstrations.from_csv(path)
    with pytest.raises(InvalidDataError, match="2 contexts were given for 1"):
        Demonstrations.from_csv(path, contexts=[[9.0], [8.0]])
    with pytest.raises(InvalidDataError, match="contexts must be numbers"):
        Demonstrations.from_csv(path, contexts=["a"])
    with pytest.raises(FileFormatError, match="the first row 1, 2; it must be the header"):
        Demonstrations.from_csv(table(tmp_path, "1,2\n3,4\n"), contexts=[[9.0]])
    with pytest.raises(InvalidDataError, match="'context_x', and contexts= are given"):
        Demonstrations.from_csv(table(tmp_path, TABLE), contexts=[[9.0], [8.0]])


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("0.2,1.5", "fast,1.5", r"row 3, column 'q1': 'fast' is no finite number"),
        ("0.2,1.5", "0.2,", r"row 3, column 'q2': '' is no finite number"),
        ("0.2,1.5", "nan,1.5", r"row 3, column 'q1': 'nan' is no finite number"),
        ("0.2,1.5", "0.2", r"row 3 has 5 cells; the header names 6 columns"),
        ("b,1.0,0.7,2", "b,1.0,0.7,3", r"row 6, column 'context_y'.*from 2.0 to 3.0.*'b'"),
        ("b,1.0", "b,0.0", r"row 6, column 'time': 0.0 follows 0.0 in demonstration 'b'"),
        ("q1,q2", "q1,q1", r"header names \['q1'\]; each column needs a name of its own"),
        ("q1,q2", "q1,", r"a column without a name"),
        ("q1,q2", "context_a,context_b", r"none of which is a dimension"),
        ("q1,q2", "Context_a,q2", r"'Context_a'.*begin with 'context' in small letters"),
        ("q1,q2", "Unnamed: 0,q2", r"the column 'Unnamed: 0', which would be a dimension"),
        ("q1,q2", "index,q2", r"the column 'index', which would be a dimension"),
        ("demonstration,time", "demonstration,time_us", r"'time_us'.*in a column 'time'"),
        ("time,context_x", "time,timestamp", r"'timestamp', which would be a dimension"),
        ("0.2,1.5", '0.2,"1.5', r"no comma-separated text"),
    ],
)
def test_a_wrong_table_is_refused_with_row_and_column(
    before: str, after: str, message: str, tmp_path: Path
) -> None:
    with pytest.raises(FileFormatError, match=message):
        Demonstrations.from_csv(table(tmp_path, TABLE.replace(before, after, 1)))


def test_tables_without_rows_and_of_different_lengths(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="no rows of numbers"):
        Demonstrations.from_csv(table(tmp_path, TABLE.splitlines()[0]))
    with pytest.raises(FileFormatError, match="none of which"):
        Demonstrations.from_csv(table(tmp_path, ""))
    shorter = table(tmp_path, TABLE.replace("b,1.0,0.7,2,5.0,0.0\n", ""))
    with pytest.raises(InvalidDataError, match="2 to 3 time points; give n_steps=3"):
        Demonstrations.from_csv(shorter)
    with pytest.raises(FileFormatError, match="from_csv"):
        Demonstrations.load(shorter)


# -- one length ------------------------------------------------------------------------------------


def test_a_set_is_resampled_and_its_ends_stay() -> None:
    shown = Demonstrations(np.array([[1.0]]), np.array([[[0.0, 1.0], [1.0, 3.0], [4.0, 5.0]]]))
    longer = shown.resample(5)
    np.testing.assert_allclose(longer.trajectories[0, :, 0], [0.0, 0.5, 1.0, 2.5, 4.0])
    np.testing.assert_array_equal(longer.trajectories[:, [0, -1]], shown.trajectories[:, [0, -1]])
    np.testing.assert_allclose(longer.resample(3).trajectories, shown.trajectories)


@pytest.mark.parametrize(
    ("rows", "n_steps", "times", "message"),
    [
        ([[[0.0], [1.0]]], 1, None, "n_steps is 1"),
        ([[[0.0]]], 3, None, r"trajectory 0 has shape \(1, 1\)"),
        ([[0.0, 1.0]], 3, None, r"trajectory 0 has shape \(2,\)"),
        ([[[0.0], [1.0]]], 3, [[0.0, 0.0]], "0.0 is followed by 0.0 at point 1"),
        ([[[0.0], [1.0]]], 3, [[0.0, 1.0, 2.0]], r"times of shape \(3,\)"),
        ([[[0.0], [1.0]]], 3, [], "times of 0 trajectories were given for 1"),
    ],
)
def test_what_cannot_be_resampled_is_said(
    rows: list[Any], n_steps: int, times: Any, message: str
) -> None:
    with pytest.raises(InvalidDataError, match=message):
        resample(rows, n_steps, times)


# -- LeRobot ---------------------------------------------------------------------------------------

EPISODES = {0: 4, 1: 6, 2: 5}


def write_lerobot(folder: Path, version: str) -> None:
    """Write a small dataset in one of LeRobot's layouts, its rows in no order."""
    pa = pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = [
        {
            "action": [episode + 0.1 * frame, -0.1 * frame],
            "observation.state": [float(episode), 2.0 + frame],
            "observation.weight": 5.0 + episode,
            "timestamp": 0.05 * frame,
            "frame_index": frame,
            "episode_index": episode,
            "index": frame,
        }
        for episode, length in EPISODES.items()
        for frame in range(length)
    ]
    rows = [rows[i] for i in np.random.default_rng(0).permutation(len(rows))]
    groups = {"chunk-000/file-000.parquet": rows}
    if version == "v2.1":
        groups = {
            f"chunk-000/episode_{i:06d}.parquet": [r for r in rows if r["episode_index"] == i]
            for i in EPISODES
        }
    for name, group in groups.items():
        path = folder / "data" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        parquet.write_table(pa.Table.from_pylist(group), path)
    numbers = {"dtype": "float32", "shape": [2], "names": None}
    features = {
        "action": numbers,
        "observation.state": numbers,
        "observation.weight": {"dtype": "float32", "shape": [1]},
        "observation.image": {"dtype": "video", "shape": [3, 4, 4]},
    }
    (folder / "meta").mkdir()
    (folder / "meta" / "info.json").write_text(
        json.dumps({"codebase_version": version, "fps": 20, "features": features})
    )


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_both_layouts_of_lerobot_are_read(version: str, tmp_path: Path) -> None:
    write_lerobot(tmp_path, version)
    shown = Demonstrations.from_lerobot(tmp_path, n_steps=4)
    np.testing.assert_allclose(shown.contexts, [[0, 2], [1, 2], [2, 2]])
    np.testing.assert_allclose(shown.trajectories[0, :, 0], [0.0, 0.1, 0.2, 0.3])
    np.testing.assert_allclose(shown.trajectories[2, [0, -1]], [[2.0, 0.0], [2.4, -0.4]])
    some = Demonstrations.from_lerobot(
        tmp_path, trajectory="observation.state", context="observation.weight", episodes=[2]
    )
    assert some.contexts.tolist() == [[7.0]] and some.trajectory_shape == (5, 2)
    with pytest.raises(InvalidDataError, match="4 to 6 time points; give n_steps=6"):
        Demonstrations.from_lerobot(tmp_path)


def test_what_is_no_lerobot_dataset_is_said(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=r"lacks meta/info\.json"):
        Demonstrations.from_lerobot(tmp_path)
    write_lerobot(tmp_path, "v3.0")
    with pytest.raises(
        InvalidDataError, match="no feature 'goal'; those of numbers are action, obs"
    ):
        Demonstrations.from_lerobot(tmp_path, context="goal")
    with pytest.raises(InvalidDataError, match=r"no episode \[7\]; it has 3"):
        Demonstrations.from_lerobot(tmp_path, episodes=[0, 7])
    for wrong in (0, [True, False], [0.0]):
        with pytest.raises(InvalidDataError, match="a list of episodes' numbers"):
            Demonstrations.from_lerobot(tmp_path, episodes=wrong)  # type: ignore[arg-type]
    file = next(tmp_path.rglob("*.parquet"))
    file.write_bytes(b"PAR1 nothing")
    with pytest.raises(FileFormatError, match=r"file-000\.parquet does not hold"):
        Demonstrations.from_lerobot(tmp_path)
    file.unlink()
    with pytest.raises(FileFormatError, match="no parquet file"):
        Demonstrations.from_lerobot(tmp_path)
    (tmp_path / "meta" / "info.json").write_text("{}")
    with pytest.raises(FileFormatError, match="tells no features"):
        Demonstrations.from_lerobot(tmp_path)


# -- Minari ----------------------------------------------------------------------------------------


class Recorded:
    """Stands for a Minari dataset of an environment with many steps."""

    def __init__(self, named: bool) -> None:
        self.named = named

    def iterate_episodes(self) -> list[SimpleNamespace]:
        made = []
        for index, length in enumerate((3, 5)):
            seen = np.full((length + 1, 2), float(index))
            goals = {"observation": seen, "desired_goal": seen + 10.0}
            actions = np.linspace([0.0], [1.0 + index], length)
            observations = goals if self.named else seen
            made.append(SimpleNamespace(id=index, observations=observations, actions=actions))
        return made


def test_episodes_with_many_steps_become_trajectories() -> None:
    pytest.importorskip("minari", reason="Minari is not installed")
    shown = Demonstrations.from_minari(Recorded(named=False), n_steps=3)
    assert shown.contexts.tolist() == [[0.0, 0.0], [1.0, 1.0]]
    np.testing.assert_allclose(shown.trajectories[..., 0], [[0.0, 0.5, 1.0], [0.0, 1.0, 2.0]])
    contexts, _ = read_minari(Recorded(named=True), 3, "desired_goal")
    assert contexts.tolist() == [[10.0, 10.0], [11.0, 11.0]]
    with pytest.raises(InvalidDataError, match=r"episode 0 has 3 steps.*Give n_steps"):
        Demonstrations.from_minari(Recorded(named=False))
    with pytest.raises(InvalidDataError, match="dictionaries with observation, desired_goal; name"):
        Demonstrations.from_minari(Recorded(named=True), n_steps=3)
    with pytest.raises(InvalidDataError, match="arrays without names"):
        Demonstrations.from_minari(Recorded(named=False), n_steps=3, context="desired_goal")


@pytest.mark.parametrize(
    ("names", "context_names", "told"),
    [
        (["q1", "time"], None, "names .'time'.; each column"),
        (["a,b", "q2"], None, "'a,b' cannot name a column"),
        (["q1 ", "q2"], None, "'q1 ' cannot name a column"),
        (["q1", "context_z"], None, "read as 2 entries of the context and 1 dimensions; the data"),
        (["q1"], None, "read as 1 entries of the context and 1 dimensions; the data have 1 and 2"),
        (None, ["x", "y"], "read as 2 entries"),
        (["step", "q2"], None, "has the column 'step', which would be a dimension"),
    ],
)
def test_names_that_would_not_be_read_are_not_written(
    names: list[str] | None, context_names: list[str] | None, told: str, tmp_path: Path
) -> None:
    path = tmp_path / "x.csv"
    with pytest.raises((FileFormatError, InvalidDataError), match=told):
        write_csv(path, [[0.5]], np.zeros((1, 3, 2)), [0, 1, 2], names, context_names)
    assert not path.exists()
