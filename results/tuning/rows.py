"""Rows of tables whose settings the committed studies have found."""

import json
from dataclasses import replace
from pathlib import Path

from results.harness.specification import Algorithm
from results.harness.suite import Recipe
from results.tuning.study import study_path, with_settings

#: that are committed
STUDIES = Path(__file__).parent / "studies"


def tuned_rows(suite: str, recipe: Recipe) -> dict[str, Algorithm]:
    """Return a suite's algorithms with the best settings of their committed studies, by label.

    >>> from results.suites import find_recipe
    >>> "random search, tuned" in tuned_rows("rivals", find_recipe("rivals"))
    True

    :param suite: its name
    :param recipe: what it is made of
    """
    rows = {}
    for label, algorithm in recipe.algorithms.items():
        path = study_path(STUDIES, suite, label)
        if not path.exists():
            continue
        study = json.loads(path.read_text(encoding="utf-8"))
        best = with_settings(algorithm, study["best"]["chosen"])
        told = f"{algorithm.description}; the best of {len(study['trials'])} trials"
        rows[f"{label}, tuned"] = replace(best, description=told)
    return rows
