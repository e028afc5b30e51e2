"""Values come back from JSON and arrays as they were, bit for bit."""

import json
import math
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as nps
from safetensors.numpy import load, save
from stable_baselines3.common.utils import LinearSchedule

from sb3_nmp import CNMPArchitecture, SmoothNoise
from sb3_nmp.common.codec import Decoder, Encoder, UnknownKindError
from sb3_nmp.common.contextual import ContextualExploration, ContextualSearch


def there_and_back(value: Any) -> Any:
    encoder = Encoder()
    text = json.dumps(encoder.encode(value, "x"), allow_nan=False)
    return Decoder(load(save(encoder.arrays))).decode(json.loads(text))


plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: (
        st.lists(inner)
        | st.dictionaries(st.text() | st.just(":type:"), inner)
        | st.dictionaries(st.integers() | st.tuples(st.integers()), inner)
        | st.tuples(inner, inner)
        | st.lists(inner).map(lambda items: deque(items, maxlen=7))
    ),
    max_leaves=20,
)


@given(plain)
def test_plain_values_come_back(value: Any) -> None:
    assert repr(there_and_back(value)) == repr(value)


DTYPES = nps.integer_dtypes(endianness="=") | nps.floating_dtypes(endianness="=", sizes=(32, 64))


@given(nps.arrays(DTYPES | nps.boolean_dtypes(), nps.array_shapes(min_dims=0, min_side=0)))
def test_arrays_come_back_bit_for_bit(array: np.ndarray) -> None:
    again = there_and_back([array, array.T, {"a": array}])
    for back, before in zip(
        [again[0], again[1], again[2]["a"]], [array, array.T, array], strict=True
    ):
        assert back.dtype == before.dtype and back.shape == before.shape
        assert back.tobytes() == before.tobytes()
        assert back.flags.c_contiguous == before.flags.c_contiguous
        assert back.flags.writeable


def test_scalars_tensors_sets_paths_and_devices_come_back() -> None:
    for scalar in (np.float32(0.1), np.int64(3), np.bool_(True), np.float64(math.nan)):
        back = there_and_back(scalar)
        assert type(back) is type(scalar) and back.tobytes() == scalar.tobytes()
    tensor = th.arange(6.0).reshape(2, 3).T
    assert th.equal(there_and_back(tensor), tensor)
    for value in ({1, 2}, frozenset({3}), Path("/a/b"), th.device("cpu"), th.nn.ReLU):
        assert there_and_back(value) == value


def test_generators_go_on_where_they_stood() -> None:
    for bits in (np.random.PCG64(3), np.random.MT19937(3), np.random.Philox(3)):
        rng = np.random.Generator(bits)
        rng.standard_normal(3)
        again = there_and_back(rng)
        np.testing.assert_array_equal(again.standard_normal(5), rng.standard_normal(5))
    generator = th.Generator().manual_seed(5)
    th.rand(3, generator=generator)
    again = there_and_back(generator)
    assert th.equal(th.rand(4, generator=again), th.rand(4, generator=generator))


def test_spaces_settings_states_and_schedules_come_back() -> None:
    box = spaces.Box(np.array([-1.0, -np.inf]), np.array([1.0, 2.0]), dtype=np.float64)
    box.seed(3)
    again = there_and_back(box)
    assert again == box and again.dtype == box.dtype
    np.testing.assert_array_equal(again.sample(), box.sample())
    noise = SmoothNoise(sigma=0.3)
    assert there_and_back(noise) == noise
    assert there_and_back(CNMPArchitecture()) == CNMPArchitecture()
    search = ContextualSearch(ContextualExploration(stride=2.0))
    search.shown = (np.ones((1, 2)), np.zeros((1, 3)))
    back = there_and_back(search)
    assert back.exploration == search.exploration and back.shown[0].tolist() == [[1.0, 1.0]]
    schedule = there_and_back(LinearSchedule(1.0, 0.0, 0.5))
    assert schedule(0.75) == 0.5


@dataclass
class Mine:
    value: int = 0


@pytest.mark.parametrize(
    "value",
    [
        Mine(),
        Mine,
        len,
        [lambda x: x],
        {"a": object()},
        np.array(["text"]),
        np.array([object()]),
        np.array([1 + 2j]),
        th.ones(2, dtype=th.bfloat16),
        np.zeros(2, ">f8"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_has_no_form_in_a_file_is_said(value: Any) -> None:
    with pytest.raises(UnknownKindError):
        Encoder().encode(value, "x")
