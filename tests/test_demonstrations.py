"""Demonstrations: checked once, frozen, and read back as they were written."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import benchmark_envs
from sb3_nmp import Demonstrations
from sb3_nmp.common.exceptions import ConfigurationError, FileFormatError, InvalidDataError

TASK_ID = "nmp/Bottles-v0"


def make(n: int = 3, t: int = 5, d: int = 2, c: int = 4) -> Demonstrations:
    rng = np.random.default_rng(0)
    return Demonstrations(rng.normal(size=(n, c)), rng.normal(size=(n, t, d)))


def test_shapes_and_types() -> None:
    shown = make()
    assert len(shown) == 3
    assert shown.context_dim == 4 and shown.trajectory_shape == (5, 2)
    assert shown.contexts.dtype == shown.trajectories.dtype == np.float64
    part = shown[np.array([True, False, True])]
    np.testing.assert_array_equal(part.trajectories, shown.trajectories[[0, 2]])
    np.testing.assert_array_equal(part.contexts, shown.contexts[[0, 2]])


def test_arrays_are_read_only_copies() -> None:
    contexts, trajectories = np.zeros((1, 1)), np.zeros((1, 2, 1))
    shown = Demonstrations(contexts, trajectories)
    trajectories[:] = 7
    contexts[:] = 7
    assert not shown.trajectories.any() and not shown.contexts.any()
    for array in (shown.contexts, shown.trajectories):
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 1
    with pytest.raises(AttributeError):
        setattr(shown, "contexts", contexts)  # noqa: B010


@pytest.mark.parametrize(
    ("contexts", "trajectories", "message"),
    [
        (np.zeros((2, 1)), [np.zeros((5, 1)), np.zeros((6, 1))], r"mixed shapes \(\(5, 1\), \(6,"),
        ([[0.0], [0.0, 1.0]], np.zeros((2, 5, 1)), "contexts have mixed shapes"),
        (np.zeros((2, 1)), np.zeros((3, 5, 1)), "2 contexts were given for 3 trajectories"),
        (np.zeros(2), np.zeros((2, 5, 1)), r"contexts have shape \(2,\); they need \(N, C\)"),
        (np.zeros((2, 1)), np.zeros((2, 5)), r"trajectories have shape \(2, 5\)"),
        (np.zeros((0, 1)), np.zeros((0, 5, 1)), "empty"),
        ([], [], "empty"),
        (np.zeros((2, 1)), np.zeros((2, 1, 1)), "at least 2 time points"),
        (np.zeros((2, 0)), np.zeros((2, 5, 1)), "1 task parameter"),
        ([["a"]], np.zeros((1, 5, 1)), "contexts are not an array of numbers"),
    ],
)
def test_what_is_no_set_of_demonstrations_is_refused(
    contexts: Any, trajectories: Any, message: str
) -> None:
    with pytest.raises(InvalidDataError, match=message):
        Demonstrations(contexts, trajectories)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_that_are_not_finite_are_refused_by_their_place(value: float) -> None:
    trajectories = np.zeros((2, 5, 1))
    trajectories[1, 3, 0] = value
    with pytest.raises(InvalidDataError, match=rf"hold {value} at index \(1, 3, 0\)"):
        Demonstrations(np.zeros((2, 1)), trajectories)
    with pytest.raises(InvalidDataError, match=rf"contexts hold {value} at index \(0, 0\)"):
        Demonstrations(np.array([[value]]), np.zeros((1, 5, 1)))


def test_what_does_not_fit_an_environment_is_refused() -> None:
    shown = make()
    shown.check_fits(4, (5, 2))
    with pytest.raises(InvalidDataError, match=r"have 4 entries, but the environment .* of 3"):
        shown.check_fits(3, (5, 2))
    with pytest.raises(InvalidDataError, match=r"\(5, 2\), but the environment has \(6, 2\)"):
        shown.check_fits(4, (6, 2))


def test_sets_can_be_joined_if_they_fit() -> None:
    shown = make(3)
    more = make(2)
    joined = shown.joined_with(more.contexts, more.trajectories)
    assert len(joined) == 5 and len(shown) == 3
    np.testing.assert_array_equal(joined.trajectories[3:], more.trajectories)
    with pytest.raises(InvalidDataError, match="further demonstrations"):
        shown.joined_with(np.zeros((1, 3)), np.zeros((1, 5, 2)))


def test_the_digest_names_the_numbers_and_the_shapes() -> None:
    shown = make()
    assert shown.digest == make().digest and shown == make() and hash(shown) == hash(make())
    changed = shown.trajectories.copy()
    changed[0, 0, 0] += 1e-9
    other = Demonstrations(shown.contexts, changed)
    reshaped = Demonstrations(shown.contexts, shown.trajectories.reshape(3, 2, 5))
    assert len({shown.digest, other.digest, reshaped.digest}) == 3
    assert shown != other and shown != "demonstrations"


# -- files ---------------------------------------------------------------------------------------


def test_saved_demonstrations_are_read_back_bit_for_bit(tmp_path: Path) -> None:
    shown = make()
    shown.save(tmp_path / "shown.npz")
    read = Demonstrations.load(tmp_path / "shown.npz")
    np.testing.assert_array_equal(read.contexts, shown.contexts)
    np.testing.assert_array_equal(read.trajectories, shown.trajectories)
    assert read.digest == shown.digest
    assert [file.name for file in tmp_path.iterdir()] == ["shown.npz"], "nothing is left behind"


def test_pickled_objects_are_never_loaded(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[Any, ...]:
            return (Path.touch, (tmp_path / "sprung",))

    trap: Any = np.array([Trap()], dtype=object)
    np.savez(tmp_path / "trap.npz", contexts=np.zeros((1, 1)), trajectories=trap)
    np.save(tmp_path / "trap.npy", trap)
    for name in ("trap.npz", "trap.npy"):
        with pytest.raises(FileFormatError, match=name):
            Demonstrations.load(tmp_path / name)
    assert not (tmp_path / "sprung").exists()


def test_files_that_are_not_ours_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "keys.npz", a=np.zeros(3))
    np.save(tmp_path / "array.npy", np.zeros(3))
    (tmp_path / "text.npz").write_text("contexts")
    (tmp_path / "empty.npz").write_bytes(b"")
    for name in ("keys.npz", "array.npy", "text.npz", "empty.npz"):
        with pytest.raises(FileFormatError, match=f"{name} does not hold demonstrations"):
            Demonstrations.load(tmp_path / name)
    with pytest.raises(FileNotFoundError):
        Demonstrations.load(tmp_path / "missing.npz")


def test_a_file_that_was_cut_off_is_refused(tmp_path: Path) -> None:
    make().save(tmp_path / "whole.npz")
    whole = (tmp_path / "whole.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FileFormatError, match=r"cut\.npz does not hold demonstrations"):
        Demonstrations.load(tmp_path / "cut.npz")


def test_a_file_with_wrong_arrays_says_what_is_wrong(tmp_path: Path) -> None:
    np.savez(tmp_path / "wrong.npz", contexts=np.zeros((2, 1)), trajectories=np.zeros((3, 5, 1)))
    with pytest.raises(InvalidDataError, match="2 contexts were given for 3"):
        Demonstrations.load(tmp_path / "wrong.npz")


# -- experts -------------------------------------------------------------------------------------


def test_a_tasks_expert_demonstrates_given_and_drawn_contexts() -> None:
    task = benchmark_envs.make_task(TASK_ID, random_bottles=True)
    drawn = Demonstrations.from_task(task, 3, seed=5)
    assert drawn == Demonstrations.from_task(task, 3, seed=5)
    assert drawn != Demonstrations.from_task(task, 3, seed=6)
    again = Demonstrations.from_task(task, drawn.contexts)
    assert again == drawn
    np.testing.assert_array_equal(drawn.trajectories[1], task.demonstrate(drawn.contexts[1]))


def test_ids_environments_and_tasks_are_all_experts() -> None:
    task = benchmark_envs.make_task(TASK_ID)
    experts: list[Any] = [TASK_ID, gym.make(TASK_ID), task]
    sets = [Demonstrations.from_task(expert, 2, seed=0) for expert in experts]
    assert sets[0] == sets[1] == sets[2]
    sets[0].check_fits(4, (200, 2))


def test_without_an_expert_or_contexts_there_are_no_demonstrations() -> None:
    with pytest.raises(ConfigurationError, match="seed is 'a'; it must be a whole number"):
        Demonstrations.from_task("nmp/Bottles-v0", 1, seed="a")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ConfigurationError, match="seed is -1; it must be a whole number from 0"):
        Demonstrations.from_task("nmp/Bottles-v0", 1, seed=-1)
    with pytest.raises(ConfigurationError, match="CartPoleEnv has no expert"):
        Demonstrations.from_task("CartPole-v1", 2)
    with pytest.raises(InvalidDataError, match="no context was given"):
        Demonstrations.from_task(TASK_ID, 0)
    with pytest.raises(InvalidDataError, match="no context was given"):
        Demonstrations.from_task(TASK_ID, np.zeros((0, 4)))


# -- Minari --------------------------------------------------------------------------------------


def test_without_minari_the_alternative_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sb3_nmp.common.minari_files.find_spec", lambda _: None)
    with pytest.raises(ConfigurationError, match=r"pip install minari\[hdf5\].*save and load"):
        Demonstrations.from_minari("bottles/expert-v0")
    with pytest.raises(ConfigurationError, match=r"pip install minari\[hdf5\]"):
        make().to_minari("bottles/expert-v0", TASK_ID)


def test_minari_round_trip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    shown = Demonstrations.from_task(TASK_ID, 2, seed=0)
    about = {
        "author": "us",
        "author_email": "us@example.org",
        "code_permalink": "https://example.org",
        "algorithm_name": "scripted expert",
        "description": "two trajectories through the bottles",
    }
    written = shown.to_minari("bottles/expert-v0", TASK_ID, **about)
    assert (written.total_episodes, written.total_steps) == (2, 2)
    read = Demonstrations.from_minari("bottles/expert-v0")
    np.testing.assert_allclose(read.contexts, shown.contexts, rtol=1e-6)
    np.testing.assert_allclose(read.trajectories, shown.trajectories, rtol=1e-6, atol=1e-7)
