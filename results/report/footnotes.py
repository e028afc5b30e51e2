"""What tables of every protocol say below themselves; pure functions of one row per run."""

import math
from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import pandas as pd

from results.report.statistics import LEVEL
from results.report.text_table import Cell, Page, Section, TextTable

EXPECTED_NOTE = (
    "expected: rollouts to success of an algorithm that is begun anew until it succeeds, all "
    "rollouts spent by the number of successes, with its 95 % interval over seeds."
)
VERDICT_NOTE = (
    "Verdicts: rank sum tests in which seeds are dealt anew between both; p-values are corrected "
    f"for all comparisons on the task (Holm), so one false verdict or more has at most {LEVEL:.0%}."
)


def page(
    tables: Sequence[TextTable], runs: pd.DataFrame, notes: Sequence[str], *between: Section
) -> Page:
    """Return tables with what every protocol says below them: failed runs first, notes last.

    :param tables: in their order
    :param runs: one row per run
    :param notes: of the protocol, before those on algorithms and origins
    :param between: sections of the protocol's own
    """
    told = [*notes, *descriptions(runs), *origins(runs)]
    failed = Section("Failed runs", failures(runs), "red")
    return Page(tables, [failed, *between, Section("Notes", told, "dim")])


def failures(runs: pd.DataFrame) -> list[str]:
    """Return a line for each reason why runs failed, with their seeds, and their targets.

    :param runs: one row per run
    """
    order = ["task", "variant", "label", "seed"]
    failed = runs.loc[runs["outcome"] == "failed"].sort_values(order)
    seeds: dict[str, list[str]] = {}
    for row in failed.to_dict("records"):
        target = f", target {row['target']}" if row.get("target") is not None else ""
        where = f"{row['task']}{', ' if row['variant'] else ''}{row['variant']}{target}"
        what = f"{row['label']} on {where}: {' '.join(row['reason'].split())}"
        seeds.setdefault(what, []).append(str(row["seed"]))
    return [f"{what} (seeds {', '.join(found)})" for what, found in seeds.items()]


def descriptions(runs: pd.DataFrame) -> list[str]:
    """Say in a line what the algorithms are, as far as their records describe them.

    :param runs: one row per run
    """
    pairs = zip(runs["label"], runs["description"], strict=True)
    told = {label: text for label, text in pairs if text}
    return ["; ".join(f"{label}: {text}" for label, text in told.items()) + "."] if told else []


def origins(runs: pd.DataFrame) -> list[str]:
    """Tell the commits, and where the algorithms' seeds, targets or budgets differ.

    :param runs: one row per run
    """
    commits = sorted(
        {
            _short(commit) + (" with local changes" if dirty else "")
            for commit, dirty in zip(runs["commit"], runs["dirty"], strict=True)
        }
    )
    plural = "s" if len(commits) > 1 else ""
    notes = [f"Commit{plural}: {', '.join(commits)}."]
    budgets = {str(label): max(of["budget"]) for label, of in runs.groupby("label")}
    if len(set(budgets.values())) > 1:
        listed = ", ".join(f"{label} {budget}" for label, budget in budgets.items())
        notes.append(f"Budgets differ: {listed} rollouts.")
    beside = dict.fromkeys(runs.loc[runs["n_together"] > 1, "label"])
    if beside:
        notes.append(
            f"Trained as one with other runs (--together): {', '.join(beside)}. Rounding differs "
            "from that of runs by themselves, and can make them other runs in the end."
        )
    finished = runs.loc[runs["outcome"] == "finished"]
    keys = [key for key in ("seed", "target") if key in runs]
    keys += ["variant"] if set(runs["variant"]) != {""} else []
    groups = finished.groupby(["task", "label"])
    if len({frozenset(map(tuple, group[keys].to_numpy())) for _, group in groups}) > 1:
        what = " and ".join(f"{key}s" for key in keys)
        notes.append(
            f"The algorithms' finished {what} differ, so their numbers do not compare in full."
        )
    return notes


def rollouts_text(count: float, budget: float) -> str:
    """Return a count of rollouts, or that it is beyond the budget.

    :param count: infinite where it is not known
    :param budget: of the run
    """
    return f"{count:.0f}" if math.isfinite(count) else f">{budget:.0f}"


def rollouts_cell(quartiles: Mapping[str, float], budget: float) -> tuple[str, str]:
    """Return a median count of rollouts, and its quartiles.

    >>> rollouts_cell({"median": 30.0, "q25": 20.0, "q75": math.inf}, 100)
    ('30', '(20–>100)')

    :param quartiles: ``median``, ``q25`` and ``q75``, infinite where not known
    :param budget: of the runs
    """
    median, low, high = (rollouts_text(quartiles[q], budget) for q in ("median", "q25", "q75"))
    return median, f"({low}–{high})" if low != high else f"({low})"


def expected_cell(row: Mapping[Hashable, Any], name: str) -> Cell:
    """Return expected rollouts to success, and their interval.

    >>> expected_cell({"e_rollouts": math.inf, "e_low": 81.3, "e_high": math.inf}, "e")
    ('∞', '[81,∞]')

    :param row: with ``<name>_rollouts``, ``<name>_low`` and ``<name>_high``
    :param name: of the columns
    """
    mean, low, high = (_rounded(row[f"{name}_{end}"]) for end in ("rollouts", "low", "high"))
    return mean, "one seed" if math.isnan(row[f"{name}_low"]) else f"[{low},{high}]"


def _rounded(count: float) -> str:
    return "∞" if math.isinf(count) else f"{count:.0f}" if count >= 10 else f"{count:.1f}"


def verdict_text(row: Mapping[Hashable, Any], name: str) -> str:
    """Return a verdict with its corrected p-value.

    >>> verdict_text({"reward_verdict": "better", "reward_p_value": 0.0123}, "reward")
    'better in reward (p = 0.012)'

    :param row: with ``<name>_verdict`` and ``<name>_p_value``
    :param name: what the comparison is about
    """
    p = row[f"{name}_p_value"]
    told = f"p = {p:.2g}" if p >= 0.001 else "p < 0.001"
    return f"{row[f'{name}_verdict']} in {name} ({told})"


def _short(commit: object) -> str:
    """Return a commit as notes name it; the run of an imported file has none."""
    return commit[:10] if isinstance(commit, str) and commit else "unknown"
