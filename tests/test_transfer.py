"""Skill transfer between robots (Eq. 5.4): a latent space that both robots share."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from numpy.typing import NDArray

from sb3_nmp import (
    CNMPArchitecture,
    ConfigurationError,
    Demonstrations,
    FileFormatError,
    InvalidDataError,
    SkillTransfer,
    TransferTraining,
)
from sb3_nmp.models.cnmp import CNMP
from sb3_nmp.models.cnmp_training import PointBatch, negative_log_likelihood
from sb3_nmp.transfer.training import shared_latent_loss

QUICK = TransferTraining(n_steps=400)
SMALL = dataclasses.replace(
    CNMPArchitecture.preset("latent"),
    representation_dim=8,
    encoder_arch=(64,),
    decoder_arch=(64,),
    n_frequencies=2,
    n_members=1,
)
FloatArray = NDArray[np.float64]


def first_robot(skills: FloatArray) -> FloatArray:
    """Two joints, 40 time points; a skill is (amplitude, tilt)."""
    t = np.linspace(0, 1, 40)
    return np.stack([skills[:, :1] * np.sin(np.pi * t), 0.5 + skills[:, 1:] * t], axis=2)


def second_robot(skills: FloatArray) -> FloatArray:
    """Three joints of other sizes, 70 time points."""
    t, (size, tilt) = np.linspace(0, 1, 70), (skills[:, :1], skills[:, 1:])
    return np.stack(
        [2 - tilt * t**2, size * t + 0.3 * tilt * np.cos(3 * t), -0.5 * size * np.sin(np.pi * t)],
        axis=2,
    )


GRID = np.array([[a, b] for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0)])
NEW = np.array([[0.5, -0.5], [-0.4, 0.7]])
SOURCE = Demonstrations(GRID, first_robot(GRID))
TARGET = Demonstrations(GRID, second_robot(GRID))


def fitted(training: TransferTraining = QUICK, seed: int = 0) -> SkillTransfer:
    return SkillTransfer(SOURCE, TARGET, architecture=SMALL, training=training, seed=seed).fit()


def error(transfer: SkillTransfer) -> float:
    """Root mean square error of new skills, in the second robot's unit."""
    return float(np.sqrt(np.mean((transfer.translate(first_robot(NEW)) - second_robot(NEW)) ** 2)))


@pytest.fixture(scope="module")
def transfer() -> SkillTransfer:
    return fitted()


def nearest_error() -> float:
    """The same of the twin: the second robot's version of the nearest proxy skill."""
    apart = np.mean((first_robot(NEW)[:, None] - SOURCE.trajectories[None]) ** 2, axis=(2, 3))
    answered = TARGET.trajectories[apart.argmin(axis=1)]
    return float(np.sqrt(np.mean((answered - second_robot(NEW)) ** 2)))


def test_new_skills_are_translated_and_the_shared_latent_is_why(transfer: SkillTransfer) -> None:
    alone = fitted(dataclasses.replace(QUICK, latent_weight=0.0))
    shared = error(transfer)
    assert shared < 0.12
    assert shared < 0.5 * nearest_error()
    assert shared < 0.25 * error(alone)


def test_the_other_direction_and_a_robots_own_trajectories(transfer: SkillTransfer) -> None:
    back = transfer.translate(second_robot(NEW), to="source")
    assert back.shape == (2, 40, 2)
    assert np.sqrt(np.mean((back - first_robot(NEW)) ** 2)) < 0.12
    own = transfer.decode(transfer.encode(first_robot(GRID), robot="source"), "source")
    assert np.sqrt(np.mean((own - SOURCE.trajectories) ** 2)) < 0.1


def test_both_robots_put_a_skill_at_the_same_place(transfer: SkillTransfer) -> None:
    one = transfer.encode(first_robot(NEW), robot="source")
    two = transfer.encode(second_robot(NEW), robot="target")
    spread = transfer.encode(SOURCE.trajectories).std(axis=0).mean()
    assert np.abs(one - two).mean() < 0.2 * spread


def test_any_number_of_conditioning_points_at_any_time(transfer: SkillTransfer) -> None:
    shown = first_robot(NEW)
    rows = np.array([0, 3, 8, 12, 17, 21, 26, 30, 35, 39])
    some = transfer.translate(shown[:, rows], times=rows / 39)
    assert np.sqrt(np.mean((some - second_robot(NEW)) ** 2)) < 0.2
    assert np.abs(transfer.translate(shown[0]) - transfer.translate(shown)[0]).max() < 1e-5
    doubled = transfer.translate(np.repeat(shown[0], 2, axis=0), np.repeat(np.arange(40) / 39, 2))
    assert np.abs(doubled - transfer.translate(shown[0])).max() < 1e-5
    late = np.arange(28, 40)
    right, wrong = (transfer.translate(shown[:, late], times=at) for at in (late / 39, late / 78))
    apart = [np.mean((found - second_robot(NEW)) ** 2) for found in (right, wrong)]
    assert apart[0] < 0.5 * apart[1]


def test_demonstrations_keep_their_contexts(transfer: SkillTransfer) -> None:
    found = transfer.translate(Demonstrations(np.array([[7.0]]), first_robot(NEW[:1])))
    assert found.contexts.tolist() == [[7.0]]
    assert found.trajectory_shape == (70, 3)


def test_the_loss_is_eq_5_4() -> None:
    """Against its three terms, each computed apart."""
    th.manual_seed(0)
    networks = (CNMP(1, (5, 2), SMALL), CNMP(1, (9, 3), SMALL))
    pair = []
    for n_joints, n_seen in ((2, 4), (3, 6)):  # 3 targets each
        shape = (7, n_seen + 3)
        pair.append(
            PointBatch(
                th.rand(shape), th.randn(*shape, n_joints), th.ones(7, n_seen), th.zeros(7, 1)
            )
        )
    codes = [
        cnmp.network.encode(batch.times[:, :-3], batch.values[:, :-3], batch.condition, batch.seen)
        for cnmp, batch in zip(networks, pair, strict=True)
    ]
    alone = [
        negative_log_likelihood(cnmp.network, batch)
        for cnmp, batch in zip(networks, pair, strict=True)
    ]
    distance = ((codes[0] - codes[1]) ** 2).sum() / (7 * SMALL.representation_dim)
    for weight in (0.0, 1.0, 50.0):
        expected = alone[0] + alone[1] + weight * distance
        found = shared_latent_loss(networks, (pair[0], pair[1]), weight)
        assert float(found.detach()) == pytest.approx(float(expected.detach()), rel=1e-5)


def test_equal_seeds_give_equal_networks_and_no_global_generator_is_touched() -> None:
    short = dataclasses.replace(QUICK, n_steps=5)
    before = th.get_rng_state()
    one, two, other = (fitted(short, seed).translate(first_robot(NEW)) for seed in (3, 3, 4))
    assert np.array_equal(one, two)
    assert not np.array_equal(one, other)
    assert th.equal(before, th.get_rng_state())


def test_an_ensemble_is_trained_as_one(tmp_path: Path) -> None:
    several = dataclasses.replace(SMALL, n_members=3)
    short = dataclasses.replace(QUICK, n_steps=5)
    model = SkillTransfer(SOURCE, TARGET, architecture=several, training=short, seed=0).fit()
    assert model.encode(first_robot(NEW)).shape == (2, 3 * 8)
    assert model.translate(first_robot(NEW)).shape == (2, 70, 3)


def test_save_and_load(transfer: SkillTransfer, tmp_path: Path) -> None:
    transfer.save(tmp_path / "transfer.pt")
    loaded = SkillTransfer.load(tmp_path / "transfer.pt")
    shown = first_robot(NEW)
    assert np.array_equal(loaded.translate(shown), transfer.translate(shown))
    assert (loaded.architecture, loaded.training) == (SMALL, QUICK)
    with pytest.raises(ConfigurationError, match="does not hold its demonstrations"):
        loaded.fit()


def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text").write_text("no archive")
    th.save({"format": "another"}, tmp_path / "other.pt")
    with pytest.raises(FileFormatError, match="no skill transfer"):
        SkillTransfer.load(tmp_path / "text")
    with pytest.raises(FileFormatError, match=r"torch\.save, whose pickles .* no skill transfer"):
        SkillTransfer.load(tmp_path / "other.pt")
    with pytest.raises(FileNotFoundError):
        SkillTransfer.load(tmp_path / "nowhere.pt")


def test_robots_that_show_different_skills_are_refused() -> None:
    elsewhere = Demonstrations(GRID + 0.1, TARGET.trajectories)
    with pytest.raises(
        InvalidDataError, match=r"the source shows the skill of context .* does not"
    ):
        SkillTransfer(SOURCE, elsewhere)
    with pytest.raises(InvalidDataError, match="must name the skills alike"):
        SkillTransfer(SOURCE, Demonstrations(GRID[:, :1], TARGET.trajectories))


def test_another_order_is_refused() -> None:
    with pytest.raises(InvalidDataError, match=r"row 0 .* same order"):
        SkillTransfer(SOURCE, TARGET[::-1])


def test_a_proxy_of_one_robot_only_is_refused() -> None:
    with pytest.raises(
        InvalidDataError, match=r"the source shows .*\[1.0, 1.0\].* target does not"
    ):
        SkillTransfer(SOURCE, TARGET[:-1])
    with pytest.raises(
        InvalidDataError, match=r"the target shows .*\[1.0, 1.0\].* source does not"
    ):
        SkillTransfer(SOURCE[:-1], TARGET)
    with pytest.raises(InvalidDataError, match="has 10 demonstrations and the target 9"):
        SkillTransfer(SOURCE[[*range(9), 0]], TARGET)


def test_an_empty_proxy_set_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="target is an empty list; it must be Demonstr"):
        SkillTransfer(SOURCE, [])  # type: ignore[arg-type]
    with pytest.raises(InvalidDataError, match="there is 1 proxy skill"):
        SkillTransfer(SOURCE[:1], TARGET[:1])


def test_bad_input_of_translate(transfer: SkillTransfer) -> None:
    with pytest.raises(InvalidDataError, match=r"\(N, T, 2\) or \(T, 2\), not \(70, 3\)"):
        transfer.translate(TARGET.trajectories[0])
    with pytest.raises(InvalidDataError, match="not finite"):
        transfer.translate(np.full((4, 2), np.nan))
    for wrong in ("a text", [["q"]], [[0.0, 1.0], [0.0]]):
        with pytest.raises(InvalidDataError, match="trajectories are not an array of numbers"):
            transfer.translate(wrong)  # type: ignore[call-overload]
    with pytest.raises(InvalidDataError, match="times are not an array of numbers"):
        transfer.translate(np.zeros((4, 2)), times="now")  # type: ignore[call-overload]
    with pytest.raises(InvalidDataError, match=r"4 times in \[0, 1\]"):
        transfer.translate(np.zeros((4, 2)), times=[0, 1, 2, 3])
    with pytest.raises(ConfigurationError, match="'source' or 'target'"):
        transfer.translate(SOURCE, to="left")  # type: ignore[arg-type]
    with pytest.raises(ConfigurationError, match=r"call fit\(\) first"):
        SkillTransfer(SOURCE, TARGET).translate(SOURCE)
    with pytest.raises(InvalidDataError, match=r"shape \(2, 3\); they need \(N, \d+\), as encode"):
        transfer.decode(np.zeros((2, 3)))
    with pytest.raises(InvalidDataError, match="latents hold nan"):
        transfer.decode(np.full_like(transfer.encode(SOURCE.trajectories), np.nan))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"seed": -1}, "seed is -1"),
        ({"training": {"n_steps": 5}}, "training is {'n_steps': 5}; it must be a TransferTraining"),
        ({"architecture": "latent"}, "architecture is 'latent'; it must be a CNMPArchitecture"),
    ],
)
def test_bad_arguments(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        SkillTransfer(SOURCE, TARGET, **given)


def test_what_watches_must_be_a_function() -> None:
    with pytest.raises(ConfigurationError, match="watch is 3; it must be a function"):
        SkillTransfer(SOURCE, TARGET, training=QUICK, seed=0).fit(watch=3)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "value"),
    [("n_steps", 0), ("latent_weight", -1.0), ("conditioning_points", (5, 2)), ("batch_size", 0)],
)
def test_settings_outside_their_range(name: str, value: object) -> None:
    with pytest.raises(ConfigurationError, match=name):
        dataclasses.replace(QUICK, **{name: value})
