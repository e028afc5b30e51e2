"""Figure 5.3: beyond the demonstrations LfD fails, RL alone forgets the shape, ACNMP keeps it."""

import numpy as np
from matplotlib.figure import Figure

from results.report.statistics import quantile
from results.report.text_table import Cell, TextTable
from results.thesis.interface import Finding, Records, SuiteRuns, ThesisFigure, chosen
from results.thesis.obstacle_runs import FOLDER, SUITE, Outcomes, draw_paths, outcomes

#: the context in which the thesis's via-point is, 0.6 m high
NUMBER = 1
OURS, THESIS_NETWORK, RL = "ACNMP", "ACNMP, thesis's network", "RL alone"
LFD, THESIS_LFD = "LfD alone", "LfD alone, thesis's network"
SEARCHES = (
    OURS, "ACNMP, network drives", THESIS_NETWORK, "ACNMP (thesis)",
    "twin, nearest", "twin, ridge", "twin, Gaussian process",
)  # fmt: skip
LABELS = (*SEARCHES, LFD, THESIS_LFD, "RL after LfD", RL)
WITHIN, SHARE = 35, 1 / 3
TOLERANCE = 0.02  # m, as the task's
MADE = (
    "Six demonstrations of the thesis's published code, four ellipses placed by us, a via-point at "
    "0.6 m where the highest demonstration has 0.452 m. The reward is minus the distance from the "
    f"via-point. Solved: at most {TOLERANCE} m from it, no ellipse touched. Shape: root mean "
    "square distance from the nearest multiple of the demonstrated curve. ACNMP and its twins have "
    "35 rollouts, RL 100. 'Thesis's network': context in the decoder, time as it is, no linear "
    "parts, one member; 'ACNMP (thesis)' has its search and its constants too. Medians over runs."
)


def findings(records: Records) -> list[Finding]:
    """Return the claims of thesis 5.2.1, for our network and the thesis's.

    :param records: of `FOLDER`
    """
    found = {label: outcomes(chosen(records[FOLDER], label, number=NUMBER)) for label in LABELS}
    rl = found[RL]
    reached = int((rl.errors <= TOLERANCE).sum())
    return [
        _fails("LfD alone fails, with the thesis's network", found[THESIS_LFD]),
        _fails("LfD alone fails, with our network", found[LFD]),
        Finding(
            "RL alone passes the via-point and does not keep the shape", "shown",
            f"{reached} of {len(rl.errors)} runs pass it, shape {_median(rl.shapes)} m, start or "
            f"end {_median(rl.ends)} m off; {int((rl.touched > 0).sum())} runs touch an ellipse",
            reached == len(rl.errors) and quantile(rl.shapes, 0.5) > quantile(rl.errors, 0.5),
        ),
        *(
            finding
            for label in (OURS, THESIS_NETWORK)
            for finding in (_solves(label, found[label]), _keeps(label, found[label], rl))
        ),
    ]  # fmt: skip


def _median(values: np.ndarray) -> str:
    return f"{quantile(values, 0.5):.3g}"


def _fails(claim: str, lfd: Outcomes) -> Finding:
    """Return whether demonstrations alone are not enough, in every run."""
    n = len(lfd.errors)
    here = f"{n - lfd.n_solved} of {n} runs fail; {_median(lfd.errors)} m from the via-point"
    return Finding(claim, "shown", here, lfd.n_solved == 0)


def _solves(label: str, found: Outcomes) -> Finding:
    """Return whether every run succeeds within the thesis's rollouts and touches no ellipse."""
    n, worst = len(found.errors), float(found.rollouts.max())
    return Finding(
        f"{label} succeeds within {WITHIN} rollouts and touches no ellipse", f"{WITHIN}",
        f"{found.n_solved} of {n} runs; rollouts: median {_median(found.rollouts)}, "
        f"worst {worst:g}; ellipses touched: {found.touched.sum():.0f}",
        worst <= WITHIN and not found.touched.any(),
    )  # fmt: skip


def _keeps(label: str, found: Outcomes, rl: Outcomes) -> Finding:
    """Return whether the shape is kept at least three times as well as by RL alone."""
    ours, theirs = (quantile(each.shapes, 0.5) for each in (found, rl))
    return Finding(
        f"{label} keeps the demonstrated shape: at most a third of RL alone's distance", "shown",
        f"{ours:.3g} m of {theirs:.3g} m", ours <= SHARE * theirs,
    )  # fmt: skip


def tables(records: Records) -> list[TextTable]:
    """Return all algorithms in the thesis's context.

    :param records: of `FOLDER`
    """
    header = (
        "via-point at 0.6 m", "solved", "rollouts", "via-point [m]", "shape [m]", "ends [m]",
        "touched",
    )  # fmt: skip
    rows = [_row(label, records) for label in LABELS]
    return [TextTable("Obstacles, medians and worst runs", header, tuple(rows))]


def _row(label: str, records: Records) -> tuple[Cell, ...]:
    found = outcomes(chosen(records[FOLDER], label, number=NUMBER))
    spread = [
        (_median(values), f"({values.max():.3g})")
        for values in (found.rollouts, found.errors, found.shapes, found.ends)
    ]
    solved = f"{found.n_solved}/{len(found.errors)}"
    return ((label, ""), (solved, ""), *spread, (f"{found.touched.sum():.0f}", ""))


def draw(records: Records) -> Figure:
    """Draw LfD, RL and ACNMP as the thesis does: above ours, below the thesis's network.

    :param records: of `FOLDER`
    """
    figure = Figure(figsize=(13, 7.6), layout="constrained")
    panels = figure.subplots(2, 3, sharex=True, sharey=True)
    rows = ((LFD, RL, OURS), (THESIS_LFD, "RL after LfD", THESIS_NETWORK))
    for axes, label in zip(panels.flat, [label for row in rows for label in row], strict=True):
        runs = chosen(records[FOLDER], label, number=NUMBER)
        found = outcomes(runs)
        draw_paths(axes, runs)
        axes.set_title(
            f"{label}: {found.n_solved} of {len(runs)} solved, shape {_median(found.shapes)} m",
            fontsize=10,
        )
    for axes in panels[-1]:
        axes.set_xlabel("x [m]")
    for axes in panels[:, 0]:
        axes.set_ylabel("y [m]")
    handles, names = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=2, frameon=False)
    figure.suptitle("A via-point (black) beyond the demonstrations, the ellipses not in the reward")
    return figure


FIGURE = ThesisFigure(
    "fig-5.3",
    MADE,
    full=(SuiteRuns(FOLDER, SUITE, LABELS, numbers=(NUMBER,)),),
    quick=(SuiteRuns(FOLDER, SUITE, LABELS, n_seeds=1, numbers=(NUMBER,)),),
    findings=findings,
    draw=draw,
    tables=tables,
)
