"""Figure 6.4: crossover speeds up RC-NMP's beginning, mutation its end; ACNMP ends higher."""

from collections.abc import Sequence

import pandas as pd
from matplotlib.figure import Figure

from results.one_context.error_curves import by_run, error_curves
from results.report.frames import curves_frame
from results.report.statistics import mean_interval
from results.thesis.interface import Finding, Records, SuiteRuns, ThesisFigure, chosen

FOLDER, OURS, THESIS_ACNMP, OUR_ACNMP = "via-points", "RC-NMP", "ACNMP, policy gradient", "ACNMP"
NO_CROSSOVER, NO_MUTATION = "RC-NMP without crossover", "RC-NMP without mutation"
LABELS = (OURS, NO_CROSSOVER, NO_MUTATION, OUR_ACNMP, THESIS_ACNMP)
EARLY = 0.2  # part of the budget
FEW, MANY = "2 points", "6 points"
MADE = (
    "Ten problems for each number of points from 1 to 6, 300 rollouts a run. Error: mean distance "
    "from the points of the best rollout so far. A claim about two algorithms holds where the 95 % "
    "bootstrap interval of the mean difference of their errors lies above 0, paired by problem: "
    f"early is after {EARLY:.0%} of the budget, the end after all of it. 'ACNMP, policy gradient' "
    "draws around its answer as the thesis does, 'ACNMP' is ours, with Bayesian optimisation."
)


def errors_after(curves: pd.DataFrame, label: str, rollouts: float) -> pd.Series:
    """Return the error of an algorithm's best rollout so far in each problem.

    :param curves: one row per step
    :param label: the algorithm's
    :param rollouts: the last row up to this count tells; the first row where that is later
    """
    table = -by_run(curves.loc[curves["label"] == label], "best_reward")
    reached = table.loc[table.index <= rollouts]
    return table.iloc[0] if reached.empty else reached.iloc[-1]


def compared(curves: pd.DataFrame, claim: str, other: str, rollouts: float, unit: str) -> Finding:
    """Return whether another algorithm's error is larger than RC-NMP's after some rollouts.

    :param curves: one row per step
    :param claim: in our words
    :param other: the other's label
    :param rollouts: when
    :param unit: of the errors
    """
    theirs, ours = (errors_after(curves, label, rollouts) for label in (other, OURS))
    difference = (theirs - ours).dropna().to_numpy()
    low, high = (float(end) for end in mean_interval(difference))
    here = (
        f"{ours.mean():.4f} {unit} and {theirs.mean():.4f} {unit} after {rollouts:.0f} rollouts: "
        f"{difference.mean():+.4f} [{low:+.4f}, {high:+.4f}] in {len(difference)} problems"
    )
    return Finding(claim, "shown", here, low > 0)


def findings(records: Records) -> list[Finding]:
    """Return the order of the thesis's ablations, each tested.

    :param records: of `FOLDER`
    """
    runs = [run for label in LABELS for run in chosen(records[FOLDER], label)]
    curves, unit = curves_frame(runs), runs[0].task.error_unit or "reward"
    budget = max(run.specification.budget for run in runs)
    ours = errors_after(curves, OURS, budget)
    by_variant = {variant: ours.loc[[variant]].mean() for variant in (FEW, MANY)}
    return [
        compared(curves, "crossover: lower error early", NO_CROSSOVER, EARLY * budget, unit),
        compared(curves, "mutation: lower error at the end", NO_MUTATION, budget, unit),
        compared(curves, "RC-NMP ends below ACNMP, policy gradient", THESIS_ACNMP, budget, unit),
        compared(curves, "RC-NMP ends below our ACNMP", OUR_ACNMP, budget, unit),
        Finding(
            "more points are harder: larger error with 6 points than with 2",
            "shown", ", ".join(f"{name}: {error:.4f} {unit}" for name, error in by_variant.items()),
            by_variant[MANY] > by_variant[FEW],
        ),
    ]  # fmt: skip


def draw(records: Records) -> Figure:
    """Draw the algorithms at the left and the numbers of points at the right.

    :param records: of `FOLDER`
    """
    runs = [run for label in LABELS for run in chosen(records[FOLDER], label)]
    return error_curves(curves_frame(runs), LABELS, runs[0].task.error_unit or "reward")


def _runs(n_seeds: int | None, budget: int | None, variants: Sequence[str] | None) -> SuiteRuns:
    chosen_variants = None if variants is None else tuple(variants)
    return SuiteRuns(FOLDER, "via-points", LABELS, n_seeds, budget, chosen_variants)


FIGURE = ThesisFigure(
    "fig-6.4",
    MADE,
    full=(_runs(None, None, None),),
    quick=(_runs(2, 100, (FEW, "4 points", MANY)),),
    findings=findings,
    draw=draw,
)
