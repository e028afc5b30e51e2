"""Runs that Figure 5.6 and Table 5.1 share, so that either finds those of the other."""

from results.thesis.interface import SuiteRuns

PUSH, APERTURE = "push", "aperture"
OURS, STARK, EWERTON = "ACNMP", "ProMP+RL (Stark)", "ProMP+RL (Ewerton)"
#: beside the thesis's baselines, the better of our search's twins
PUSH_LABELS = (OURS, STARK, "twin, nearest")
APERTURE_LABELS = (OURS, EWERTON, "twin, Gaussian process")
FULL = (SuiteRuns(PUSH, "push", PUSH_LABELS), SuiteRuns(APERTURE, "aperture", APERTURE_LABELS))
QUICK = (
    SuiteRuns(PUSH, "push", PUSH_LABELS, n_seeds=1, budget=130, numbers=(2, 5, 9)),
    SuiteRuns(APERTURE, "aperture", APERTURE_LABELS, n_seeds=1, budget=600),
)
