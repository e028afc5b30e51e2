"""Estimates, their intervals, and verdicts; the seed is the unit of replication."""

from results.report.statistics.bootstrap import (
    NO_INTERVAL,
    interquartile_mean_interval,
    mean_interval,
    stratified_interval,
)
from results.report.statistics.censored import expected_rollouts
from results.report.statistics.comparisons import (
    LEVEL,
    holm,
    improvement_within,
    permutation_p,
    probability_of_improvement,
    verdict,
)
from results.report.statistics.profiles import performance_profile, performance_profile_band
from results.report.statistics.quantiles import (
    interquartile_mean,
    named,
    quantile,
    quartiles,
    success_interval,
)

__all__ = [
    "LEVEL",
    "NO_INTERVAL",
    "expected_rollouts",
    "holm",
    "improvement_within",
    "interquartile_mean",
    "interquartile_mean_interval",
    "mean_interval",
    "named",
    "performance_profile",
    "performance_profile_band",
    "permutation_p",
    "probability_of_improvement",
    "quantile",
    "quartiles",
    "stratified_interval",
    "success_interval",
    "verdict",
]
