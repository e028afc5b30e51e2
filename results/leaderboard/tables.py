"""The leaderboard as a page of tables."""

from collections.abc import Sequence

from results.exceptions import RecordError
from results.harness.records import Provenance
from results.leaderboard.boards import BOARDS
from results.leaderboard.files import VERSIONS
from results.leaderboard.rows import Row
from results.report.footnotes import EXPECTED_NOTE
from results.report.own_answer import SIGNS
from results.report.text_table import NOT_APPLICABLE, Cell, Page, Section, TextTable

HEADER = (
    "algorithm",
    "runs",
    "solved",
    "expected\nrollouts",
    "final reward\nIQM",
    "fail\n%",
    "trials",
    "sees",
    "commit",
)
NOTES = (
    "A row: the runs of one algorithm, with equal budgets and seeds; no seed was tuned on. "
    "solved: runs whose greedy trajectory succeeds at the end of the budget; over many contexts, "
    "runs that end with no more failures than the board allows.",
    EXPECTED_NOTE,
    "final reward: of the greedy trajectory, interquartile mean over seeds with its 95 % interval; "
    "over many contexts the mean over those whose trajectories are kept. fail: share of all unseen "
    "contexts in the end. sees: R reward, S success, T the reward's terms, P step rewards, A "
    "achieved contexts, D demonstrations.",
    "trials: settings that a study tried, as many for each algorithm, on other seeds and contexts "
    "(nmp-bench tune; bottles that are not drawn at random have but one context); a dash where the "
    "settings are the suite's.",
    "'nmp-bench leaderboard verify' simulates the trajectories that earned the rows, over many "
    "contexts those of the first 25; 'check' does runs again.",
)


def page(rows: Sequence[Row]) -> Page:
    """Return a table for each board, the fewest expected rollouts first.

    :param rows: of all boards
    :raises RecordError: a row of a board that there is not
    """
    for row in rows:
        if row.board not in BOARDS:
            raise RecordError(
                f"the row '{row.label}' says board '{row.board}', and the leaderboard has "
                f"{', '.join(BOARDS)}: restore the row from the repository, or remove it."
            )
    boards = sorted({row.board for row in rows}, key=[*BOARDS].index)
    tables = [_table(board, [row for row in rows if row.board == board]) for board in boards]
    return Page(tables, [Section("Notes", [*NOTES, *origins(rows)], "dim")])


def _table(board: str, rows: Sequence[Row]) -> TextTable:
    ordered = sorted(rows, key=lambda row: row.rollouts[0])
    most = BOARDS[board].most_failures
    allowed = f", solved with at most {most:.0%} failures" if most else ""
    title = (
        f"{board}: {BOARDS[board].title}, {rows[0].task}, budget {rows[0].budget} rollouts{allowed}"
    )
    return TextTable(title, HEADER, tuple(_cells(row) for row in ordered))


def _cells(row: Row) -> tuple[Cell, ...]:
    n, commit = len(row.claims), row.provenance.commit or "unknown"
    sees = " ".join(sign for name, sign in SIGNS.items() if name in (row.sees or ()))
    return (
        (row.label, ""),
        (str(n), ""),
        (f"{row.solved}/{n}", ""),
        _with_interval(row.rollouts, ".1f"),
        _with_interval(row.reward, ".4f"),
        (NOT_APPLICABLE, "")
        if row.failure_rate is None
        else _with_interval(tuple(100 * rate for rate in row.failure_rate), ".1f"),
        (NOT_APPLICABLE if row.n_trials is None else str(row.n_trials), ""),
        (sees or NOT_APPLICABLE, ""),
        (commit[:10] + ("*" if row.provenance.dirty else ""), ""),
    )


def _with_interval(values: Sequence[float], form: str) -> Cell:
    mean, low, high = (f"{value:{form}}".replace("inf", "∞") for value in values)
    return mean, f"[{low},{high}]"


def origins(rows: Sequence[Row]) -> list[str]:
    """Tell the algorithms, versions and machines behind some rows.

    :param rows: of all boards
    """
    boards = sorted({row.board for row in rows}, key=[*BOARDS].index)
    described = [_described(board, [r for r in rows if r.board == board]) for board in boards]
    made = dict.fromkeys(_origin(row.provenance) for row in rows)
    return [*described, *(f"Made with {origin}." for origin in made)]


def _described(board: str, rows: Sequence[Row]) -> str:
    """Say what a board's algorithms are, in its order; what tuned ones are is said once."""
    told = {row.label: row.description for row in rows if row.description}
    known = tuple(f"{text}; " for text in told.values())
    order = {label: place for place, label in enumerate(BOARDS[board].labels)}
    listed = [
        f"{label}: {told[label]}"
        for label in sorted(told, key=lambda label: order.get(label, len(order)))
        if not told[label].startswith(known)
    ]
    return f"{board}. {'; '.join(listed)}."


def _origin(provenance: Provenance) -> str:
    versions = ", ".join(f"{name} {provenance.packages[name]}" for name in VERSIONS)
    machine = provenance.machine
    cpu = f", {machine.cpu} ({machine.architecture}, {machine.features[-1]})" if machine else ""
    return f"{versions}, Python {provenance.python}{cpu}"
