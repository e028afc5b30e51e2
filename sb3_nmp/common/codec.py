"""Values as JSON and arrays, and back: what a file says can be read, but never run.

JSON holds numbers, texts, lists and dictionaries; what it does not know, such as a tuple or a
generator, is an object with the name of its kind under `TYPE`. Arrays and tensors are kept apart,
for safetensors. Classes are named by the names that they were registered under
(`sb3_nmp.common.settings`), or are those of ``torch.nn`` and ``torch.optim``. A file cannot name
anything else, so that reading it calls nothing but what stands here and the constructors of
settings.
"""

import math
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path, PosixPath, WindowsPath
from typing import Any, cast

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.utils import ConstantSchedule, FloatSchedule, LinearSchedule

from sb3_nmp.common.exceptions import FileFormatError
from sb3_nmp.common.settings import class_named, is_state, saved_state, stable_name

#: the key under which an object in JSON names its kind
TYPE = ":type:"
GENERATORS = ("MT19937", "PCG64", "PCG64DXSM", "Philox", "SFC64")
TORCH_CLASSES = {"torch.nn": (th.nn, th.nn.Module), "torch.optim": (th.optim, th.optim.Optimizer)}

for _name, _class in {
    "constant-schedule": ConstantSchedule,
    "float-schedule": FloatSchedule,
    "linear-schedule": LinearSchedule,
    "running-mean-std": RunningMeanStd,
}.items():
    saved_state(_name)(_class)


class UnknownKindError(TypeError):
    """A value has no form in a file."""


@dataclass(frozen=True)
class Kind:
    """How values of one type stand in a file.

    :param name: of the kind
    :param parts: of a value, by name: simpler values
    :param make: makes the value from its parts
    """

    name: str
    parts: Callable[[Any], dict[str, Any]]
    make: Callable[..., Any]


def _numpy_generator(bit_generator: str, state: dict[str, Any]) -> np.random.Generator:
    if bit_generator not in GENERATORS:
        raise FileFormatError(f"'{bit_generator}' is none of {', '.join(GENERATORS)}.")
    made = getattr(np.random, bit_generator)()
    made.state = state
    return np.random.Generator(made)


def _torch_generator(state: th.Tensor) -> th.Generator:
    return th.Generator().set_state(state)


def _box(
    low: NDArray[Any], high: NDArray[Any], dtype: str, rng: np.random.Generator | None
) -> spaces.Box:
    space = spaces.Box(low, high, dtype=np.dtype(dtype).type)
    space._np_random = cast(np.random.Generator, rng)  # None before it is seeded
    return space


def _path(path: str) -> Path:
    return Path(path)


def _items(value: Any) -> dict[str, Any]:  # noqa: ANN401
    return {"items": list(value)}


_PATH = Kind("path", lambda path: {"path": str(path)}, _path)
_KINDS: dict[type, Kind] = {
    tuple: Kind("tuple", _items, lambda items: tuple(items)),
    set: Kind("set", _items, lambda items: set(items)),
    frozenset: Kind("frozenset", _items, lambda items: frozenset(items)),
    deque: Kind("deque", lambda q: {**_items(q), "maxlen": q.maxlen}, lambda **parts: deque(
        parts["items"], parts["maxlen"]
    )),
    np.random.Generator: Kind(
        "generator",
        lambda rng: {
            "bit_generator": type(rng.bit_generator).__name__,
            "state": rng.bit_generator.state,
        },
        _numpy_generator,
    ),
    th.Generator: Kind("torch-generator", lambda rng: {"state": rng.get_state()}, _torch_generator),
    spaces.Box: Kind(
        "box",
        lambda box: {
            "low": box.low,
            "high": box.high,
            "dtype": box.dtype.str,
            "rng": box._np_random,
        },
        _box,
    ),
    th.device: Kind("device", lambda device: {"name": str(device)}, lambda name: th.device(name)),
    PosixPath: _PATH,
    WindowsPath: _PATH,
}  # fmt: skip
_BY_NAME = {kind.name: kind for kind in _KINDS.values()}


class Encoder:
    """Turns values into JSON, and collects their arrays by the place where they stand."""

    def __init__(self) -> None:
        self.arrays: dict[str, NDArray[Any]] = {}

    def encode(self, value: Any, at: str) -> Any:  # noqa: ANN401
        """Return a value as JSON.

        :param value: what is to be saved
        :param at: where it stands: the names of what holds it, joined by dots
        :raises UnknownKindError: it, or a part of it, has no form in a file
        """
        cls = type(value)
        if value is None or cls in (bool, int, str) or (cls is float and math.isfinite(value)):
            return value
        if cls is float:
            return {TYPE: "float", "value": str(value)}
        if cls is list:
            return [self.encode(each, f"{at}.{i}") for i, each in enumerate(value)]
        if cls in (dict, OrderedDict):
            return self._dictionary(value, at)
        if cls is np.ndarray or issubclass(cls, np.generic) or cls in (th.Tensor, th.nn.Parameter):
            return self._array(value, at)
        if isinstance(value, type):
            return {TYPE: "class", "name": _class_name(value)}
        if cls in _KINDS:
            parts = _KINDS[cls].parts(value)
            return {TYPE: _KINDS[cls].name} | self._parts(parts, at)
        return self._object(value, at)

    def _parts(self, parts: dict[str, Any], at: str) -> dict[str, Any]:
        return {name: self.encode(part, f"{at}.{name}") for name, part in parts.items()}

    def _dictionary(self, value: dict[Any, Any], at: str) -> Any:  # noqa: ANN401
        if all(type(key) is str for key in value) and TYPE not in value:
            return self._parts(value, at)
        return {TYPE: "dict", "items": self.encode([list(item) for item in value.items()], at)}

    def _array(self, value: Any, at: str) -> dict[str, Any]:  # noqa: ANN401
        """Keep an array under its place; Fortran's order is kept, since sums depend on it."""
        is_tensor = isinstance(value, th.Tensor)
        if is_tensor and (value.dtype == th.bfloat16 or value.is_sparse or value.is_quantized):
            raise UnknownKindError(f"a tensor of {value.dtype}")
        array = value.detach().cpu().numpy() if is_tensor else np.asarray(value)
        if array.dtype.kind not in "biuf" or array.dtype.itemsize > 8 or not array.dtype.isnative:
            raise UnknownKindError(f"an array of {array.dtype}")
        kind = "tensor" if is_tensor else "array" if type(value) is np.ndarray else "scalar"
        fortran = kind == "array" and array.flags.fnc
        key = at if at not in self.arrays else f"{at}#{len(self.arrays)}"
        self.arrays[key] = np.array(array.T if fortran else array, order="C")
        return {TYPE: kind, "key": key} | ({"fortran": True} if fortran else {})

    def _object(self, value: Any, at: str) -> dict[str, Any]:  # noqa: ANN401
        """Return an object of a registered class by its fields or its state."""
        cls = type(value)
        if is_state(cls):
            state = value.__getstate__() or {}
        elif is_dataclass(cls):
            state = {each.name: getattr(value, each.name) for each in fields(cls) if each.init}
        else:
            raise UnknownKindError(f"a {cls.__qualname__}")
        return {TYPE: "object", "name": _class_name(cls), "parts": self._parts(state, at)}


class Decoder:
    """Turns JSON and arrays into values.

    :param arrays: by their keys
    """

    def __init__(self, arrays: dict[str, NDArray[Any]]) -> None:
        self.arrays = arrays

    def decode(self, value: Any) -> Any:  # noqa: ANN401
        """Return the value that JSON stands for.

        :param value: what `Encoder.encode` returned
        :raises FileFormatError: it names a class or a kind that is not known
        """
        if isinstance(value, list):
            return [self.decode(each) for each in value]
        if not isinstance(value, dict):
            return value
        if TYPE not in value:
            return {name: self.decode(part) for name, part in value.items()}
        parts, kind = dict(value), value[TYPE]
        del parts[TYPE]
        if kind in ("array", "scalar", "tensor"):
            return self._array(kind, **parts)
        if kind == "float":
            return float(parts["value"])
        if kind == "class":
            return _find_class(parts["name"])
        if kind == "object":
            return _make_object(_find_class(parts["name"]), self.decode(parts["parts"]))
        if kind == "dict":
            return dict(self.decode(parts["items"]))
        if kind not in _BY_NAME:
            raise FileFormatError(f"the kind '{kind}' is not known.")
        return _BY_NAME[kind].make(**{name: self.decode(part) for name, part in parts.items()})

    def _array(self, kind: str, key: str, fortran: bool = False) -> Any:  # noqa: ANN401
        array = self.arrays[key].copy()
        if kind == "tensor":
            return th.from_numpy(array)
        if kind == "scalar":
            return array[()]
        return array.T if fortran else array


def _class_name(cls: type) -> str:
    """Return the name of a class in files.

    :raises UnknownKindError: it has none
    """
    for prefix, (module, base) in TORCH_CLASSES.items():
        if getattr(module, cls.__name__, None) is cls and issubclass(cls, base):
            return f"{prefix}.{cls.__name__}"
    try:
        return stable_name(cls)
    except ValueError as error:
        raise UnknownKindError(f"the class {cls.__qualname__}") from error


def _find_class(name: str) -> type:
    """Return the class of a name.

    :raises FileFormatError: no class of that name may stand in files
    """
    prefix, _, last = name.rpartition(".")
    if prefix in TORCH_CLASSES:
        module, base = TORCH_CLASSES[prefix]
        found = module.__dict__.get(last)
        if isinstance(found, type) and issubclass(found, base):
            return found
    found = class_named(name)
    if found is None:
        raise FileFormatError(
            f"it names the class '{name}', which is none of those that may stand in files: it was "
            "written by another version, or by someone else. A class of your own is found once its "
            "module is imported, where @settings_name or @saved_state stands above it."
        )
    return found


def _make_object(cls: type, parts: dict[str, Any]) -> Any:  # noqa: ANN401
    """Return an object of a registered class."""
    if not is_state(cls):
        if not is_dataclass(cls):
            raise FileFormatError(f"objects of {cls.__qualname__} do not stand in files.")
        return cls(**parts)
    made = object.__new__(cls)
    if hasattr(cls, "__setstate__"):
        made.__setstate__(parts)
    else:
        made.__dict__.update(parts)
    return made
