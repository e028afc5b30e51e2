"""Runs that Figure 5.12 and Table 5.2 share: of what the thesis did on a real robot."""

from results.harness.records import RunRecord
from results.thesis.interface import SuiteRuns

PICK_AND_PLACE, POURING = "pick-and-place", "pouring"
OURS, TWIN = "ACNMP", "twin, ridge"
LABELS = (OURS, TWIN)
#: of the contexts: the two of pick-and-place, and the thesis's of pouring
HEIGHTS, AMOUNT = (0, 1), 0
PLACED = SuiteRuns(PICK_AND_PLACE, "pick-and-place", LABELS, numbers=HEIGHTS)
POURED = SuiteRuns(POURING, "pouring", LABELS, numbers=(AMOUNT,))
QUICK_PLACED = SuiteRuns(PICK_AND_PLACE, "pick-and-place", LABELS, n_seeds=1, numbers=HEIGHTS)
QUICK_POURED = SuiteRuns(POURING, "pouring", LABELS, n_seeds=1, numbers=(AMOUNT,))


def heights_text(run: RunRecord) -> str:
    """Return the heights of object and tower in a run's context.

    :param run: a finished one of pick-and-place
    """
    context = run.measured.context
    return " and ".join(f"{100 * height:g}" for height in (context.values if context else ()))
