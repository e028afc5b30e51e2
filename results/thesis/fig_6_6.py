"""Figure 6.6: RC-NMP solves the bottles more often than DREPS and REPS, from fewer rollouts."""

import math

import numpy as np
from matplotlib.figure import Figure

from results.one_context.figures import learning_curves
from results.one_context.summary import frame
from results.report.frames import curves_frame
from results.report.statistics import mean_interval, quantile, success_interval
from results.thesis.interface import Finding, Records, SuiteRuns, ThesisFigure, chosen

FOLDER, OURS = "bottles", "RC-NMP"
LABELS = (OURS, "DREPS", "REPS")
#: runs of 50 that found a satisfactory solution (thesis 6.2.3)
SOLVED = {OURS: 48, "DREPS": 47, "REPS": 35}
#: rollouts until the thesis's curves reach their level: 10 generations of 40, 50 of 50
NEEDED = {OURS: 400, "DREPS": 2500}
N_THESIS, FEWER = 50, 5.0
MADE = (
    "Fifty runs of each on the bottles task in MuJoCo, 400 rollouts a run; what "
    "the baselines search and how they were tuned stands in "
    "results/experiments/baselines_tuning.md. Solved: the final "
    "greedy trajectory crosses between the bottles, touches none and ends at the goal. Rollouts: "
    "until the greedy policy succeeds for good, infinite where it never does. A share differs from "
    "another where the 95 % bootstrap interval of the difference, paired by seed, lies above 0."
)


def outcomes(records: Records) -> dict[str, tuple[list[bool], float]]:
    """Return of each algorithm which seeds are solved, and the median rollouts until then.

    :param records: of `FOLDER`
    """
    found: dict[str, tuple[list[bool], float]] = {}
    for label in LABELS:
        runs = frame(chosen(records[FOLDER], label)).sort_values("seed")
        solved = [bool(value) for value in runs["greedy_solved"]]
        found[label] = solved, quantile(runs["greedy_rollouts"].to_numpy(float), 0.5)
    return found


def findings(records: Records) -> list[Finding]:
    """Return the thesis's claims about how many runs are solved, and how fast.

    :param records: of `FOLDER`
    """
    found = outcomes(records)
    medians = {label: median for label, (_, median) in found.items()}
    told = {label: "never" if math.isinf(m) else f"{m:.0f}" for label, m in medians.items()}
    solved = found[OURS][0]
    return [
        Finding(
            "RC-NMP solves nearly all runs", f"{SOLVED[OURS]} of {N_THESIS}",
            f"{sum(solved)} of {len(solved)}",
            success_interval(sum(solved), len(solved))[1] >= SOLVED[OURS] / N_THESIS,
        ),
        _more_solved(found, OURS, "REPS"),
        _more_solved(found, "DREPS", "REPS"),
        Finding(
            f"RC-NMP needs {FEWER:.0f} times fewer rollouts than DREPS",
            f"about {NEEDED[OURS]} and {NEEDED['DREPS']}",
            f"{told[OURS]} and {told['DREPS']} (median); REPS {told['REPS']}",
            bool(np.isfinite(medians[OURS])) and medians["DREPS"] >= FEWER * medians[OURS],
        ),
    ]  # fmt: skip


def _more_solved(found: dict[str, tuple[list[bool], float]], first: str, second: str) -> Finding:
    """Return whether one algorithm solves more runs than another."""
    ours, theirs = (np.array(found[label][0], float) for label in (first, second))
    n = min(len(ours), len(theirs))
    difference = ours[:n] - theirs[:n]
    low, high = (float(end) for end in mean_interval(difference))
    return Finding(
        f"{first} solves more runs than {second}",
        f"{SOLVED[first]} and {SOLVED[second]} of {N_THESIS}",
        f"{ours.sum():.0f} of {len(ours)} and {theirs.sum():.0f} of {len(theirs)}: difference "
        f"{difference.mean():+.0%} [{low:+.0%}, {high:+.0%}]",
        low > 0,
    )


def draw(records: Records) -> Figure:
    """Draw the learning curves.

    :param records: of `FOLDER`
    """
    runs = [run for label in LABELS for run in chosen(records[FOLDER], label)]
    return learning_curves(curves_frame(runs), LABELS, runs[0].task.optimum)


FIGURE = ThesisFigure(
    "fig-6.6",
    MADE,
    full=(SuiteRuns(FOLDER, "bottles", LABELS),),
    quick=(SuiteRuns(FOLDER, "bottles", LABELS, n_seeds=4, budget=120),),
    findings=findings,
    draw=draw,
)
