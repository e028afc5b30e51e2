"""Rows of tables whose settings the committed studies have found."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from results.harness.specification import Algorithm
from results.tuning.study import read_study, study_path, with_settings

#: that are committed
STUDIES = Path(__file__).parent / "studies"


def tuned_rows(suite: str, algorithms: Mapping[str, Algorithm]) -> dict[str, Algorithm]:
    """Return algorithms with the best settings of their committed studies, by label.

    What no study has made better is left out: its row would be the suite's own.

    >>> from results.suites import find_recipe
    >>> "TuRBO, tuned" in tuned_rows("rivals", find_recipe("rivals").algorithms)
    True

    :param suite: its name
    :param algorithms: of the suite, by label
    :raises BenchmarkError: a study that cannot be read
    """
    rows = {}
    for label, algorithm in algorithms.items():
        path = study_path(STUDIES, suite, label)
        if not path.exists():
            continue
        study = read_study(path)
        chosen, n_trials = study["best"]["chosen"], len(study["trials"])
        if chosen and study["best"]["cost"] is not None:
            told = f"{algorithm.description}; the best of {n_trials} trials"
            tuned = with_settings(algorithm, chosen)
            rows[f"{label}, tuned"] = replace(tuned, description=told, n_trials=n_trials)
    return rows
