"""Figure 6.5: RC-NMP collides with the bottles at first and ends in one of two modes."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from results.harness.records import RolloutRecord, RunRecord, finished
from results.one_context.final_rollouts import draw_scene, greedy, scene_of
from results.report.figure_style import COLOURS
from results.thesis.interface import Finding, Records, SuiteRuns, ThesisFigure, chosen

OURS, SUITE = "RC-NMP", "bottles"
STAGES, QUICK_STAGES = (1, 20, 40, 400), (1, 20, 40, 120)
MODES = ("s", "reverse_s")
MADE = (
    "Ten runs on the bottles task are stopped after some rollouts, and the greedy trajectory, "
    "executed in MuJoCo, is drawn. A run with a smaller budget is the beginning of the same "
    "seed's longer run. One run is shown for each mode that is found, the first seed that ends in "
    "it; the circle in dots is where the hand's bottle would touch the other one."
)


def folder(budget: int) -> str:
    """Return the name of the folder of the runs that stop after some rollouts.

    :param budget: how many
    """
    return f"fig-6.5-after-{budget:03d}"


def stages(records: Records) -> dict[int, dict[int, RunRecord]]:
    """Return RC-NMP's runs by rollouts and seed.

    :param records: of the folders of all stages
    """
    runs = [run for held in records.values() for run in finished(chosen(held, OURS))]
    budgets = sorted({run.specification.budget for run in runs})
    return {
        budget: {r.specification.seed: r for r in runs if r.specification.budget == budget}
        for budget in budgets
    }


def shown_seeds(last: dict[int, RunRecord]) -> dict[str, int]:
    """Return the first seed that ends in each mode, by the mode.

    :param last: runs of the last stage by seed
    """
    found: dict[str, int] = {}
    for seed, run in sorted(last.items(), reverse=True):
        if greedy(run).success:
            found[greedy(run).mode] = seed
    return found


def findings(records: Records) -> list[Finding]:
    """Return whether runs go from collisions to solutions, and whether both modes appear.

    :param records: of the folders of all stages
    """
    at = stages(records)
    first, last = at[min(at)], at[max(at)]
    n_first, n_last = (
        sum(bool(greedy(r).success) for r in runs.values()) for runs in (first, last)
    )
    modes = [greedy(run).mode for run in last.values() if greedy(run).success]
    told = ", ".join(f"{name(mode)} {modes.count(mode)}" for mode in MODES)
    return [
        Finding(
            "collisions at first, a successful execution in the end",
            "snapshots", f"solved after {min(at)} rollout: {n_first} of {len(first)} runs; after "
            f"{max(at)}: {n_last} of {len(last)}",
            n_first == 0 and n_last > len(last) / 2,
        ),
        Finding(
            "different runs end in different modes", "both modes", told,
            all(mode in modes for mode in MODES),
        ),
    ]  # fmt: skip


def name(mode: str) -> str:
    """Return a mode's name in text.

    :param mode: as the task calls it
    """
    return mode.replace("_", " ")


def draw(records: Records) -> Figure:
    """Draw a row for each mode found, from the first stage to the last.

    :param records: of the folders of all stages
    """
    at = stages(records)
    seeds = shown_seeds(at[max(at)]) or {"not solved": min(at[max(at)])}
    size = (2.1 * len(at), 0.6 + 3.9 * len(seeds))
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(len(seeds), len(at), sharex=True, sharey=True, squeeze=False)
    for row, (mode, seed) in zip(panels, sorted(seeds.items()), strict=True):
        for axes, (budget, runs) in zip(row, at.items(), strict=True):
            _draw(axes, runs[seed], f"seed {seed}, {budget} rollout{'s' if budget > 1 else ''}")
        row[0].set_ylabel(f"{name(mode)}\ny [m]")
    for axes in panels[-1]:
        axes.set_xlabel("x [m]")
    return figure


def _draw(axes: Axes, run: RunRecord, title: str) -> None:
    rollout: RolloutRecord = greedy(run)
    scene = scene_of(run)
    if scene is not None:
        draw_scene(axes, scene)
    colour, line = (COLOURS[0], "-") if rollout.success else (COLOURS[1], "--")
    axes.plot(*np.array(rollout.executed).T, color=colour, linestyle=line, linewidth=1.8)
    axes.set_title(f"{title}\n{'solved' if rollout.success else 'not solved'}", fontsize=10)
    axes.set_aspect("equal")
    axes.spines[["top", "right"]].set_visible(False)


FIGURE = ThesisFigure(
    "fig-6.5",
    MADE,
    full=tuple(SuiteRuns(folder(b), SUITE, (OURS,), n_seeds=10, budget=b) for b in STAGES),
    quick=tuple(SuiteRuns(folder(b), SUITE, (OURS,), n_seeds=4, budget=b) for b in QUICK_STAGES),
    findings=findings,
    draw=draw,
)
