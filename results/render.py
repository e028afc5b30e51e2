"""Pictures of one rollout: a film (.gif, .mp4) or a sheet (.png)."""

import inspect
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from benchmark_envs import Task, make_task
from results.exceptions import BenchmarkError, UnreadableRecordError
from results.harness.record_files import read_record
from results.harness.records import RunRecord
from results.outside import find_algorithm
from results.rollout_sheet import save_sheet
from sb3_nmp import FileFormatError, TrajectoryAlgorithm

ENDINGS = (".gif", ".mp4", ".png")
SIZE = (480, 360)  # pixels
FASTEST = 50.0  # pictures in a second of a film: more cannot be told apart, and .gif has no more
SPEEDS = (0.01, 100.0)
MARGIN = 8  # pixels from the corner to what is written there

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
    :param context: shape (C,), instead of a drawn one
    """

    task: str
    model: Path | None = None
    run: Path | None = None
    expert: str | None = None
    algorithm: str = "rcnmp"
    seed: int = 0
    context: tuple[float, ...] | None = None


@dataclass(frozen=True)
class Look:
    """How a rollout is drawn.

    :param camera: by its name in the task's model; None takes the task's own
    :param size: width and height of a picture, in pixels
    :param speed: of a film, 1 is that of the rollout; another factor is written on the pictures
    :raises BenchmarkError: a speed outside `SPEEDS`
    """

    camera: str | None = None
    size: tuple[int, int] = SIZE
    speed: float = 1.0

    def __post_init__(self) -> None:
        """Check the speed."""
        low, high = SPEEDS
        if not low <= self.speed <= high:
            raise BenchmarkError(
                f"--speed is {self.speed}; it must be between {low} and {high}: 1 is as fast as "
                "the rollout, 0.5 half."
            )


def render_rollout(request: RenderRequest, out: Path, look: Look = Look()) -> None:
    """Draw a rollout into a file.

    :param request: whose
    :param out: ends in .gif, .mp4 or .png
    :param look: of the pictures
    :raises BenchmarkError: another ending, or no such model
    :raises TaskError: no such camera, or a context outside the task's space
    """
    if out.suffix not in ENDINGS:
        raise BenchmarkError(f"--out is '{out}'; its ending must be one of {', '.join(ENDINGS)}.")
    if out.suffix == ".png" and look.speed != 1.0:
        raise BenchmarkError(f"--speed goes with films, and '{out}' is a sheet of pictures.")
    task, context, trajectory = chosen_rollout(request)
    width, height = look.size
    named = {} if look.camera is None else {"camera": look.camera}
    if named and "camera" not in inspect.signature(task.frames).parameters:
        raise BenchmarkError(
            f"--camera is '{look.camera}', and {request.task or 'the task'} draws by one camera: "
            "its frames() takes no other."
        )
    frames = task.frames(context, trajectory, width, height, **named)
    out.parent.mkdir(parents=True, exist_ok=True)
    if out.suffix == ".png":
        save_sheet(frames, task, task.simulate(context, trajectory), out)
    else:
        write_film(frames, out, task.frames_per_second, look.speed)


def chosen_rollout(request: RenderRequest) -> tuple[Task, np.ndarray, np.ndarray]:
    """Return the task, the context, shape (C,), and the trajectory, shape (T, D).

    :param request: whose
    :raises BenchmarkError: no such model, or the run is of another task
    """
    if request.run is not None:
        return rollout_of_run(request.run, request)
    if request.seed < 0:
        raise BenchmarkError(f"--seed is {request.seed}; it must be 0 or more.")
    task = make_task(request.task)
    context = (
        task.sample_context(np.random.default_rng(request.seed))
        if request.context is None
        else task.check_context(request.context)
    )
    if request.model is None:
        return task, context, _float32(task.demonstrate(context, request.expert))
    model = load_model(request)
    check_spaces(model, task, request)
    action, _ = model.predict(_float32(context), deterministic=True)
    return task, context, action


def load_model(request: RenderRequest) -> TrajectoryAlgorithm:
    """Return the model of a request.

    :param request: whose
    :raises BenchmarkError: there is no such file, it is none of this algorithm, or reading this
        algorithm's files may run their code
    """
    if request.model is None or not request.model.exists():
        raise BenchmarkError(f"there is no model '{request.model}'; give a file of model.save().")
    algorithm = find_algorithm(request.algorithm).load()
    if not issubclass(algorithm, TrajectoryAlgorithm):
        raise BenchmarkError(
            f"--algorithm {request.algorithm} is no TrajectoryAlgorithm, and other classes may "
            "unpickle what they load, which can run any code: give a run of it instead (--run)."
        )
    try:
        return algorithm.load(request.model)
    except FileFormatError as error:
        raise BenchmarkError(
            f"'{request.model}' cannot be read as a model of {algorithm.__name__} ({error}); give "
            "a file of model.save(), and with --algorithm the class that it was saved by."
        ) from error


def rollout_of_run(path: Path, request: RenderRequest) -> tuple[Task, np.ndarray, np.ndarray]:
    """Return the task, context (C,) and trajectory (T, D) of a run's last greedy rollout.

    :param path: of the run's file
    :param request: which names the task
    :raises BenchmarkError: a failed run, one of another task, one over many contexts, or a context
        besides the run's own
    """
    record = _record(path)
    asked = record.specification
    if not record.finished or asked.task != request.task:
        raise BenchmarkError(
            f"'{path}' is a {record.outcome} run on {asked.task}; a finished one on "
            f"{request.task} is needed."
        )
    context, rollout = record.measured.context, record.measured.rollouts.get("greedy")
    if context is None or rollout is None:
        raise BenchmarkError(
            f"'{path}' holds no rollout, because it is a run over many contexts; give one in a "
            "single context, or a model (--model)."
        )
    if request.context is not None:
        raise BenchmarkError(
            f"--context does not go with --run: '{path}' has a rollout in its own context alone."
        )
    task = make_task(asked.task, **asked.task_settings)
    return task, np.array(context.values), _float32(rollout.trajectory)


def _record(path: Path) -> RunRecord:
    """Return a run that was named; to remove its file, as in a folder of runs, is no advice here.

    :raises BenchmarkError: there is none
    :raises RecordError: it is of another version
    """
    if not path.is_file():
        raise BenchmarkError(f"there is no file '{path}'; name a run's file (--run).")
    try:
        return read_record(path)
    except UnreadableRecordError as error:
        raise BenchmarkError(
            f"'{path}' is no record of a run ({error.why}): --run takes a JSON file that "
            "'nmp-bench run' wrote, and --model a .zip of model.save()."
        ) from error


def check_spaces(model: TrajectoryAlgorithm, task: Task, request: RenderRequest) -> None:
    """Raise unless a model answers a task's contexts with its trajectories.

    :param model: of the request
    :param task: of the request
    :param request: for the message
    :raises BenchmarkError: it was trained in other spaces
    """
    for what, has, asked in (
        ("contexts", model.observation_space, task.context_space),
        ("trajectories", model.action_space, task.trajectory_space),
    ):
        if has != asked:
            raise BenchmarkError(
                f"'{request.model}' was trained on {what} of {_told(has)}, and those of "
                f"{request.task} are of {_told(asked)}: name the model's task."
            )


def _told(space: spaces.Space[Any]) -> str:
    """Return the shape and the bounds of contexts or trajectories in words."""
    if not isinstance(space, spaces.Box):
        return f"{space}"
    rows = (np.atleast_2d(bound).round(4) for bound in (space.low, space.high))
    low, high = (bound[0].tolist() for bound in rows)
    return f"shape {space.shape} from {low} to {high}"


def write_film(frames: Frames, out: Path, per_second: float, speed: float = 1.0) -> None:
    """Write a film.

    :param frames: pictures of shape (H, W, 3)
    :param out: ends in .gif or .mp4
    :param per_second: pictures in a second of the rollout
    :param speed: of the film, in that of the rollout; a factor other than 1 is written on it
    :raises BenchmarkError: the package for .mp4 is not installed
    """
    from PIL import Image

    stride = int(np.ceil(per_second * speed / FASTEST))
    rate = per_second * speed / stride
    shown = [_with_speed(frame, speed) for frame in frames[::stride]]
    if out.suffix == ".gif":
        first, *rest = [Image.fromarray(frame) for frame in shown]
        ends = np.round(100 / rate * np.arange(len(shown) + 1)).astype(int)  # its unit is 10 ms
        durations = (10 * np.diff(ends)).tolist()
        first.save(out, save_all=True, append_images=rest, duration=durations, loop=0)
        return
    try:
        imageio = import_module("imageio.v3")
        import_module("imageio_ffmpeg")
    except ImportError as error:
        raise BenchmarkError(
            f"'{out}' needs imageio and ffmpeg: pip install 'sb3-nmp[video]', or write a .gif "
            "or .png."
        ) from error
    options = {"fps": rate, "macro_block_size": 8}  # 360 rows stay 360
    imageio.imwrite(out, np.stack(shown), plugin="FFMPEG", **options)


def _with_speed(frame: NDArray[np.uint8], speed: float) -> NDArray[np.uint8]:
    """Return a picture with the film's speed in its corner, where that is not the rollout's."""
    if speed == 1.0:
        return frame
    from PIL import Image, ImageDraw

    picture = Image.fromarray(frame)
    font_size = max(12, frame.shape[0] // 16)
    ImageDraw.Draw(picture).text(
        (MARGIN, MARGIN), f"{speed:g}x speed", "black", font_size=font_size,
        stroke_width=2, stroke_fill="white",
    )  # fmt: skip
    return np.asarray(picture)


def _float32(values: object) -> NDArray[np.float32]:
    return np.asarray(values, np.float32)
