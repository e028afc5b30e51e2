"""Figure 6.2: samples of RC-NMP cover the demonstrations; a CNMP has one mean and a band."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from results.harness.records import RunRecord
from results.report.figure_style import COLOURS, plain_axes
from results.sampling.curves import BUNDLES, HEIGHTS, FloatArray, bundle_heights, curves
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
    figure = Figure(figsize=(10, 7.4), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    _draw_cnmp(panels[0, 0], chosen(runs, "CNMP", SIX)[0])
    _draw_samples(panels[0, 1], chosen(runs, "RC-NMP", SIX)[0], curves(HEIGHTS))
    for axes, label in zip(panels[1], ("RC-NMP", "RC-NMP, 2 categories"), strict=True):
        shown = curves(bundle_heights(BUNDLES[TWO_BUNDLES]))
        _draw_samples(axes, chosen(runs, label, TWO_BUNDLES)[0], shown)
    for axes in panels.flat:
        plain_axes(axes)
    for axes in panels[1]:
        axes.set_xlabel("x = time (no unit)")
    for axes in panels[:, 0]:
        axes.set_ylabel("y (no unit)")
    handles, names = panels[0, 0].get_legend_handles_labels()
    more, others = panels[0, 1].get_legend_handles_labels()
    legend = dict(zip([*names, *others], [*handles, *more], strict=True))
    figure.legend(
        legend.values(), legend.keys(), loc="outside lower center", ncols=4, frameon=False
    )
    return figure


def _draw_demonstrations(axes: Axes, demonstrations: FloatArray) -> None:
    x = np.linspace(0, 1, demonstrations.shape[1])
    for i, path in enumerate(demonstrations[..., 0]):
        name = "demonstrations" if i == 0 else None
        axes.plot(x, path, color=COLOURS[1], linewidth=1.6, label=name, zorder=3)


def _draw_cnmp(axes: Axes, run: RunRecord) -> None:
    demonstrations = curves(HEIGHTS)
    mean, std = (np.array(run.measured.more[key]) for key in ("mean", "std"))
    x = np.linspace(0, 1, len(mean))
    axes.fill_between(
        x, mean - 2 * std, mean + 2 * std, color="0.85", linewidth=0,
        label="CNMP: mean ± 2 standard deviations",
    )  # fmt: skip
    _draw_demonstrations(axes, demonstrations)
    axes.plot(x, mean, color="black", linewidth=2.5, label="CNMP: mean", zorder=4)
    axes.set_title("CNMP, given the start (0, 0)")


def _draw_samples(axes: Axes, run: RunRecord, demonstrations: FloatArray) -> None:
    samples = np.array(run.measured.more["samples"])
    x = np.linspace(0, 1, samples.shape[1])
    for i, path in enumerate(samples):
        name = f"RC-NMP: {len(samples)} samples" if i == 0 else None
        axes.plot(x, path, color=COLOURS[0], linewidth=0.8, alpha=0.6, label=name)
    _draw_demonstrations(axes, demonstrations)
    asked, more = run.specification, run.measured.more
    if asked.variant == SIX:
        told = f"{more['inside']:.0%} of 1000 samples in the envelope"
        axes.set_title(f"RC-NMP: {told}")
    else:
        k = asked.settings["n_categories"]
        axes.set_title(f"Two bundles, K = {k}: {more['gap']:.0%} of 1000 samples in the gap")


FIGURE = ThesisFigure(
    "fig-6.2",
    MADE,
    full=(SamplingRuns(FOLDER, 5, tuple(range(6, 17))),),
    quick=(SamplingRuns(FOLDER, 1, (6,), shortened=0.5),),
    findings=findings,
    draw=draw,
)
