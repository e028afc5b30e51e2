"""Pictures of one rollout: a film (.gif, .mp4) or a sheet (.png)."""

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from benchmark_envs import make_task
from results.exceptions import BenchmarkError
from results.harness.record_files import read_record
from results.outside import find_algorithm
from sb3_nmp import FileFormatError, TrajectoryAlgorithm

ENDINGS = (".gif", ".mp4", ".png")
SHEET = (2, 4)  # rows and columns of pictures
GAP = 6  # pixels of white between them

Frames = list[NDArray[np.uint8]]


@dataclass(frozen=True)
class RenderRequest:
    """Whose rollout to draw: exactly one of ``model``, ``run`` and ``expert`` is given.

    :param task: the task's id
    :param model: file that ``model.save`` wrote
    :param run: a run's result file
    :param expert: mode of the task's scripted expert
    :param algorithm: name of the model's class
    :param seed: of the context, where the task draws it
    """

    task: str
    model: Path | None = None
    run: Path | None = None
    expert: str | None = None
    algorithm: str = "rcnmp"
    seed: int = 0


def render_rollout(request: RenderRequest, out: Path) -> None:
    """Draw a rollout into a file.

    :param request: whose
    :param out: ends in .gif, .mp4 or .png
    :raises BenchmarkError: another ending, or no such model
    """
    if out.suffix not in ENDINGS:
        raise BenchmarkError(f"--out is '{out}'; its ending must be one of {', '.join(ENDINGS)}.")
    context, trajectory = chosen_rollout(request)
    env = gym.make(request.task, render_mode="rgb_array_list", context=context)
    env.reset(seed=request.seed)
    env.step(trajectory)
    frames: Frames = env.render()  # type: ignore[assignment]
    env.close()
    out.parent.mkdir(parents=True, exist_ok=True)
    write_frames(frames, out, env.metadata["render_fps"])


def chosen_rollout(request: RenderRequest) -> tuple[np.ndarray, np.ndarray]:
    """Return the context, shape (C,), and the trajectory, shape (T, D).

    :param request: whose
    :raises BenchmarkError: no such model, or the run is of another task
    """
    if request.run is not None:
        return rollout_of_run(request.run, request.task)
    if request.seed < 0:
        raise BenchmarkError(f"--seed is {request.seed}; it must be 0 or more.")
    task = make_task(request.task)
    context = task.sample_context(np.random.default_rng(request.seed))
    if request.model is None:
        return context, _float32(task.demonstrate(context, request.expert))
    action, _ = load_model(request).predict(_float32(context), deterministic=True)
    return context, action


def load_model(request: RenderRequest) -> TrajectoryAlgorithm:
    """Return the model of a request.

    :param request: whose
    :raises BenchmarkError: there is no such file, or it is none of this algorithm. No code from it
        is run
    """
    if request.model is None or not request.model.exists():
        raise BenchmarkError(f"there is no model '{request.model}'; give a file of model.save().")
    algorithm = find_algorithm(request.algorithm).load()
    try:
        return algorithm.load(request.model)
    except FileFormatError as error:
        raise BenchmarkError(
            f"'{request.model}' cannot be read as a model of {algorithm.__name__} ({error}); give "
            "a file of model.save(), and with --algorithm the class that it was saved by."
        ) from error


def rollout_of_run(path: Path, task: str) -> tuple[np.ndarray, np.ndarray]:
    """Return context (C,) and trajectory (T, D) of a run's last greedy rollout.

    :param path: of the run's file
    :param task: its task's id
    :raises BenchmarkError: a failed run, one of another task, or one over many contexts
    """
    record = read_record(path)
    if not record.finished or record.specification.task != task:
        raise BenchmarkError(
            f"'{path}' is a {record.outcome} run on {record.specification.task}; a finished one on "
            f"{task} is needed."
        )
    context, rollout = record.measured.context, record.measured.rollouts.get("greedy")
    if context is None or rollout is None:
        raise BenchmarkError(
            f"'{path}' holds no rollout, because it is a run over many contexts; give one in a "
            "single context, or a model (--model)."
        )
    return np.array(context.values), _float32(rollout.trajectory)


def write_frames(frames: Frames, out: Path, per_second: float) -> None:
    """Write a film, or a sheet of evenly spaced pictures.

    :param frames: pictures of shape (H, W, 3)
    :param out: its ending, one of `ENDINGS`, tells which
    :param per_second: pictures in a second of the film
    :raises BenchmarkError: the package for .mp4 is not installed
    """
    from PIL import Image

    if out.suffix == ".gif":
        first, *rest = [Image.fromarray(frame) for frame in frames]
        milliseconds = round(1000 / per_second)
        first.save(out, save_all=True, append_images=rest, duration=milliseconds, loop=0)
    elif out.suffix == ".png":
        Image.fromarray(sheet_of(frames)).save(out)
    else:
        try:
            imageio = import_module("imageio.v3")
            import_module("imageio_ffmpeg")
        except ImportError as error:
            raise BenchmarkError(
                f"'{out}' needs imageio and ffmpeg: pip install 'sb3-nmp[video]', or write a .gif "
                "or .png."
            ) from error
        options = {"fps": per_second, "macro_block_size": 8}  # 360 rows stay 360
        imageio.imwrite(out, np.stack(frames), plugin="FFMPEG", **options)


def sheet_of(frames: Frames) -> NDArray[np.uint8]:
    """Return evenly spaced pictures as one, `SHEET` rows and columns.

    :param frames: pictures of shape (H, W, 3)
    """
    rows, columns = SHEET
    chosen = np.linspace(0, len(frames) - 1, rows * columns).round().astype(int)
    margins = ((0, 0), (0, GAP), (0, GAP), (0, 0))
    spaced = np.pad(np.array([frames[i] for i in chosen]), margins, constant_values=255)
    sheet = np.vstack([np.hstack(list(line)) for line in np.split(spaced, rows)])
    return sheet[:-GAP, :-GAP]


def _float32(values: object) -> NDArray[np.float32]:
    return np.asarray(values, np.float32)
