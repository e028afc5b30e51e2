"""Pick-and-place on the field before any rollout: who answers unseen contexts, and where it fails.

``python -m results.experiments.pick_and_place_field answers out.json --seeds 200 201`` trains
ACNMP's network and the twins' regressions on 10 to 80 demonstrations and executes their answers in
the first unseen contexts of the suite ``pick-and-place-field``;
``python -m results.experiments.pick_and_place_field table out.json ...`` prints Markdown, and
``python -m results.experiments.pick_and_place_field draw picture.png out.json ...`` draws a figure.
"""

import argparse
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
import torch as th
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmark_envs.tasks.pick_and_place import PickAndPlaceTask
from results.harness.environments import RunTask
from results.report.figure_style import DPI, line_style, plain_axes
from results.stream.protocol import Stream
from results.suites.pick_and_place_field import RECIPE, TASKS
from sb3_nmp import CNMPArchitecture, CNMPPretraining, Demonstrations
from sb3_nmp.common.regression import Regression, fit
from sb3_nmp.models.cnmp import CNMP
from sb3_nmp.models.cnmp_training import pretrain

FloatArray = NDArray[np.float64]
Answer = Callable[[FloatArray], FloatArray]

TASK_ID = "nmp/PickAndPlace-v1"
#: of which the figure shows the failures
SHOWN = 40
WORST_SHOWN = 30  # mm
#: what went wrong, in the order of time: a rollout counts for the first that holds
FAULTS = {
    "not grasped": "#D55E00",
    "tower touched": "#0072B2",
    "dropped or toppled": "#009E73",
    "beside the goal": "#CC79A7",
}
NETWORKS = {
    "ACNMP's network": (CNMPArchitecture(), CNMPPretraining()),
    "context through latents": (CNMPArchitecture.preset("latent"), CNMPPretraining()),
    "longer training": (CNMPArchitecture(), CNMPPretraining(n_steps=4000, batch_size=32)),
    "256 units": (
        CNMPArchitecture(representation_dim=32, context_arch=(128, 128), decoder_arch=(256, 256)),
        CNMPPretraining(),
    ),
}
ANSWERERS = (*NETWORKS, *get_args(Regression))


def learn(name: str, shown: Demonstrations, seed: int) -> Answer:
    """Return what answers contexts, shape (N, C), with trajectories, shape (N, T, D).

    :param name: of `ANSWERERS`
    :param shown: what it learns from
    :param seed: of a network's weights and batches
    """
    if name in NETWORKS:
        architecture, pretraining = NETWORKS[name]
        with th.random.fork_rng():
            th.manual_seed(seed)
            network = CNMP(shown.context_dim, shown.trajectory_shape, architecture)
        return pretrain(shown, pretraining, np.random.default_rng(seed), network).trajectories
    rows = shown.trajectories.reshape(len(shown), -1)
    answer = fit(cast(Regression, name), shown.contexts, rows)
    return lambda contexts: answer(contexts).reshape(-1, *shown.trajectory_shape)


def outcomes(task: PickAndPlaceTask, contexts: FloatArray, answered: FloatArray) -> dict[str, Any]:
    """Return each answer's fault (empty: none), terms and joint errors, as plain JSON values.

    :param task: in which they are executed
    :param contexts: shape (N, 6) in m
    :param answered: shape (N, T, 6) in rad
    """
    rollouts = task.simulate(contexts, answered)
    expert = np.stack([task.demonstrate(context) for context in contexts])
    happened = {name: did > 0 for name, did in rollouts.outcomes.items()}
    faults = np.full(len(contexts), "beside the goal", dtype=object)
    faults[happened["dropped"] | happened["toppled"]] = "dropped or toppled"
    faults[happened["touched_tower"]] = "tower touched"
    faults[~happened["grasped"]] = "not grasped"
    faults[rollouts.successes] = ""
    terms = {name: rollouts.terms[name].round(5).tolist() for name in ("grasp", "avoid", "place")}
    errors = np.degrees(np.sqrt(np.mean((answered - expert) ** 2, axis=(0, 1))))
    return {"faults": faults.tolist(), "terms": terms, "joints": errors.round(4).tolist()}


def record(
    path: Path, names: Iterable[str], seeds: Iterable[int], numbers: Iterable[int], n_test: int
) -> None:
    """Train, execute, and write what came of it after each answerer, so that a part can be read.

    :param path: of the JSON file
    :param names: of `ANSWERERS`
    :param seeds: of demonstrations and networks
    :param numbers: of demonstrations
    :param n_test: unseen contexts, the suite's first ones
    """
    done: list[dict[str, Any]] = []
    for seed in seeds:
        for n in numbers:
            protocol = Stream(n, RECIPE.protocols[0].settings["n_contexts"], n_test)
            run = RunTask(TASK_ID, seed, RECIPE.budget, settings=TASKS[TASK_ID])
            task, shown = cast(PickAndPlaceTask, run.task), protocol.demonstrations(run)
            contexts = protocol.test_contexts(task)
            for name in names:
                answered = learn(name, cast(Demonstrations, shown), seed)(contexts)
                found = outcomes(task, contexts, answered)
                done.append({"seed": seed, "n": n, "name": name, **found})
                everything = {"contexts": contexts.tolist(), "runs": done}
                path.write_text(json.dumps(everything), encoding="utf-8")
                failed = np.mean([fault != "" for fault in found["faults"]])
                print(f"seed {seed}, {n:3d} demonstrations, {name}: {failed:.1%} fail", flush=True)


def table(runs: list[dict[str, Any]]) -> str:
    """Return a Markdown table: shares that fail by number of demonstrations, and what is off.

    :param runs: of `record`
    """
    numbers = sorted({run["n"] for run in runs})
    most = SHOWN if SHOWN in numbers else numbers[-1]
    head = [*(f"{n}" for n in numbers), *FAULTS, "grasp [mm]", "tower [mm]", "place [mm]"]
    lines = [f"| | {' | '.join(head)} |", f"|---|{'--:|' * len(head)}"]
    for name in dict.fromkeys(run["name"] for run in runs):
        own = [run for run in runs if run["name"] == name]
        shares = [failing([run for run in own if run["n"] == n]) for n in numbers]
        shown = [run for run in own if run["n"] == most]
        faults = [fault for run in shown for fault in run["faults"]]
        cells = [f"{share:.1%}" for share in shares]
        cells += [f"{faults.count(fault) / max(len(faults), 1):.1%}" for fault in FAULTS]
        for term in ("grasp", "avoid", "place"):
            values = -1e3 * np.concatenate([run["terms"][term] for run in shown])
            cells.append(f"{np.median(values):.1f} ({np.percentile(values, 95):.0f})")
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def failing(runs: list[dict[str, Any]]) -> float:
    """Return the share of answers that fail, NaN of no runs.

    :param runs: of `record`
    """
    faults = [fault for run in runs for fault in run["faults"]]
    return float(np.mean([fault != "" for fault in faults])) if faults else float("nan")


def draw(contexts: FloatArray, runs: list[dict[str, Any]]) -> Figure:
    """Draw failures over the number of demonstrations, and where three of the answerers are off.

    :param contexts: unseen ones, shape (N, 6) in m
    :param runs: of `record`
    """
    figure = Figure(figsize=(15, 4.4), layout="constrained")
    panels = figure.subplots(1, 4, width_ratios=[1.1, 1, 1, 1])
    draw_rates(panels[0], runs)
    mapped = ("ACNMP's network", "gaussian-process", "ridge")
    own = [[run for run in runs if run["name"] == name and run["n"] == SHOWN] for name in mapped]
    dots = [
        map_errors(axes, contexts, name, of_name)
        for axes, name, of_name in zip(panels[1:], mapped, own, strict=True)
    ]
    figure.colorbar(dots[-1], ax=panels[3], label="gripper off at object (o) and goal (x) [mm]")
    handles, labels = panels[3].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower right", ncols=len(labels), frameon=False)
    return figure


def draw_rates(axes: Axes, runs: list[dict[str, Any]]) -> None:
    """Draw which share fails over the number of demonstrations.

    :param axes: of the panel
    :param runs: of `record`
    """
    for name in [name for name in ANSWERERS if any(run["name"] == name for run in runs)]:
        own = [run for run in runs if run["name"] == name]
        numbers = sorted({run["n"] for run in own})
        rates = [100 * failing([run for run in own if run["n"] == n]) for n in numbers]
        axes.plot(numbers, rates, marker="o", label=name, **line_style(name, ANSWERERS))
    axes.set(xlabel="demonstrations", ylabel="unseen contexts that fail [%]", ylim=(-3, 103))
    axes.set_xticks(sorted({run["n"] for run in runs}))
    axes.legend(frameon=False, fontsize=8)
    plain_axes(axes)


def map_errors(
    axes: Axes, contexts: FloatArray, name: str, runs: list[dict[str, Any]]
) -> PathCollection:
    """Draw how far the gripper is off at objects and goals, and the ways that fail; return dots.

    :param axes: of the panel
    :param contexts: shape (N, 6) in m
    :param name: of the answerer
    :param runs: its, at least one
    """
    for fault, colour in FAULTS.items():
        for run in runs:
            for way in contexts[np.array(run["faults"]) == fault]:
                axes.plot(way[[0, 2]], way[[1, 3]], color=colour, linewidth=0.9, alpha=0.8)
        axes.plot([], [], color=colour, label=fault)
    n = sum(len(run["faults"]) for run in runs)
    axes.set(xlabel=f"x [m]; {failing(runs):.1%} of {n} fail", ylabel="y [m]", aspect="equal")
    axes.set_title(f"{name}, {SHOWN} demonstrations", fontsize=10)
    style: dict[str, Any] = {"s": 16, "cmap": "viridis_r", "vmin": 0, "vmax": WORST_SHOWN}
    grasp, place = (
        -1e3 * np.mean([run["terms"][term] for run in runs], axis=0) for term in ("grasp", "place")
    )
    axes.scatter(*contexts[:, 2:4].T, c=place, marker="x", **style)
    return axes.scatter(*contexts[:, :2].T, c=grasp, marker="o", **style)


def main() -> None:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    commands = parser.add_subparsers(dest="command", required=True)
    answers = commands.add_parser("answers")
    answers.add_argument("file", type=Path)
    answers.add_argument("--answerers", nargs="+", choices=ANSWERERS, default=ANSWERERS)
    answers.add_argument("--seeds", type=int, nargs="+", default=[200])
    answers.add_argument("--demonstrations", type=int, nargs="+", default=[10, 20, 40, 80])
    answers.add_argument("--contexts", type=int, default=200)
    commands.add_parser("table").add_argument("files", type=Path, nargs="+")
    drawing = commands.add_parser("draw")
    drawing.add_argument("picture", type=Path)
    drawing.add_argument("files", type=Path, nargs="+")
    options = parser.parse_args()
    if options.command == "answers":
        numbers, n_test = options.demonstrations, options.contexts
        record(options.file, options.answerers, options.seeds, numbers, n_test)
        return
    found = [json.loads(path.read_text(encoding="utf-8")) for path in options.files]
    runs = [run for each in found for run in each["runs"]]
    if options.command == "table":
        print(table(runs))
    else:
        draw(np.array(found[0]["contexts"]), runs).savefig(options.picture, dpi=DPI)


if __name__ == "__main__":
    main()
