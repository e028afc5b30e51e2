"""The script that asks whether a change of structure left runs as they were."""

from results.experiments.same_runs import LABELS, SUITE_RUNS, specifications


def test_every_run_that_it_names_can_be_made() -> None:
    runs = list(specifications())
    assert len(runs) > 50
    assert {run.suite.name for run in runs if run.suite} == set(SUITE_RUNS)
    labels = {run.algorithm.path.partition(":")[2] for run in runs}
    assert {"ACNMP", "RCNMP", "GA", "BO", "CMAES", "REPS"} <= labels
    for suite, asked in LABELS.items():
        assert {run.label for run in runs if run.suite and run.suite.name == suite} == set(asked)
