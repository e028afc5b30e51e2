"""No file runs code: foreign pickles, forged files of our own, and all that may hold either."""

import base64
import io
import json
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from baselines import GA, REPS
from baselines.ga.policies import GAPolicy
from results.cli import USAGE_ERROR, main
from sb3_nmp import (
    ConfigurationError,
    Demonstrations,
    FileFormatError,
    PickleWarning,
    UnsafeFileError,
    load_vec_normalize,
    save_vec_normalize,
)
from sb3_nmp.common import files
from sb3_nmp.common.buffer import TrajectoryBuffer
from tests.registry import ALGORITHMS, DEMONSTRATIONS, ENV_ID, POPULATION


class Trap:
    """Runs code when it is unpickled: it makes a file, whose existence tells."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[Any, ...]:
        return exec, (f"open({str(self.marker)!r}, 'w').close()",)


class Place:
    """A folder with a good model, and what is forged from it.

    :param folder: of the test
    :param good: file of a model of `GA`
    """

    def __init__(self, folder: Path, good: Path) -> None:
        self.folder, self.good = folder, good
        self.marker = folder / "sprung"
        self.trap = Trap(self.marker)
        self.forged = folder / "forged.zip"

    def foreign(self, data: dict[str, Any], **members: bytes) -> Path:
        """Write a zip in SB3's format."""
        held = {"data": json.dumps(data).encode()} | members
        with zipfile.ZipFile(self.forged, "w") as archive:
            for name, content in held.items():
                archive.writestr(name, content)
        return self.forged

    def changed(self, change: Callable[[dict[str, Any]], None], **members: bytes) -> Path:
        """Write the good model with changes in its JSON, and other or further members."""
        with zipfile.ZipFile(self.good) as archive:
            held = {name: archive.read(name) for name in archive.namelist()}
        content = json.loads(held[files.CONTENT])
        change(content)
        held[files.CONTENT] = json.dumps(content).encode()
        held |= {name.replace("_DOT_", "."): value for name, value in members.items()}
        with zipfile.ZipFile(self.forged, "w") as archive:
            for name, value in held.items():
                archive.writestr(name, value)
        return self.forged

    def attribute(self, value: Any) -> Path:
        """Write the good model with another value in the place of an attribute."""
        return self.changed(lambda content: content["parts"]["data"].update(verbose=value))

    def raw(self, content: bytes) -> Path:
        self.forged.write_bytes(content)
        return self.forged

    def saved(self, save: Callable[[Path], Any]) -> Path:
        save(self.forged)
        return self.forged


def the_env() -> DummyVecEnv:
    return DummyVecEnv([lambda: Monitor(gym.make(ENV_ID))])


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("good") / "model.zip"
    GA("MlpPolicy", ENV_ID, population_size=8, n_crossover=4, seed=0).learn(8).save(path)
    return path


@pytest.fixture
def place(tmp_path: Path, good: Path) -> Place:
    return Place(tmp_path, good)


def pickled(value: Any) -> str:
    return base64.b64encode(pickle.dumps(value)).decode()


def torch_saved(value: Any) -> bytes:
    buffer = io.BytesIO()
    th.save(value, buffer)
    return buffer.getvalue()


def objects(path: Path, value: Any) -> None:
    """Write an .npz all of whose arrays hold a Python object."""
    array = np.empty(1, object)
    array[0] = value
    keys = ("contexts", "trajectories", "rewards", "successes", "achieved")
    with path.open("wb") as file:
        np.savez(file, **dict.fromkeys(keys, array))


def npy(path: Path, value: Any) -> None:
    array = np.empty(1, object)
    array[0] = value
    with path.open("wb") as file:
        np.save(file, array, allow_pickle=True)


def foreign_model(place: Place) -> Path:
    model = GA.load(place.good)
    model.extra = place.trap  # type: ignore[attr-defined]
    BaseAlgorithm.save(model, place.forged)
    return place.forged


def foreign_policy(place: Place) -> Path:
    policy = GA.load(place.good).policy
    policy.settings["trap"] = place.trap  # type: ignore[index]
    BasePolicy.save(policy, str(place.forged))
    return place.forged


def normalised(place: Place) -> Path:
    env = VecNormalize(the_env(), norm_obs=False)
    env.trap = place.trap  # type: ignore[attr-defined]
    env.save(str(place.forged))
    return place.forged


def with_own_pickle(place: Place, group: str) -> Path:
    held = {group: {"trap": pickled(place.trap)}}
    return place.changed(lambda content: content["pickled"].update(held))


def named(place: Place, kind: str, name: str, **parts: Any) -> Path:
    """Forge a model whose JSON names a class or a generator that is none."""
    return place.attribute({":type:": kind, "name": name} | parts)


def own_file(place: Place, kind: str) -> Path:
    with pytest.warns(PickleWarning):
        files.write(place.forged, kind, {"settings": {"trap": place.trap}})
    return place.forged


def module_that_traps(place: Place, monkeypatch: pytest.MonkeyPatch) -> Path:
    (place.folder / "trap_module.py").write_text(f"open({str(place.marker)!r}, 'w').close()\n")
    monkeypatch.syspath_prepend(str(place.folder))
    env = {"env": "trap_module:Trap-v0"}
    return place.changed(lambda content: content["parts"]["data"].update(env))


def buffer_of() -> TrajectoryBuffer:
    return TrajectoryBuffer(1, (5, 2))


def render(path: Path) -> None:
    arguments = ["render", ENV_ID, "--model", str(path), "--algorithm", "ga", "--out", "x.png"]
    if main(arguments) != USAGE_ERROR:
        raise AssertionError("render did not refuse the model")
    raise FileFormatError("as the command line said")


MODEL, POLICY = GA.load, GAPolicy.load
BUFFER, SHOWN = (lambda path: buffer_of().load(path)), Demonstrations.load
NORMALISED = lambda path: load_vec_normalize(path, the_env())  # noqa: E731
PARAMETERS = lambda path: GA("MlpPolicy", ENV_ID).set_parameters(path)  # noqa: E731

FORGED: dict[str, tuple[Callable[[Place], Path], Callable[[Path], Any]]] = {
    "SB3's zip, an attribute pickled": (foreign_model, MODEL),
    "SB3's zip, its parameters pickled": (
        lambda p: p.foreign({}, **{"policy.pth": torch_saved(p.trap)}),
        MODEL,
    ),
    "SB3's zip given to set_parameters": (
        lambda p: p.foreign({}, **{"policy.pth": torch_saved(p.trap)}),
        PARAMETERS,
    ),
    "SB3's zip, further variables pickled": (
        lambda p: p.foreign({}, **{"pytorch_variables.pth": torch_saved(p.trap)}),
        PARAMETERS,
    ),
    "a pickle called a model": (lambda p: p.raw(pickle.dumps(p.trap)), MODEL),
    "a file of torch.save called a model": (lambda p: p.raw(torch_saved(p.trap)), MODEL),
    "our zip, an attribute pickled": (lambda p: with_own_pickle(p, "data"), MODEL),
    "our zip, its parameters pickled": (lambda p: with_own_pickle(p, "parameters"), MODEL),
    "our zip given to set_parameters": (lambda p: with_own_pickle(p, "parameters"), PARAMETERS),
    "our zip, SB3's pickles beside": (
        lambda p: p.changed(lambda _: None, policy_DOT_pth=torch_saved(p.trap)),
        MODEL,
    ),
    "our zip, tensors pickled": (
        lambda p: p.changed(lambda _: None, tensors_DOT_safetensors=pickle.dumps(p.trap)),
        MODEL,
    ),
    "our zip, the content pickled": (
        lambda p: p.changed(lambda _: None, sb3_nmp_DOT_json=pickle.dumps(p.trap)),
        MODEL,
    ),
    "a policy of torch.save": (foreign_policy, POLICY),
    "a policy of ours, pickled in part": (lambda p: own_file(p, "policy"), POLICY),
    "a buffer with objects": (lambda p: p.saved(lambda f: objects(f, p.trap)), BUFFER),
    "a buffer that is a pickle": (lambda p: p.raw(pickle.dumps(p.trap)), BUFFER),
    "a buffer that is an array of objects": (lambda p: p.saved(lambda f: npy(f, p.trap)), BUFFER),
    "demonstrations with objects": (lambda p: p.saved(lambda f: objects(f, p.trap)), SHOWN),
    "demonstrations that are a pickle": (lambda p: p.raw(pickle.dumps(p.trap)), SHOWN),
    "demonstrations as array of objects": (lambda p: p.saved(lambda f: npy(f, p.trap)), SHOWN),
    "SB3's VecNormalize": (normalised, NORMALISED),
    "our VecNormalize, pickled in part": (lambda p: own_file(p, "normalization"), NORMALISED),
    "nmp-bench render --model": (foreign_model, render),
}


@pytest.mark.parametrize("case", FORGED)
def test_a_file_with_a_trap_is_refused_and_nothing_of_it_runs(case: str, place: Place) -> None:
    make, read = FORGED[case]
    path = make(place)
    assert not place.marker.exists()
    with pytest.raises(FileFormatError) as refused:
        read(path)
    assert not place.marker.exists()
    assert len(str(refused.value)) < 700


@pytest.mark.parametrize(
    ("kind", "name", "parts"),
    [
        ("class", "os.system", {}),
        ("class", "builtins.exec", {}),
        ("class", "torch.nn.functional", {}),
        ("class", "torch.optim.lr_scheduler.LambdaLR", {}),
        ("class", "torch.nn.modules.module.Module", {}),
        ("object", "subprocess.Popen", {"parts": {"args": ["true"]}}),
        ("object", "torch.nn.Linear", {"parts": {"in_features": 1, "out_features": 1}}),
        ("object", "smooth-noise", {"parts": {"command": "true"}}),
        ("function", "exec", {}),
        ("generator", "x", {"bit_generator": "test", "state": {}}),
        ("path", "x", {"path": ["/"]}),
    ],
)
def test_a_file_can_name_no_class_but_those_that_are_registered(
    kind: str, name: str, parts: dict[str, Any], place: Place
) -> None:
    with pytest.raises(FileFormatError, match="cannot be read"):
        GA.load(named(place, kind, name, **parts))


def test_an_environment_is_never_taken_from_a_file(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Gymnasium imports the module that an id such as 'module:Env-v0' names."""
    path = module_that_traps(place, monkeypatch)
    with pytest.raises(FileFormatError, match="names an environment"):
        GA.load(path)
    assert not place.marker.exists()
    with pytest.raises(ConfigurationError, match="env cannot be saved"):
        GA.load(place.good).save(place.forged, include=["env"])
    __import__("trap_module")
    assert place.marker.exists()  # the trap works


@pytest.mark.parametrize("make", [foreign_model, lambda p: with_own_pickle(p, "data")])
def test_the_traps_work_where_the_user_allows_pickles(
    make: Callable[[Place], Path], place: Place
) -> None:
    path = make(place)
    GA.load(path, allow_pickle=True)
    assert place.marker.exists()


def test_other_traps_work_for_those_who_read_them_as_pickles(place: Place) -> None:
    load_vec_normalize(normalised(place), the_env(), allow_pickle=True)
    assert place.marker.exists()
    place.marker.unlink()
    objects(place.forged, place.trap)
    with np.load(place.forged, allow_pickle=True) as file:
        assert file["contexts"].shape == (1,)
    assert place.marker.exists()


# -- what is in our files --------------------------------------------------------------------------


@pytest.mark.parametrize("varied", [False, True])
@pytest.mark.parametrize("algorithm", ALGORITHMS, ids=lambda cls: cls.__name__)
def test_no_file_of_any_algorithm_needs_a_pickle(
    algorithm: type, varied: bool, tmp_path: Path
) -> None:
    env = gym.make(ENV_ID, random_bottles=True) if varied else gym.make(ENV_ID)
    model = algorithm("MlpPolicy", env, seed=0, **ALGORITHMS[algorithm])
    model.learn(POPULATION + 3)  # in the middle of a generation
    model.save(tmp_path / "model")
    model.policy.save(tmp_path / "policy")
    for name in ("model.zip", "policy"):
        with zipfile.ZipFile(tmp_path / name) as archive:
            assert set(archive.namelist()) == {files.CONTENT, files.TENSORS}
            content = archive.read(files.CONTENT)
            assert json.loads(content)["pickled"] == {}
            json.loads(content, parse_constant=lambda constant: pytest.fail(constant))
            assert archive.testzip() is None


def test_files_of_sb3s_format_load_where_the_user_says_so(place: Place) -> None:
    model = GA.load(place.good)
    BaseAlgorithm.save(model, place.forged)
    with pytest.raises(UnsafeFileError, match=r"format of Stable-Baselines3 .*allow_pickle=True"):
        GA.load(place.forged)
    old = GA.load(place.forged, allow_pickle=True)
    context = gym.make(ENV_ID).reset(seed=0)[0]
    np.testing.assert_array_equal(
        old.predict(context, deterministic=True)[0], model.predict(context, deterministic=True)[0]
    )
    old.save(place.forged)
    assert GA.load(place.forged).num_timesteps == 8
    model.set_parameters(place.forged)
    BasePolicy.save(model.policy, str(place.folder / "policy"))
    with pytest.raises(UnsafeFileError):
        type(model.policy).load(place.folder / "policy")
    type(model.policy).load(place.folder / "policy", allow_pickle=True)


def test_what_must_be_pickled_is_said_when_it_is_saved_and_can_be_replaced(place: Place) -> None:
    def falling(progress: float) -> float:
        return 1e-3 * progress

    model = REPS("MlpPolicy", ENV_ID, learning_rate=falling, seed=0)
    with pytest.warns(PickleWarning, match="'learning_rate' holds a function"):
        model.save(place.forged)
    with pytest.raises(UnsafeFileError, match=r"'learning_rate' as a pickle.*custom_objects="):
        REPS.load(place.forged)
    loaded: Any = REPS.load(place.forged, allow_pickle=True)
    assert loaded.learning_rate(0.5) == 5e-4
    replaced = REPS.load(place.forged, custom_objects={"learning_rate": 0.1})
    assert replaced.learning_rate == 0.1
    model.set_parameters(place.forged)  # which holds no pickle


def test_a_model_of_another_algorithm_names_it(place: Place) -> None:
    with pytest.raises(FileFormatError, match=r"a model of GA, not of REPS: load it with GA\.load"):
        REPS.load(place.good)

    class Mine(GA):
        pass

    assert Mine.load(place.good).num_timesteps == 8


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 0.999])
def test_a_file_that_was_cut_short_is_named(share: float, place: Place) -> None:
    content = place.good.read_bytes()
    place.forged.write_bytes(content[: int(share * len(content))])
    with pytest.raises(FileFormatError, match=r"forged\.zip.*damaged"):
        GA.load(place.forged)


def test_a_file_of_another_version_or_kind_is_told_apart(place: Place) -> None:
    place.changed(lambda content: content.update(version=99))
    with pytest.raises(FileFormatError, match="version 99 of the file format"):
        GA.load(place.forged)
    with pytest.raises(FileFormatError, match="holds a model; a policy is needed"):
        POLICY(place.good)
    place.changed(lambda content: content["parts"]["data"].pop("action_space"))
    with pytest.raises(FileFormatError, match="lacks action_space"):
        GA.load(place.forged)
    place.changed(lambda content: content["parts"]["data"].update(policy_class="CnnPolicy"))
    with pytest.raises(FileFormatError, match="policy in the file is 'CnnPolicy'"):
        GA.load(place.forged)
    for name in ("missing", "missing.zip"):
        with pytest.raises(FileNotFoundError, match=r"missing\.zip'$"):
            GA.load(place.folder / name)


# -- as SB3 saves and loads -----------------------------------------------------------------------


def test_open_files_folders_and_system_information(
    place: Place, capsys: pytest.CaptureFixture[str]
) -> None:
    model, buffer = GA.load(place.good), io.BytesIO()
    model.save(buffer)
    buffer.seek(0)
    assert [GA.load(buffer).num_timesteps for _ in range(2)] == [8, 8]
    model.set_parameters(buffer)
    model.save(place.folder / "new" / "folder" / "model")
    loaded = GA.load(place.folder / "new" / "folder" / "model", print_system_info=True)
    assert loaded.num_timesteps == 8
    printed = capsys.readouterr().out
    assert "SAVED MODEL SYSTEM INFO" in printed and printed.count("Stable-Baselines3") == 2


def test_attributes_are_left_out_and_included(place: Place) -> None:
    model = GA("MlpPolicy", ENV_ID, population_size=8, n_crossover=4, verbose=2, seed=0)
    model.save(place.forged, exclude=["verbose"])
    assert GA.load(place.forged).verbose == 0
    model.save(place.forged, exclude=["verbose"], include=["verbose", "demonstrations"])
    assert GA.load(place.forged).verbose == 2
    shown = GA("MlpPolicy", ENV_ID, demonstrations=DEMONSTRATIONS)
    shown.save(place.forged, include=["demonstrations"])
    assert GA.load(place.forged).demonstrations == DEMONSTRATIONS


def test_a_failed_write_leaves_the_old_file(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    before = place.good.read_bytes()
    monkeypatch.setattr(files, "write_tensors", lambda arrays: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        GA.load(place.good).save(place.good)
    assert place.good.read_bytes() == before
    assert [each.name for each in place.good.parent.iterdir()] == ["model.zip"]


def test_policy_kwargs_must_be_those_of_the_file(place: Place) -> None:
    with pytest.raises(ConfigurationError, match="policy_kwargs is"):
        GA.load(place.good, policy_kwargs={"regression": "ridge"})


def test_vec_normalize_is_read_as_it_was_written(place: Place) -> None:
    env = VecNormalize(the_env(), norm_obs=False, clip_reward=3.0)
    env.reset()
    for _ in range(3):
        env.step(np.zeros((1, *env.action_space.shape), np.float32))  # type: ignore[misc]
    save_vec_normalize(env, place.forged)
    read = load_vec_normalize(place.forged, the_env())
    assert read.clip_reward == 3.0 and not read.norm_obs
    assert read.ret_rms.count == env.ret_rms.count > 3
    assert read.ret_rms.var == env.ret_rms.var
    rewards = np.array([-0.3])
    np.testing.assert_array_equal(read.normalize_reward(rewards), env.normalize_reward(rewards))
