"""The boards: which runs make up the leaderboard.

A board's seeds were never tuned on, and no suite's table is made of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from benchmark_envs.tasks.push import EXTRAPOLATION_TARGETS
from results.adaptation.protocol import LeaveOneOut
from results.exceptions import BenchmarkError
from results.harness.specification import RunSpecification
from results.harness.suite import Recipe, find_label, make_suite, match_label
from results.stream.protocol import Stream
from results.suites import (
    aperture,
    pick_and_place,
    pouring,
    push,
    random_bottles,
    rivals,
    via_points,
)
from results.tuning.rows import tuned_rows

#: of the committed rows, a folder for each board
DATA = Path(__file__).parent / "data"


@dataclass(frozen=True)
class Board:
    """A list of rows, one for each algorithm, made from equal budgets and seeds.

    >>> BOARDS["bottles"].labels[:3]
    ['RC-NMP', 'GA', 'GA, judged']

    :param title: one line
    :param recipe: what its runs are made of
    :param seeds: of its runs
    :param n_checked: how many of them, the first ones, a check does again where a row's very first
        run is not the same to the bit
    :param most_failures: share of held-out contexts that may fail in a success over many contexts
    :param too_slow: rows of which a check does no run: there `check --exact` remains. Claims are
        of whole runs, so that part of one could be compared with nothing that is kept
    """

    title: str
    recipe: Recipe
    seeds: tuple[int, ...]
    n_checked: int
    most_failures: float = 0.0
    too_slow: frozenset[str] = frozenset()

    def n_again(self, label: str) -> int:
        """Return how many of a row's seeds a check does again, at most.

        >>> BOARDS["aperture"].n_again("contextual REPS"), BOARDS["aperture"].n_again("ACNMP")
        (10, 0)

        :param label: of the row
        """
        return 0 if label in self.too_slow else self.n_checked

    @property
    def labels(self) -> list[str]:
        """The algorithms, in the order of the rows."""
        return list(self.recipe.algorithms)

    def runs(
        self, name: str, labels: list[str] | None = None, n_seeds: int | None = None
    ) -> tuple[RunSpecification, ...]:
        """Return its runs, seed by seed.

        :param name: of the board
        :param labels: of these rows; of all by default
        :param n_seeds: of the first seeds alone
        :raises BenchmarkError: no such row
        """
        seeds = self.seeds[:n_seeds]
        return make_suite(name, self.recipe, seeds, labels=labels).specifications


_BEYOND = tuple(LeaveOneOut(target, extrapolation=True) for target in EXTRAPOLATION_TARGETS)
_POINTS = ("3 points", "6 points")

#: of the suite aperture: each takes the better part of an hour (results/experiments/leaderboard.md
#: has what they did with an earlier network)
_NOT_ON_APERTURE = {
    "ACNMP, sum alone",
    "twin, nearest",
    "twin, quadratic",
    "twin, Gaussian process, sum alone",
}

#: rows of suites that take an algorithm apart, or whose settings nobody but its authors sought
_ABLATIONS = {
    "twin, quadratic",
    "ACNMP, hand-tuned",
    "twin, nearest, hand-tuned",
    "CMA-ES residual",
    "RC-NMP without crossover",
    "RC-NMP without mutation",
}


def _equal(suite: str, recipe: Recipe, budget: int, without: set[str] = _ABLATIONS) -> Recipe:
    """Return a suite's recipe with one budget, without some rows, with what its studies tuned.

    :param suite: its name
    :param recipe: what it is made of
    :param budget: rollouts of a run
    :param without: labels of its rows; ablations by default
    """
    kept = {label: each for label, each in recipe.algorithms.items() if label not in without}
    rows = {**kept, **tuned_rows(suite, kept)}
    same = {label: replace(algorithm, budget=None) for label, algorithm in rows.items()}
    return replace(recipe, algorithms=same, budget=budget, published=None)


BOARDS = {
    "bottles": Board(
        "between two bottles, from nothing",
        _equal("rivals", rivals.RECIPE, 200),
        tuple(range(300, 350)),
        n_checked=10,
    ),
    "push-beyond": Board(
        "pushing to targets beyond the demonstrated ones",
        replace(_equal("push", push.RECIPE, 130), protocols=_BEYOND, checkpoints=(0, 40, 80, 130)),
        tuple(range(300, 320)),
        n_checked=4,
    ),
    "pouring": Board(
        "pouring amounts far beyond the demonstrated ones",
        replace(_equal("pouring", pouring.RECIPE, 18), protocols=pouring.PROTOCOLS[:3]),
        tuple(range(300, 310)),
        n_checked=3,
    ),
    "pick-and-place": Board(
        "objects and towers taller than the demonstrated ones",
        _equal("pick-and-place", pick_and_place.RECIPE, 100),
        tuple(range(300, 310)),
        n_checked=3,
    ),
    "random-bottles": Board(
        "between two bottles wherever they stand, from nothing",
        replace(
            _equal("random-bottles", random_bottles.RECIPE, 500),
            protocols=(Stream(0, 10_000, 300, 16),),
        ),
        tuple(range(300, 310)),
        n_checked=10,
        most_failures=0.02,
    ),
    "aperture": Board(
        "through apertures wherever they are, 30 demonstrations",
        _equal("aperture", aperture.RECIPE, 3000, _NOT_ON_APERTURE),
        tuple(range(300, 310)),
        n_checked=10,
        most_failures=0.02,
        too_slow=frozenset(
            {
                "ACNMP",
                "ACNMP, tuned",
                "ACNMP (thesis)",
                "twin, Gaussian process",
                "twin, Gaussian process, tuned",
            }
        ),
    ),
    "via-points": Board(
        "through three and six points",
        replace(
            _equal("via-points", via_points.RECIPE, 300),
            variants={name: via_points.VARIANTS[name] for name in _POINTS},
        ),
        tuple(range(300, 310)),
        n_checked=10,
    ),
}


def find_board(name: str) -> Board:
    """Return a board.

    :param name: one of `BOARDS`
    :raises BenchmarkError: there is none of that name
    """
    if name not in BOARDS:
        raise BenchmarkError(f"no board '{name}'; the leaderboard has {', '.join(BOARDS)}.")
    return BOARDS[name]


def labels_on(
    boards: Mapping[str, Board], wanted: Sequence[str] | None = None
) -> dict[str, list[str]]:
    """Return the rows of each board that are meant; a board that has none of them is left out.

    >>> list(labels_on(BOARDS, ["acnmp"]))
    ['push-beyond', 'pouring', 'pick-and-place', 'aperture', 'via-points']

    :param boards: by name
    :param wanted: labels as the user typed them; all by default
    :raises BenchmarkError: a label that none of the boards has
    """
    if wanted is None:
        return {name: board.labels for name, board in boards.items()}
    known = dict.fromkeys(label for board in boards.values() for label in board.labels)
    where = f"the leaderboard, on the board{'s' * (len(boards) > 1)} {', '.join(boards)},"
    for label in wanted:
        find_label(label, known, where, "row")
    found = {
        name: [label for each in wanted if (label := match_label(each, board.labels))]
        for name, board in boards.items()
    }
    return {name: labels for name, labels in found.items() if labels}
