"""Figure 5.5: what was found gets its place between its neighbours in a latent space of two."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from results.harness.records import RunRecord
from results.report.figure_style import plain_axes
from results.thesis.interface import Finding, Records, SuiteRuns, ThesisFigure, chosen

FOLDER = SUITE = "assimilation"
LABELS = ("ACNMP, 2 latents", "ACNMP, 2 latents, no linear trend")
#: number of the context by where it lies; see the suite
NUMBERS = {"beyond": 1, "between": 4}
STAGES = ("before", "after")
MADE = (
    "A network of two latents on the obstacles task, before and after 35 rollouts and the "
    "assimilation of what they found. Each trajectory as a whole is one point of the latent space. "
    "Place: 0 at one neighbour, 1 at the other, along the line through them; 'between' is from 0 "
    "to 1. Off: distance from that line, in units of the neighbours' distance. Beyond the "
    "demonstrations the neighbours are the highest one and a curve as far on the other side, never "
    "shown; 'between' has one demonstration left out. Decoded: the trajectory that the network "
    "makes of the point, its distance from the via-point, and whether it solves the task."
)


def place_of(latents: dict[str, Any]) -> tuple[float, float]:
    """Return where the found trajectory's point lies between its neighbours', and how far off.

    >>> place_of({"found": [0.5, 1.0], "neighbours": [[0.0, 0.0], [2.0, 0.0]]})
    (0.25, 0.5)

    :param latents: of a record, before or after
    """
    first, second = np.array(latents["neighbours"], np.float64)
    along = second - first
    length = float(np.linalg.norm(along))
    step = np.array(latents["found"]) - first
    place = float(step @ along) / length**2
    return place, float(np.linalg.norm(step - place * along)) / length


def numbers(runs: Sequence[RunRecord], stage: str) -> NDArray[np.float64]:
    """Return place, distance from the line, decoded error and success of each run, shape (N, 4).

    :param runs: finished ones
    :param stage: ``"before"`` or ``"after"``
    """
    latents = [run.measured.more["latents"][stage] for run in runs]
    return np.array([(*place_of(each), each["error"], each["solved"]) for each in latents])


def findings(records: Records) -> list[Finding]:
    """Return whether the found trajectory lies between its neighbours and is met by decoding.

    :param records: of `FOLDER`
    """
    return [
        finding
        for label in LABELS
        for kind, number in NUMBERS.items()
        for finding in _of_kind(chosen(records[FOLDER], label, number=number), f"{label}, {kind}")
    ]


def _of_kind(runs: Sequence[RunRecord], name: str) -> list[Finding]:
    before, after = (numbers(runs, stage) for stage in STAGES)
    inside = [int(((found[:, 0] > 0) & (found[:, 0] < 1)).sum()) for found in (before, after)]
    met = [int(found[:, 3].sum()) for found in (before, after)]
    (place, off, error, _), (new_place, new_off, new_error, _) = (
        np.median(found, axis=0) for found in (before, after)
    )
    n = len(runs)
    return [
        Finding(
            f"{name}: the new trajectory's latent lies between its neighbours'", "shown",
            f"before in {inside[0]} of {n} runs (place {place:.2f}, off {off:.2f}), after in "
            f"{inside[1]} (place {new_place:.2f}, off {new_off:.2f})", inside[1] == n,
        ),
        Finding(
            f"{name}: before, that latent does not give a solution; after, it does", "shown",
            f"it gives one before in {met[0]} of {n} runs ({error:.3g} m), after in {met[1]} "
            f"({new_error:.3g} m)", met[0] == 0 and met[1] == n,
        ),
    ]  # fmt: skip


def draw(records: Records) -> Figure:
    """Draw the latent spaces of the first seed, before and after.

    :param records: of `FOLDER`
    """
    figure = Figure(figsize=(13, 7), layout="constrained")
    panels = figure.subplots(len(STAGES), len(LABELS) * len(NUMBERS), squeeze=False)
    columns = [(label, kind) for label in LABELS for kind in NUMBERS]
    for column, (label, kind) in enumerate(columns):
        run = chosen(records[FOLDER], label, number=NUMBERS[kind])[0]
        for axes, stage in zip(panels[:, column], STAGES, strict=True):
            _draw_latents(axes, run.measured.more["latents"][stage])
            axes.set_ylabel(f"{stage}: latent 2" if column == 0 else "", fontsize=9)
        what = "no linear trend" if "trend" in label else "ours"
        panels[0, column].set_title(f"{what}: {kind} what was shown", fontsize=9)
        panels[-1, column].set_xlabel("latent 1")
    handles, names = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=4, frameon=False)
    return figure


def _draw_latents(axes: Axes, latents: dict[str, Any]) -> None:
    shown = np.array(latents["shown"])
    axes.plot(*shown.T, "o-", color="#56B4E9", linewidth=0.8, label="demonstrations, by height")
    for index, point in enumerate(shown, start=1):
        axes.annotate(str(index), tuple(point), (4, 4), textcoords="offset points", fontsize=8)
    neighbours = np.array(latents["neighbours"])
    axes.plot(*neighbours.T, "s--", color="0.5", fillstyle="none", label="neighbours")
    axes.plot(*latents["found"], "*", color="#D55E00", markersize=13, label="found")
    place, off = place_of(latents)
    text = f"place {place:.2f}, off {off:.2f}\ndecoded {latents['error']:.3f} m off"
    axes.annotate(text, (0.5, 0.97), xycoords="axes fraction", fontsize=8, ha="center", va="top")
    plain_axes(axes)


FIGURE = ThesisFigure(
    "fig-5.5",
    MADE,
    full=(SuiteRuns(FOLDER, SUITE, LABELS),),
    quick=(SuiteRuns(FOLDER, SUITE, LABELS, n_seeds=1),),
    findings=findings,
    draw=draw,
)
