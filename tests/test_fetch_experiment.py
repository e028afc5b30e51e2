"""The picture and the table of the Fetch experiment are made from its files alone."""

import json
from pathlib import Path

from results.experiments.fetch_figure import draw


def test_the_table_tells_each_run_and_the_picture_is_drawn(tmp_path: Path) -> None:
    for task, method, seed, solved in (
        ("FetchReach-v4", "RC-NMP", 0, 0.9),
        ("FetchReach-v4", "RC-NMP", 1, 1.0),
        ("FetchPush-v4", "PPO", 0, 0.25),
    ):
        curve = [
            {"rollouts": 100, "n_contexts": 50, "solved": solved / 2},
            {"rollouts": 200, "n_contexts": 200, "solved": solved},
        ]
        record = {"task": task, "method": method, "seed": seed, "curve": curve, "minutes": 1.25}
        (tmp_path / f"{task}_{method}_{seed}.json").write_text(json.dumps(record))
    table = draw(tmp_path, tmp_path / "picture.png")
    assert len(table.splitlines()) == 5
    assert "| FetchPush-v4 | PPO | 0 | 100: 0.125 of 50, 200: 0.250 of 200 | 1.2 |" in table
    assert (tmp_path / "picture.png").stat().st_size > 10_000
