"""Skill transfer whose latent space is of moments, and its twin, a regression on joints."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from baselines import MomentRegression
from sb3_nmp import (
    CNMPArchitecture,
    ConfigurationError,
    Demonstrations,
    InvalidDataError,
    SkillTransfer,
    TransferTraining,
)
from sb3_nmp.common import files
from sb3_nmp.transfer.skill_transfer import FILE_KIND

FloatArray = NDArray[np.float64]
SMALL = dataclasses.replace(
    CNMPArchitecture.preset("moment"),
    representation_dim=8,
    encoder_arch=(64,),
    decoder_arch=(64,),
    n_frequencies=2,
    n_members=1,
)
QUICK = dataclasses.replace(TransferTraining.preset("moment"), n_steps=800)


def reaches(ends: FloatArray, n_points: int) -> FloatArray:
    """Paths of a tip from the origin to an end, shape (N, T, 2)."""
    return ends[:, None] * np.linspace(0, 1, n_points)[:, None]


def there_and_back(ends: FloatArray, n_points: int) -> FloatArray:
    """A kind of path that no proxy skill has."""
    return ends[:, None] * np.sin(np.pi * np.linspace(0, 1, n_points))[:, None]


def first_arm(path: FloatArray) -> FloatArray:
    """Two joints for a place of the tip."""
    return np.stack([path[..., 0] + 0.2 * path[..., 1] ** 2, path[..., 1]], axis=-1)


def second_arm(path: FloatArray) -> FloatArray:
    """Three joints of other sizes for the same place."""
    x, y = path[..., 0], path[..., 1]
    return np.stack([2 - y, 3 * x + 0.5 * x * y, 0.3 * x - y], axis=-1)


RNG = np.random.default_rng(0)
ENDS, NEW = RNG.uniform(-1, 1, (12, 2)), RNG.uniform(-0.8, 0.8, (3, 2))
SOURCE = Demonstrations(ENDS, first_arm(reaches(ENDS, 40)))
TARGET = Demonstrations(ENDS, second_arm(reaches(ENDS, 70)))
SHOWN, WANTED = first_arm(there_and_back(NEW, 40)), second_arm(there_and_back(NEW, 70))


def fitted(**settings: Any) -> SkillTransfer:
    told = {"architecture": SMALL, "training": QUICK, "seed": 0, "shared": "moment"} | settings
    return SkillTransfer(SOURCE, TARGET, **told).fit()


def error(found: FloatArray) -> float:
    return float(np.sqrt(np.mean((found - WANTED) ** 2)))


@pytest.fixture(scope="module")
def transfer() -> SkillTransfer:
    return fitted()


def test_a_kind_of_skill_that_was_never_shown_is_translated(transfer: SkillTransfer) -> None:
    spread = float(np.sqrt(np.mean((WANTED - WANTED.mean(axis=(0, 1))) ** 2)))
    by_moments = error(transfer.translate(SHOWN))
    assert by_moments < 0.1 * spread
    apart = fitted(training=dataclasses.replace(QUICK, latent_weight=0.0))
    assert by_moments < 0.2 * error(apart.translate(SHOWN)), "the shared latent space is why"
    whole = fitted(shared="skill", training=dataclasses.replace(QUICK, latent_weight=100.0))
    assert by_moments < 0.2 * error(whole.translate(SHOWN)), "a whole skill is like the proxies"


def test_the_other_direction_is_translated_too(transfer: SkillTransfer) -> None:
    back = transfer.translate(WANTED, to="source")
    assert back.shape == (3, 40, 2)
    assert np.sqrt(np.mean((back - SHOWN) ** 2)) < 0.1


def test_a_moment_knows_its_time() -> None:
    time = np.linspace(0, 1, 40)[:, None]
    later = np.concatenate([reaches(ENDS, 40), np.tile(time, (12, 1, 1))], axis=2)
    model = SkillTransfer(
        SOURCE, Demonstrations(ENDS, later), architecture=SMALL, training=QUICK, seed=0,
        shared="moment",
    ).fit()  # fmt: skip
    assert np.abs(model.translate(SHOWN)[..., 2] - time[:, 0]).max() < 0.1


def test_both_robots_put_a_moment_at_the_same_place(transfer: SkillTransfer) -> None:
    path = there_and_back(NEW, 40)
    one = transfer.encode(first_arm(path), robot="source")
    two = transfer.encode(second_arm(path), robot="target")
    assert one.shape == (3, 40, 8)
    assert np.abs(one - two).mean() < 0.1 * one.std(axis=(0, 1)).mean()


def test_points_at_any_time_and_in_any_order_are_interpolated(transfer: SkillTransfer) -> None:
    whole = transfer.translate(SHOWN[0])
    assert whole.shape == (70, 3)
    assert np.abs(whole - transfer.translate(SHOWN)[0]).max() < 1e-5
    order = np.random.default_rng(1).permutation(40)
    mixed = transfer.translate(SHOWN[0][order], times=order / 39)
    np.testing.assert_allclose(mixed, whole, atol=1e-5)
    few = np.arange(0, 40, 3)
    assert np.abs(transfer.translate(SHOWN[0][few], times=few / 39) - whole).max() < 0.15


def test_it_is_saved_and_loaded(transfer: SkillTransfer, tmp_path: Path) -> None:
    transfer.save(tmp_path / "moments")
    loaded = SkillTransfer.load(tmp_path / "moments")
    assert (loaded.shared, loaded.training) == ("moment", QUICK)
    assert np.array_equal(loaded.translate(SHOWN), transfer.translate(SHOWN))


def test_an_older_file_is_of_whole_skills(tmp_path: Path) -> None:
    short = dataclasses.replace(QUICK, n_steps=3)
    model = fitted(shared="skill", training=short)
    model.save(tmp_path / "skills")
    saved = files.read(tmp_path / "skills", FILE_KIND)
    del saved["settings"]["shared"]
    files.write(tmp_path / "older", FILE_KIND, saved)
    older = SkillTransfer.load(tmp_path / "older")
    assert older.shared == "skill"
    assert np.array_equal(older.translate(SHOWN), model.translate(SHOWN))


def test_an_ensemble_is_trained_as_one_and_defaults_are_of_the_kind() -> None:
    short = dataclasses.replace(QUICK, n_steps=3)
    several = dataclasses.replace(SMALL, n_members=3)
    model = fitted(architecture=several, training=short)
    assert model.encode(SHOWN).shape == (3, 40, 3 * 8)
    assert model.translate(SHOWN).shape == (3, 70, 3)
    made = SkillTransfer(SOURCE, TARGET, shared="moment")
    assert made.training == TransferTraining.preset("moment")
    assert made.architecture == CNMPArchitecture.preset("moment")
    usual = SkillTransfer(SOURCE, TARGET)
    assert (usual.shared, usual.training) == ("skill", TransferTraining())
    assert usual.architecture == CNMPArchitecture.preset("latent")


def test_what_does_not_fit_is_refused(transfer: SkillTransfer) -> None:
    with pytest.raises(ConfigurationError, match="shared is 'time'; it must be 'skill' or 'mom"):
        SkillTransfer(SOURCE, TARGET, shared="time")  # type: ignore[arg-type]
    with pytest.raises(InvalidDataError, match=r"\(3, 40, 8\).*target robot's 70 time points"):
        transfer.decode(transfer.encode(SHOWN))


# -- the twin --------------------------------------------------------------------------------------


def test_the_twin_translates_it_too_and_chooses_its_function_by_what_was_left_out() -> None:
    twin = MomentRegression(SOURCE, TARGET).fit()
    assert twin.function is not None and twin.function.is_quadratic
    assert twin.function.penalty <= 1e-2, "nothing is in doubt"
    assert error(twin.translate(SHOWN)) < 0.02
    straight = Demonstrations(ENDS, reaches(ENDS, 40) @ np.array([[1.0, 2.0], [0.5, -1.0]]))
    linear = MomentRegression(straight, Demonstrations(ENDS, reaches(ENDS, 40))).fit()
    assert linear.translate(straight).contexts.tolist() == ENDS.tolist()
    np.testing.assert_allclose(
        linear.translate(straight.trajectories), reaches(ENDS, 40), atol=1e-3
    )
    noise = np.random.default_rng(2).normal(size=(12, 70, 3))
    doubtful = MomentRegression(SOURCE, Demonstrations(ENDS, noise)).fit()
    assert doubtful.function is not None and doubtful.function.penalty == 1.0


def test_the_twin_sees_the_time_where_it_matters() -> None:
    time = np.linspace(0, 1, 40)[:, None]
    later = Demonstrations(ENDS, np.concatenate([reaches(ENDS, 40), np.tile(time, (12, 1, 1))], 2))
    twin = MomentRegression(SOURCE, later).fit()
    assert twin.function is not None and twin.function.sees_time
    assert np.abs(twin.translate(SHOWN[0])[:, 2] - time[:, 0]).max() < 0.02


def test_the_twin_takes_what_fits_alone() -> None:
    twin = MomentRegression(SOURCE, TARGET)
    with pytest.raises(ConfigurationError, match=r"nothing has been fitted; call fit\(\) first"):
        twin.translate(SHOWN)
    with pytest.raises(InvalidDataError, match="have 3 joints; the source robot has 2"):
        twin.fit().translate(WANTED)
    with pytest.raises(InvalidDataError, match="must be finite"):
        twin.translate(np.full((5, 2), np.nan))
    with pytest.raises(InvalidDataError, match="same order"):
        MomentRegression(SOURCE, TARGET[::-1])
