"""Figure 5.6: ACNMP hardly needs rollouts between the demonstrations, and few beyond them."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from results.adaptation import summary as adaptation
from results.adaptation.figures import QUARTILES, error_quartiles
from results.harness.records import RunRecord
from results.report.figure_style import line_style, logarithmic_from_zero, plain_axes, seeds_of
from results.report.frames import curves_frame
from results.report.statistics import mean_interval, quantile
from results.stream import summary as stream
from results.stream.figures import by_seed_on_grid
from results.thesis.interface import Finding, Records, ThesisFigure, chosen
from results.thesis.push_and_aperture import (
    APERTURE,
    APERTURE_LABELS,
    EWERTON,
    FULL,
    OURS,
    PUSH,
    PUSH_LABELS,
    QUICK,
)

KINDS = ("interpolation", "extrapolation")
#: rollouts of the thesis for targets beyond the demonstrations
PUBLISHED = 130
#: share of unseen apertures at which prices are compared: that of the thesis's stored network
PRICED = "0.0906"
MADE = (
    "(b) Pushing: one of ten targets is held out, the others are demonstrated; error of the greedy "
    "policy, median and quartiles over targets and seeds. (d, e) Apertures: 30 are demonstrated, "
    "then up to 1000 new ones; share of 1000 unseen ones that fail, mean over seeds. Our baselines "
    "run on our simulations. As good by environments: the 95 % bootstrap interval of ACNMP's share "
    "minus the baseline's, paired by seed and where both have seen as many, is not all above 0."
)


def findings(records: Records) -> list[Finding]:
    """Return the claims about pushing and about apertures.

    :param records: of `PUSH` and `APERTURE`
    """
    between, beyond = (_rollouts(records, kind) for kind in KINDS)
    seen, ours, theirs, least = _by_environments(records)
    price = {label: _prices(records, label) for label in (OURS, EWERTON)}
    medians = {label: quantile(values, 0.5) for label, values in price.items()}
    return [
        Finding(
            "between the demonstrations almost no rollouts are needed", "almost none",
            f"median {quantile(between, 0.5):g}, worst {between.max():g} in {len(between)} runs",
            quantile(between, 0.5) <= 2,
        ),
        Finding(
            f"beyond them {PUBLISHED} rollouts are enough", f"{PUBLISHED}",
            f"median {quantile(beyond, 0.5):g}, worst {beyond.max():g} in {len(beyond)} runs",
            bool(beyond.max() <= PUBLISHED),
        ),
        Finding(
            "by environments seen, ACNMP is as good as ProMP+RL", "similar",
            f"after {seen:.0f} environments {ours:.1%} and {theirs:.1%} fail; the difference is at "
            f"least {least:+.1%}", least <= 0,
        ),
        Finding(
            "by rollouts, ACNMP is much more efficient: to 9.06 % failures", "0.7M and 10M",
            f"{medians[OURS]:g} and {medians[EWERTON]:g} (medians)",
            bool(np.isfinite(medians[OURS])) and medians[OURS] < medians[EWERTON],
        ),
    ]  # fmt: skip


def _rollouts(records: Records, kind: str) -> np.ndarray:
    """Return ACNMP's rollouts to success in each run at targets of a kind."""
    runs = adaptation.frame(chosen(records[PUSH], OURS))
    return runs.loc[runs["kind"] == kind, "greedy_rollouts"].to_numpy(float)


def _prices(records: Records, label: str) -> np.ndarray:
    runs = stream.frame(chosen(records[APERTURE], label))
    return runs[f"rollouts_to_{PRICED}"].to_numpy(float)


def _by_environments(records: Records) -> tuple[float, float, float, float]:
    """Return environments that both have seen, ACNMP's and the baseline's share that fails.

    The last number is the lower end of the interval of the difference; of one seed, the difference.
    """
    rates: Mapping[str, tuple[np.ndarray, np.ndarray]] = {
        label: by_seed_on_grid(curves_frame(chosen(records[APERTURE], label)), "contexts")
        for label in (OURS, EWERTON)
    }
    seen = min(float(grid.max()) for grid, _ in rates.values())
    at = {
        label: np.array([np.interp(seen, grid, row) for row in rows])
        for label, (grid, rows) in rates.items()
    }
    n = min(len(values) for values in at.values())
    difference = at[OURS][:n] - at[EWERTON][:n]
    low = float(mean_interval(difference)[0]) if n > 1 else float(difference[0])
    return seen, float(at[OURS].mean()), float(at[EWERTON].mean()), low


def draw(records: Records) -> Figure:
    """Draw pushing at the left, failures against environments and rollouts at the right.

    :param records: of `PUSH` and `APERTURE`
    """
    figure = Figure(figsize=(16, 5.2), layout="constrained")
    panels = figure.subplots(1, 4)
    for axes, kind in zip(panels[:2], KINDS, strict=True):
        _draw_push(axes, records, kind)
    for axes, column in zip(panels[2:], ("contexts", "rollouts"), strict=True):
        _draw_apertures(axes, records, column)
    panels[0].set_ylabel("error of the greedy policy [m²]")
    panels[2].set_ylabel("unseen apertures that fail")
    return figure


def _draw_push(axes: Axes, records: Records, kind: str) -> None:
    for label in PUSH_LABELS:
        runs = [run for run in chosen(records[PUSH], label) if _kind(run) == kind]
        quartiles = error_quartiles(curves_frame(runs))
        low, median, high = (quartiles[q] for q in QUARTILES)
        style = line_style(label, PUSH_LABELS)
        axes.step(median.index, median, where="post", label=label, **style)
        colour = style["color"]
        axes.fill_between(
            median.index, low, high, step="post", color=colour, alpha=0.13, linewidth=0
        )
    axes.set(title=f"(b) push, {kind}", yscale="log", xlim=(0, 200), xlabel="rollouts")
    plain_axes(axes)
    axes.legend(frameon=False, fontsize=8)


def _kind(run: RunRecord) -> str:
    return run.specification.protocol.kind


def _draw_apertures(axes: Axes, records: Records, column: str) -> None:
    for label in APERTURE_LABELS:
        runs = chosen(records[APERTURE], label)
        grid, rates = by_seed_on_grid(curves_frame(runs), column)
        style = line_style(label, APERTURE_LABELS)
        axes.plot(grid, rates.mean(axis=0), label=seeds_of(label, len(runs)), **style)
        low, high = mean_interval(rates)
        axes.fill_between(grid, low, high, color=style["color"], alpha=0.15, linewidth=0)
    axes.set_title("(d) by environments" if column == "contexts" else "(e) by rollouts")
    axes.set_xlabel("environments seen")
    if column == "rollouts":
        logarithmic_from_zero(axes, 100)
    axes.set_xlim(left=0)
    axes.set_ylim(bottom=0)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    plain_axes(axes)
    axes.legend(frameon=False, fontsize=8)


FIGURE = ThesisFigure("fig-5.6", MADE, FULL, QUICK, findings, draw)
