"""Tables of runs: for the terminal, as Markdown and as CSV; pure functions of data frames."""

import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd
from rich import box
from rich.console import Console, Group
from rich.table import Table
from rich.text import Text

from results.aggregate import compare, summarise
from results.notes import descriptions, failures, origins, rollouts_cell
from results.text_table import NOT_APPLICABLE, stacked

VIEWS = ("greedy", "best")
COLUMNS = ("solved", "rollouts", "reward", "IQM")  # of each view
WIDTH = 120  # of a terminal, in characters


@dataclass(frozen=True)
class TableRow:
    """One algorithm on one task, as text; each cell has a main line and one for its spread.

    :param label: the algorithm's
    :param seeds: how many runs finished, and how many failed
    :param cells: by view and column
    :param training: median seconds a run
    :param reason: why there are no cells; empty otherwise
    """

    label: str
    seeds: tuple[str, str]
    cells: dict[tuple[str, str], tuple[str, str]]
    training: str
    reason: str


def table_rows(summary: pd.DataFrame) -> list[TableRow]:
    """Return the summary of one task as text.

    :param summary: of `results.aggregate.summarise`
    """
    rows = []
    for row in summary.to_dict("records"):
        failed = f"{row['failed']} failed" if row["failed"] else ""
        seeds = (str(row["seeds"]), failed)
        if row["reason"]:
            rows.append(TableRow(row["label"], seeds, {}, "", row["reason"]))
            continue
        cells = {
            (view, column): cell
            for view in VIEWS
            for column, cell in zip(COLUMNS, _cells(row, view), strict=True)
        }
        rows.append(TableRow(row["label"], seeds, cells, f"{row['training_seconds']:.1f}", ""))
    return rows


def footnotes(runs: pd.DataFrame) -> list[str]:
    """Return the definitions of the columns, and where the runs come from.

    :param runs: one row a run
    """
    return [
        "greedy: the policy that the rollouts so far gave, predict(context, deterministic=True), "
        "run in a task of its own and not counted. best: the rollout of largest reward so far.",
        "solved: runs that succeed at the end of the budget, with the 95 % Wilson interval. "
        "rollouts: the count from which on they do, median (quartiles), unsolved runs beyond the "
        "budget. reward: at the end of the budget, median. IQM: interquartile mean of the same, "
        "with its 95 % bootstrap interval over seeds. time: median seconds a run on one thread, "
        "rollouts included, greedy evaluations not.",
        *descriptions(runs),
        *origins(runs),
    ]


def comparisons(runs: pd.DataFrame, reference: str) -> list[str]:
    """Return a line for each algorithm that the reference is compared with.

    :param runs: one row a run
    :param reference: the label of the algorithm that is compared with the others
    """
    return [
        f"{row['reference']} beats {row['label']} with probability "
        f"{_probability(row, 'reward')} in final greedy reward, "
        f"{_probability(row, 'rollouts')} in rollouts to success."
        for row in compare(runs, reference).to_dict("records")
    ]


def terminal_table(
    runs: pd.DataFrame, labels: Sequence[str] | None = None, width: int = WIDTH
) -> Group:
    """Return what `nmp-bench table` prints.

    :param runs: one row a run
    :param labels: the algorithms in the order of the rows; those of ``runs`` by default
    :param width: of the terminal, in characters; each view has a table of its own where
        both side by side are wider
    """
    parts: list[Table | Text] = []
    for task, summary in summarise(runs, labels).groupby("task"):
        rows = table_rows(summary)
        parts.append(Text(_title(str(task), runs), style="bold"))
        whole = _table(rows, VIEWS)
        fits = Console(width=10 * WIDTH).measure(whole).maximum <= width
        parts += [whole] if fits else [_table(rows, [view]) for view in VIEWS]
    parts += _section("Failed runs", failures(runs), "red")
    parts += _section("Comparisons", comparisons(runs, reference_label(runs, labels)), "")
    return Group(*parts, *_section("Notes", footnotes(runs), "dim"))


def _table(rows: Iterable[TableRow], views: Iterable[str]) -> Table:
    """Return a table of some views; the first cell of an empty row tells why it is empty."""
    keys = [(view, column) for view in views for column in COLUMNS]
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column("\nalgorithm", no_wrap=True)
    table.add_column("\nseeds", justify="right", no_wrap=True)
    for view, column in keys:
        table.add_column(f"{view}\n{column}", justify="right", no_wrap=True)
    table.add_column(Text("time\n[s]"), justify="right", no_wrap=True)
    for row in rows:
        cells = [stacked(row.cells.get(key, (row.reason, ""))) for key in keys]
        table.add_row(row.label, stacked(row.seeds), *cells, row.training or NOT_APPLICABLE)
    return table


def markdown_table(runs: pd.DataFrame, labels: Sequence[str] | None = None) -> str:
    """Return the same table as Markdown.

    :param runs: one row a run
    :param labels: the algorithms in the order of the rows; those of ``runs`` by default
    """
    lines: list[str] = []
    header = [f"{view} {column}" for view, column in _keys()]
    for task, summary in summarise(runs, labels).groupby("task"):
        lines += [f"## {_title(str(task), runs)}", ""]
        lines.append("| " + " | ".join(["algorithm", "seeds", *header, "time [s]"]) + " |")
        lines.append("|---" + "|--:" * (len(header) + 2) + "|")
        for row in table_rows(summary):
            cells = [" ".join(row.cells.get(key, (row.reason, ""))).strip() for key in _keys()]
            seeds = " + ".join(part for part in row.seeds if part)
            texts = [row.label, seeds, *cells, row.training or NOT_APPLICABLE]
            lines.append("| " + " | ".join(text.replace("|", "\\|") for text in texts) + " |")
        lines.append("")
    for title, found in (
        ("Failed runs", failures(runs)),
        ("Comparisons", comparisons(runs, reference_label(runs, labels))),
        ("Notes", footnotes(runs)),
    ):
        if found:
            lines += [f"**{title}**", "", *(f"- {' '.join(line.split())}" for line in found), ""]
    return "\n".join(lines)


def reference_label(runs: pd.DataFrame, labels: Sequence[str] | None) -> str:
    """Return the algorithm that the others are compared with: the first one.

    :param runs: one row a run
    :param labels: the algorithms in the order of the rows
    """
    return (list(labels or []) or sorted(set(runs["label"])))[0]


def _keys() -> list[tuple[str, str]]:
    return [(view, column) for view in VIEWS for column in COLUMNS]


def _section(title: str, lines: list[str], style: str) -> list[Text]:
    return [Text("\n".join([title, *lines, ""]), style=style)] if lines else []


def _cells(row: Mapping[Hashable, Any], view: str) -> tuple[tuple[str, str], ...]:
    """Return the cells of `COLUMNS`, each as its main line and its spread."""
    percent = f"{100 * row[f'{view}_solved_low']:.0f}–{100 * row[f'{view}_solved_high']:.0f} %"
    solved = (f"{row[f'{view}_solved']:.0f}/{row['seeds']}", percent)
    counts = {end: row[f"{view}_rollouts_{end}"] for end in ("median", "q25", "q75")}
    low, high = row[f"{view}_iqm_low"], row[f"{view}_iqm_high"]
    interval = "one seed" if math.isnan(low) else f"[{low:.4f},{high:.4f}]"
    reward, mean = (f"{row[f'{view}_{name}']:.4f}" for name in ("reward_median", "iqm"))
    return (
        solved,
        rollouts_cell(counts, row["budget"]),
        (reward, ""),
        (mean, interval),
    )


def _probability(row: Mapping[Hashable, Any], name: str) -> str:
    low, high = row[f"{name}_low"], row[f"{name}_high"]
    interval = "one seed" if math.isnan(low) else f"{low:.2f}–{high:.2f}"
    return f"{row[f'{name}_p']:.2f} ({interval})"


def _title(task: str, runs: pd.DataFrame) -> str:
    chosen = runs.loc[runs["task"] == task]
    return f"{task}, budget {_listing(chosen['budget'])} rollouts"


def _listing(values: pd.Series) -> str:
    return ", ".join(str(value) for value in sorted(set(values)))
