"""``nmp-bench report``: one self-contained HTML page about the runs of a folder."""

import argparse
import io
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the command line answers at once: what is slow to import waits
    from results.harness.records import RunRecord
    from results.report.html import Picture

RUNS = Path("results/runs")


def add_report(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments.

    :param parser: of ``nmp-bench report``
    """
    parser.description = "Write tables, figures and a rollout's pictures as one HTML page."
    parser.set_defaults(command=report)
    parser.add_argument("--suite", help="its folder is results/runs/SUITE (default: quick)")
    parser.add_argument("--runs", type=Path, metavar="DIR", help="folder of the runs")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="what to write (default: report.html there)"
    )


def report(options: argparse.Namespace) -> int:
    """Do ``nmp-bench report``.

    :param options: the parsed arguments
    :raises BenchmarkError: no readable run in the folder
    """
    from results.exceptions import BenchmarkError
    from results.harness.record_files import read_records

    folder = options.runs or RUNS / (options.suite or "quick")
    held = read_records(folder)
    if not held.records:
        raise BenchmarkError(
            f"'{folder}' holds no readable runs; make some with 'nmp-bench run', or name another "
            "folder (--runs)."
        )
    out = options.out or folder / "report.html"
    out.parent.mkdir(parents=True, exist_ok=True)
    text = page_of(held.records, folder, tuple(held.unreadable.values()))
    out.write_text(text, encoding="utf-8")
    print(f"Written: {out}")
    return 0


def page_of(records: "Sequence[RunRecord]", folder: Path, unreadable: Sequence[str] = ()) -> str:
    """Return the page about some runs.

    :param records: of one protocol
    :param folder: where they lie, for the commands that make a figure again
    :param unreadable: sentences about files that are left out
    """
    from results.harness.records import finished, labels_of
    from results.report.html import html_page, svg_picture
    from results.report.text_table import Page, Section
    from results.reports import figures, report_for

    labels, done = labels_of(records), finished(records)
    made = report_for(records)
    page = made.tables(made.frame(records), labels)
    page = Page(page.tables, [Section("Files left out", unreadable), *page.sections])
    again = f"nmp-bench plot --runs {shlex.quote(str(folder))}"
    drawn = figures(records, labels) if done else {}
    pictures = [
        svg_picture(figure, _caption(figure, name), f"From {len(done)} finished runs: {again}")
        for name, figure in drawn.items()
    ]
    return html_page(_title(records), page, [*pictures, *_rollouts(done, folder)], _facts(records))


def _title(records: "Sequence[RunRecord]") -> str:
    names = sorted({record.specification.suite.name for record in records} - {""})
    tasks = sorted({record.specification.task for record in records})
    return f"{', '.join(names) or 'Runs'}: {', '.join(tasks)}"


def _facts(records: "Sequence[RunRecord]") -> dict[str, str]:
    """Return where the runs come from."""
    seeds = sorted({record.specification.seed for record in records})
    origins = [record.provenance for record in records]
    commits = {
        f"{o.commit or 'unknown'}{' with local changes' if o.dirty else ''}" for o in origins
    }
    names = ("mujoco", "numpy", "torch", "stable-baselines3")
    versions = {", ".join(f"{name} {o.packages.get(name)}" for name in names) for o in origins}
    n_done = sum(record.finished for record in records)
    return {
        "runs": f"{n_done} of {len(records)} finished",
        "seeds": ", ".join(map(str, seeds)),
        "commit": ", ".join(sorted(commits)),
        "versions": "; ".join(sorted(versions)),
        "dates": f"{min(o.started for o in origins)} to {max(o.started for o in origins)}",
    }


def _caption(figure: object, name: str) -> str:
    get_suptitle = getattr(figure, "get_suptitle", None)
    title = get_suptitle() if get_suptitle else ""
    return " ".join(title.split()) or name


def _rollouts(done: "Sequence[RunRecord]", folder: Path) -> "list[Picture]":
    """Return pictures of the best greedy rollout of each task, where it can be drawn here."""
    from benchmark_envs import TaskError
    from benchmark_envs.exceptions import RenderingUnavailableError
    from results.report.html import Picture

    shown: dict[str, RunRecord] = {}
    drawable = [record for record in done if "greedy" in record.measured.rollouts]
    for record in sorted(drawable, key=lambda record: record.curve["greedy_reward"][-1]):
        shown[record.specification.task] = record
    pictures = []
    for task, record in shown.items():
        path = folder / f"{record.specification.stem}.json"
        made = f"nmp-bench render {task} --run {shlex.quote(str(path))} --out rollout.png"
        try:
            content = _sheet(record)
        except (RenderingUnavailableError, TaskError):
            continue
        caption = f"{record.specification.name}: its last greedy rollout, the best of all runs"
        pictures.append(Picture(caption, made, content, "image/png"))
    return pictures


def _sheet(record: "RunRecord") -> bytes:
    """Return a sheet of pictures of a run's last greedy rollout, as PNG."""
    import numpy as np

    from benchmark_envs import make_task
    from results.rollout_sheet import save_sheet

    asked, known = record.specification, record.measured.context
    task = make_task(asked.task, n_threads=1, **asked.task_settings)
    context = () if known is None else known.values
    trajectory = np.asarray(record.measured.rollouts["greedy"].trajectory, np.float32)
    frames, buffer = task.frames(context, trajectory), io.BytesIO()
    save_sheet(frames, task, task.simulate(context, trajectory), buffer)
    return buffer.getvalue()
