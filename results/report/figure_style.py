"""How figures look: colours, lines, axes and files."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter

# Okabe and Ito's palette, which colour-blind readers can tell apart, without its yellow; with the
# line styles, also in print without colour.
BLUE, VERMILION, GREEN, PURPLE, SKY, ORANGE, BLACK = COLOURS = (
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#CC79A7",
    "#56B4E9",
    "#E69F00",
    "#000000",
)
LINES = ("-", "--", "-.", (0, (1, 1)))
#: by how a label begins; the first that fits
FAMILIES = {
    "ACNMP's twin": GREEN,
    "ACNMP": BLUE,
    "RC-NMP": VERMILION,
    "twin": GREEN,
    "GA": GREEN,
    "CMA-ES": PURPLE,
    "contextual CMA-ES": PURPLE,
    "REPS": SKY,
    "DREPS": SKY,
    "contextual REPS": SKY,
    "ProMP+RL": ORANGE,
}
FAINT = 0.5  # of lines beyond as many of one colour as there are line styles
DPI = 150
ROOM = 1.02  # beyond the longest run, so that its last update is inside the axes


def line_style(label: str, labels: Sequence[str]) -> dict[str, Any]:
    """Return an algorithm's colour and line: its family's colour in all figures of all suites.

    Algorithms of no family take the colours that the suite's families leave, in turn.

    >>> line_style("RC-NMP", ["GA", "RC-NMP"])["color"] == VERMILION
    True

    :param label: the algorithm's
    :param labels: all algorithms of the suite, in their order
    """
    families = {each: _family(each) for each in labels}
    free = [colour for colour in COLOURS if colour not in families.values()] or list(COLOURS)
    others = [each for each in labels if families[each] is None]
    colours = {each: families[each] or free[others.index(each) % len(free)] for each in families}
    colour = colours[label]
    place = [each for each in colours if colours[each] == colour].index(label)
    return {
        "color": colour,
        "linestyle": LINES[place % len(LINES)],
        "linewidth": 2.0,
        "alpha": 1.0 if place < len(LINES) else FAINT,
    }


def _family(label: str) -> str | None:
    return next((colour for name, colour in FAMILIES.items() if label.startswith(name)), None)


def seeds_of(label: str, n_seeds: int, what: str = "seed") -> str:
    """Return a legend's entry: the algorithm and its number of seeds.

    >>> seeds_of("GA", 1)
    'GA (1 seed)'

    :param label: the algorithm's
    :param n_seeds: how many of its runs are shown
    :param what: is counted, where that is not seeds
    """
    return f"{label} ({n_seeds} {what}{'s' if n_seeds != 1 else ''})"


def logarithmic_from_zero(axes: Axes, first: float) -> None:
    """Make an axis of rollouts logarithmic from a count on, and linear from 0 to it.

    :param axes: whose x-axis
    :param first: the count, positive
    """
    axes.set_xscale("symlog", linthresh=first, linscale=0.3)
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.set_xlabel(f"rollouts (logarithmic from {first:.0f} on)")


def plain_axes(axes: Axes) -> None:
    """Draw a faint grid, and no frame at the top and the right.

    :param axes: of a panel
    """
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)


def save_figures(folder: Path, drawn: Mapping[str, Figure]) -> list[Path]:
    """Write figures as PNG files and return their paths.

    :param folder: where to write
    :param drawn: by the name of their file
    """
    for name, figure in drawn.items():
        figure.savefig(folder / name, dpi=DPI)
    return [folder / name for name in drawn]
