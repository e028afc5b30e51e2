"""Figure 6.2: samples of RC-NMP cover the demonstrations; a CNMP has one mean and a band."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from results.harness.records import RunRecord
from results.report.figure_style import COLOURS, plain_axes
from results.sampling.curves import BUNDLES, HEIGHTS, FloatArray, curves
from results.thesis.interface import Finding, Records, SamplingRuns, ThesisFigure, chosen

FOLDER, SIX, TWO_BUNDLES, SIX_BUNDLES = (
    "fig-6.2", "six demonstrations", "two bundles", "six bundles",
)  # fmt: skip
MADE = (
    "Six curves from (0, 0) to (1, 0) are learned without reward. Of 1000 samples, z from N(0, I), "
    "we count those that stay at all times in the demonstrations' envelope, widened by 2 % of its "
    "largest width, and measure what part of its width these span where it is widest. CNMP is "
    "conditioned on (0, 0), which all curves share. Beyond the thesis: a discrete latent of K "
    "categories on bundles of ten curves. A sample is in a gap when its height lies between two "
    "bundles, each widened by 2 % of the whole range; a bundle is found when a category keeps "
    "90 % of its samples in it."
)
#: without the black of the demonstrations
CATEGORY_COLOURS = COLOURS[:6]
LEAST_INSIDE, LEAST_SPANNED, MOST_IN_GAP = 0.95, 0.9, 0.05


def numbers(records: Sequence[RunRecord], key: str) -> FloatArray:
    """Return a number of each run, shape (N,).

    :param records: finished runs
    :param key: under which the records keep it
    """
    return np.array([record.measured.more[key] for record in records], np.float64)


def findings(records: Records) -> list[Finding]:
    """Return the thesis's claim and those about categories, each for the worst seed.

    :param records: of `FOLDER`
    """
    runs = records[FOLDER]
    ours = chosen(runs, "RC-NMP", SIX)
    inside, spanned = numbers(ours, "inside"), numbers(ours, "spanned")
    gap = numbers(chosen(runs, "RC-NMP, 2 categories", TWO_BUNDLES), "gap")
    plain = numbers(chosen(runs, "RC-NMP", TWO_BUNDLES), "gap")
    many = [run for run in runs if run.finished and run.specification.variant == SIX_BUNDLES]
    found = numbers(many, "found")
    n_bundles, n_runs = len(BUNDLES[SIX_BUNDLES]), len(found)
    counts = sorted({int(run.specification.settings["n_categories"]) for run in many})
    return [
        Finding(
            f"samples stay among the demonstrations (at least {LEAST_INSIDE:.0%} in every run)",
            "shown", f"{inside.mean():.1%}, worst of {len(ours)} runs {inside.min():.1%}",
            bool(inside.min() >= LEAST_INSIDE),
        ),
        Finding(
            f"they reach the demonstrations at the edges (at least {LEAST_SPANNED:.0%} of the "
            "width in every run)",
            "shown", f"{spanned.mean():.1%}, worst {spanned.min():.1%}",
            bool(spanned.min() >= LEAST_SPANNED),
        ),
        Finding(
            f"with K = 2, less than {MOST_IN_GAP:.0%} of the samples in the gap of two bundles",
            "future work", f"{gap.mean():.1%}, worst {gap.max():.1%}; K = 1: {plain.mean():.1%}",
            bool(gap.max() < MOST_IN_GAP),
        ),
        Finding(
            f"each of {n_bundles} bundles has a category, for K = "
            f"{', '.join(str(count) for count in counts)}",
            "future work", f"in {int((found == n_bundles).sum())} of {n_runs} runs; fewest found "
            f"{found.min():.0f}, in gaps {numbers(many, 'gap').mean():.1%} of the samples",
            bool((found == n_bundles).all()),
        ),
    ]  # fmt: skip


def draw(records: Records) -> Figure:
    """Draw CNMP's band and RC-NMP's samples of the first seed, and below them the categories.

    :param records: of `FOLDER`
    """
    runs = records[FOLDER]
    figure = Figure(figsize=(11, 7.4), layout="constrained")
    panels = figure.subplot_mosaic("AAABBB;CCDDEE", sharex=True, sharey=True)
    _draw_cnmp(panels["A"], chosen(runs, "CNMP", SIX)[0])
    _draw_single(panels["B"], chosen(runs, "RC-NMP", SIX)[0])
    bundled = (
        ("RC-NMP", TWO_BUNDLES), ("RC-NMP, 2 categories", TWO_BUNDLES),
        ("RC-NMP, 6 categories", SIX_BUNDLES),
    )  # fmt: skip
    for name, (label, variant) in zip("CDE", bundled, strict=True):
        _draw_bundled(panels[name], chosen(runs, label, variant)[0])
        panels[name].set_xlabel("x = time (no unit)")
    for name, axes in panels.items():
        plain_axes(axes)
        axes.tick_params(labelbottom=name in "CDE", labelleft=name in "AC")
        axes.set_ylabel("y (no unit)" if name in "AC" else "")
    legend = {
        name: handle
        for axes in panels.values()
        for handle, name in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        legend.values(), legend.keys(), loc="outside lower center", ncols=3, frameon=False
    )
    return figure


def _draw_demonstrations(axes: Axes) -> None:
    demonstrations = curves(HEIGHTS)[..., 0].T
    x = np.linspace(0, 1, len(demonstrations))
    name = ["demonstrations"] + ["_"] * (len(HEIGHTS) - 1)
    axes.plot(x, demonstrations, color="black", linewidth=1.4, label=name, zorder=3)


def _draw_samples(axes: Axes, run: RunRecord) -> None:
    more = run.measured.more
    x = np.linspace(0, 1, len(more["samples"][0]))
    for path, category in zip(more["samples"], more["categories"], strict=True):
        colour = CATEGORY_COLOURS[category % len(CATEGORY_COLOURS)]
        name = f"RC-NMP: {len(more['samples'])} samples, a colour for each category"
        axes.plot(x, path, color=colour, linewidth=0.8, label="_" if category else name)


def _draw_cnmp(axes: Axes, run: RunRecord) -> None:
    mean, std = (np.array(run.measured.more[key]) for key in ("mean", "std"))
    x = np.linspace(0, 1, len(mean))
    band = "CNMP: mean ± 2 standard deviations"
    axes.fill_between(x, mean - 2 * std, mean + 2 * std, color="#CFE3F0", linewidth=0, label=band)
    _draw_demonstrations(axes)
    axes.plot(x, mean, color=COLOURS[0], linewidth=2.5, label="CNMP: mean", zorder=4)
    axes.set_title("CNMP, given the start (0, 0)")


def _draw_single(axes: Axes, run: RunRecord) -> None:
    _draw_samples(axes, run)
    _draw_demonstrations(axes)
    inside = run.measured.more["inside"]
    axes.set_title(f"RC-NMP: {inside:.1%} of 1000 samples in the envelope")


def _draw_bundled(axes: Axes, run: RunRecord) -> None:
    asked, more = run.specification, run.measured.more
    for limits in BUNDLES[asked.variant]:
        low, high = curves(limits)[..., 0]
        x, name = np.linspace(0, 1, len(low)), "bundles of demonstrations"
        axes.fill_between(x, low, high, color="0.8", linewidth=0, label=name)
    _draw_samples(axes, run)
    k = asked.settings["n_categories"]
    axes.set_title(f"{asked.variant.capitalize()}, K = {k}: {more['gap']:.1%} in gaps")


FIGURE = ThesisFigure(
    "fig-6.2",
    MADE,
    full=(SamplingRuns(FOLDER, 5, tuple(range(6, 17))),),
    quick=(SamplingRuns(FOLDER, 1, (6,), shortened=0.5),),
    findings=findings,
    draw=draw,
)
