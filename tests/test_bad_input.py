"""Bad input of some hundred kinds: each message names the value, the rule, and a way out."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from baselines import CMAES, DREPS, GA, REPS, StarkProMPRL
from benchmark_envs import (
    TrajectoryActionWrapper,
    TrajectoryEnv,
    TrajectoryVecEnv,
    fetch_env,
    leave_one_out,
    make_task,
)
from sb3_nmp import ACNMP, RCNMP, ACNMPAdaptation, CNMPPretraining, Demonstrations, SmoothNoise
from sb3_nmp.common.buffer import TrajectoryBuffer
from tests.registry import DEMONSTRATIONS, ENV_ID
from tests.test_environment_faces import Plain

NAN, INF = float("nan"), float("inf")
Call = Callable[[Path], object]


def plain(**attributes: Any) -> Any:
    """An environment with other spaces."""
    return type("Other", (Plain,), attributes)()


class Endless(Plain):
    def step(self, action: Any) -> Any:
        return self.context, 0.0, False, False, {}


class Deaf(Plain):
    """Ignores the option ``context``."""


def made(
    algorithm: Any = REPS, env: Any = None, policy: str = "MlpPolicy", **arguments: Any
) -> Any:
    return algorithm(policy, Plain() if env is None else env, **arguments)


def of_bottles(algorithm: Any, **arguments: Any) -> Any:
    return algorithm("MlpPolicy", ENV_ID, **arguments)


def stepped(env: Any, trajectory: Any) -> object:
    env.reset(seed=0)
    return env.step(trajectory)


def saved(folder: Path, algorithm: Any = REPS, **arguments: Any) -> Path:
    made(algorithm, **arguments).save(folder / "model.zip")
    return folder / "model.zip"


def written(folder: Path, name: str, content: bytes) -> Path:
    (folder / name).write_bytes(content)
    return folder / name


def arrays(folder: Path, **named: Any) -> Path:
    np.savez(folder / "arrays.npz", **named)
    return folder / "arrays.npz"


def shown(contexts: Any, trajectories: Any) -> Demonstrations:
    return Demonstrations(contexts, trajectories)


def buffer() -> TrajectoryBuffer:
    return TrajectoryBuffer(1, (5, 2))


def task_env(**settings: Any) -> TrajectoryEnv:
    return TrajectoryEnv(ENV_ID, n_threads=1, **settings)


def wrapped(**arguments: Any) -> TrajectoryActionWrapper:
    """A pendulum as a trajectory bandit."""
    return TrajectoryActionWrapper(gym.make("Pendulum-v1"), **arguments)


def from_csv(folder: Path, text: str) -> Demonstrations:
    return Demonstrations.from_csv(written(folder, "x.csv", text.encode()))


SHOWN = Demonstrations(np.zeros((2, 1)), np.zeros((2, 5, 2)))
TRAJECTORY = np.zeros((200, 2))
#: by kind: what is done, and parts of the message
BAD: dict[str, tuple[Call, tuple[str, ...]]] = {
    # environments and spaces
    "an unknown id": (lambda _: made(env="nmp/Pusch-v0"), ("'nmp/Pusch-v0'", "nmp/Push-v0")),
    "discrete actions": (lambda _: made(env="CartPole-v1"), ("Discrete(2)", "(T, D)", "Box")),
    "actions of a step": (lambda _: made(env="Pendulum-v1"), ("(1,)", "(T, D)", "time points")),
    "unbounded actions": (
        lambda _: made(env=plain(action_space=spaces.Box(-np.inf, np.inf, (5, 2)))),
        ("action space is Box(-inf", "no bounds", "finite low and high"),
    ),
    "unbounded contexts": (
        lambda _: made(RCNMP, plain(observation_space=spaces.Box(-np.inf, np.inf, (1,)))),
        ("observation space is Box(-inf", "no bounds", "wrap the environment"),
    ),
    "contexts in a dictionary": (
        lambda _: made(env=plain(observation_space=spaces.Dict({"a": spaces.Box(0, 1, (1,))}))),
        ("Dict(", "a Box of shape (C,)"),
    ),
    "contexts as pictures": (
        lambda _: made(env=plain(observation_space=spaces.Box(0.0, 1.0, (3, 4)))),
        ("(3, 4)", "shape (C,)"),
    ),
    "an endless episode": (
        lambda _: made(env=Endless()).learn(20), ("went on", "ends the episode"),
    ),
    "a deaf environment": (
        lambda _: made(StarkProMPRL, Deaf(), demonstrations=SHOWN).learn(40),
        ("asked the environments", "options={'context': c}"),
    ),
    "normalised contexts": (
        lambda _: made(GA, VecNormalize(DummyVecEnv([Plain]))),
        ("norm_obs=True", "VecNormalize(env, norm_obs=False)"),
    ),
    # arguments
    "an unknown argument": (lambda _: made(epsilom=1.0), ("'epsilom'", "did you mean 'epsilon'")),
    "an unknown policy": (
        lambda _: made(policy="CnnPolicy"), ("REPS", "'CnnPolicy'", "it has MlpPolicy"),
    ),
    "SB3's net_arch": (
        lambda _: made(RCNMP, policy_kwargs={"net_arch": [64]}),
        ("RCNMPPolicy", "'net_arch'", "encoder_arch"),
    ),
    "SB3's optimizer_class": (
        lambda _: made(RCNMP, policy_kwargs={"optimizer_class": dict}),
        ("'optimizer_class'", "decoder_arch"),
    ),
    "a text in policy_kwargs": (
        lambda _: made(RCNMP, policy_kwargs={"latent_dim": "4"}),
        ("latent_dim is '4'", "a whole number"),
    ),
    "a number for noise": (
        lambda _: made(RCNMP, mutation=0.1), ("mutation is 0.1", "SmoothNoise or None"),
    ),
    "a dictionary for settings": (
        lambda _: made(RCNMP, training={}), ("training is {}", "a RCNMPTraining"),
    ),
    "a text for a number": (
        lambda _: made(population_size="20"), ("population_size is '20'", "a whole number"),
    ),
    "half a rollout": (lambda _: made(population_size=2.5), ("is 2.5", "a whole number")),
    "one rollout compared with itself": (
        lambda _: made(ACNMP, demonstrations=SHOWN, adaptation=ACNMPAdaptation.preset("to_go")),
        ("advantage='to_go'", "of advantage 'place' where the population_size is 1"),
    ),
    "no rollouts": (lambda _: made(population_size=0), ("population_size is 0", ">= 2")),
    "a population that does not fit": (
        lambda _: made(env=DummyVecEnv([Plain] * 3), population_size=4),
        ("population of 4", "multiple of 3", "Change it or n_envs"),
    ),
    "an odd crossover": (lambda _: made(GA, n_crossover=3), ("n_crossover is 3", "even")),
    "a learning rate of nan": (
        lambda _: made(RCNMP, learning_rate=NAN), ("learning_rate is nan", "finite and >= 0"),
    ),
    "a learning rate below 0": (lambda _: made(RCNMP, learning_rate=-1.0), ("is -1.0", ">= 0")),
    "a text for a learning rate": (
        lambda _: made(learning_rate="fast"), ("is 'fast'", "a number or a function (a schedule)"),
    ),
    "a seed below 0": (lambda _: made(seed=-1), ("seed is -1", "in [0, 4294967295]", "None")),
    "a seed too large": (lambda _: made(seed=2**33), ("seed is 8589934592", "or None")),
    "a text for a seed": (lambda _: made(seed="0"), ("seed is '0'", "a whole number or None")),
    "a scale of nan": (lambda _: made(exploration_scale=NAN), ("is nan", "a tuple of 2")),
    "a scale below 0": (lambda _: made(exploration_scale=-0.1), ("is -0.1", "finite number > 0")),
    "a scale of three": (
        lambda _: made(exploration_scale=(1.0, 1.0, 1.0)), ("(1.0, 1.0, 1.0)", "a tuple of 2"),
    ),
    "a search that is none": (
        lambda _: made(ACNMP, demonstrations=SHOWN, search="best"),
        ("search is 'best'", "'critic' or 'policy'"),
    ),
    "a primitive that is none": (
        lambda _: made(primitive="spline"), ("primitive is 'spline'", "'promp' or 'dmp'"),
    ),
    "a scaling that is none": (
        lambda _: made(RCNMP, reward_scaling="log"), ("reward_scaling is 'log'", "'rank'"),
    ),
    "thresholds reversed": (
        lambda _: made(StarkProMPRL, demonstrations=SHOWN, reward_threshold=(-0.1, -0.2)),
        ("(-0.1, -0.2)", "begin <= end"),
    ),
    "a bound below 0": (lambda _: made(epsilon=-1.0), ("epsilon is -1.0", "it must be")),
    "a temperature of 0": (lambda _: made(GA, temperature=0.0), ("is 0.0", "> 0", "math.inf")),
    "a mutation rate of 0": (lambda _: made(GA, mutation_rate=0.0), ("is 0.0", "in (0, 1]")),
    "a decay of nan": (lambda _: made(GA, mutation_decay=NAN), ("is nan", "in (0, 1]")),
    "no candidates": (lambda _: made(GA, n_candidates=0), ("n_candidates is 0", ">= 1")),
    "more modes than members": (lambda _: made(GA, n_modes=50), ("n_modes is 50", "at most half")),
    "a buffer below its elites": (
        lambda _: made(GA, buffer_size=1, n_elites=3), ("buffer of 1", "3 elites", "None or at"),
    ),
    "beta below 0": (lambda _: made(RCNMP, beta=-1.0), ("beta is -1.0", ">= 0")),
    "xi of infinity": (lambda _: made(DREPS, xi=INF), ("xi is inf", "finite and >= 0")),
    "two samples for CMA-ES": (
        lambda _: made(CMAES, population_size=2), ("population_size is 2", ">= 3"),
    ),
    "shaped without demonstrations": (
        lambda _: made(CMAES, shaped=0.5), ("shaped is 0.5", "Give demonstrations=, or 0"),
    ),
    "no environment": (
        lambda _: REPS("MlpPolicy", None),  # type: ignore[arg-type]
        ("env is None", "an environment of Gymnasium", "'nmp/Bottles-v0'"),
    ),
    "a number as environment": (lambda _: made(env=5), ("env is 5", "not its class or a list")),
    "environments in a list": (lambda _: made(env=[Plain()]), ("env is [", "a VecEnv of SB3")),
    "an environment's class": (lambda _: made(env=Plain), ("env is <class", "not its class")),
    "a device that is none": (
        lambda _: made(device="foo"), ("device is 'foo'", "'cpu'", "'auto'"),
    ),
    "three thresholds": (
        lambda _: made(ACNMP, demonstrations=SHOWN, reward_threshold=(1, 2, 3)),
        ("reward_threshold is (1, 2, 3)", "a number or a tuple of 2 numbers or None"),
    ),
    "policy_kwargs as a list": (
        lambda _: made(policy_kwargs=[1]), ("policy_kwargs is [1]", "a dictionary or None"),
    ),
    "policy_kwargs as a text": (
        lambda _: made(policy_kwargs="big"), ("policy_kwargs is 'big'", "a dictionary or None"),
    ),
    "a latent below 1": (
        lambda _: made(RCNMP, policy_kwargs={"latent_dim": -4}), ("latent_dim is -4", ">= 1"),
    ),
    "a layer of no width": (
        lambda _: made(RCNMP, policy_kwargs={"encoder_arch": (64, 0)}),
        ("encoder_arch is [64, 0]", "width >= 1"),
    ),
    "steps as a text": (
        lambda _: CNMPPretraining(n_steps="many"),  # type: ignore[arg-type]
        ("n_steps is 'many'", "a whole number >= 0"),
    ),
    "noise as a text": (
        lambda _: SmoothNoise(sigma="x"),  # type: ignore[arg-type]
        ("sigma is 'x'", "finite and >= 0"),
    ),
    "noise with bases as a text": (
        lambda _: SmoothNoise(n_bases="x"),  # type: ignore[arg-type]
        ("n_bases is 'x'", "a whole number"),
    ),
    "noise without bases": (lambda _: SmoothNoise(n_bases=0), ("n_bases", "0")),
    # demonstrations
    "no demonstrations": (
        lambda _: made(ACNMP), ("ACNMP", "give demonstrations=", "Demonstrations.load"),
    ),
    "a list as demonstrations": (
        lambda _: made(GA, demonstrations=[1]), ("is a list", "Demonstrations(contexts, traj"),
    ),
    "demonstrations of other contexts": (
        lambda _: made(GA, demonstrations=DEMONSTRATIONS), ("4 entries", "contexts of 1"),
    ),
    "demonstrations of another length": (
        lambda _: made(GA, demonstrations=Demonstrations(np.zeros((1, 1)), np.zeros((1, 9, 2)))),
        ("(9, 2)", "(5, 2)", "resample"),
    ),
    "mixed lengths": (
        lambda _: shown([[0.0], [1.0]], [[[0.0], [1.0]], [[0.0], [1.0], [2.0]]]),
        ("mixed shapes", "resample"),
    ),
    "nan in a demonstration": (
        lambda _: shown([[0.0]], [[[NAN], [1.0]]]), ("nan at index", "must be finite"),
    ),
    "an empty set": (
        lambda _: Demonstrations(np.zeros((0, 1)), np.zeros((0, 5, 2))), ("at least one",),
    ),
    "demonstrations as CSV": (
        lambda folder: Demonstrations.load(written(folder, "x.csv", b"0,1\n2,3\n")),
        ("x.csv does not hold", "no .npz file", "from_csv"),
    ),
    "numbers as demonstrations": (lambda _: shown(3, 4), ("have shape ()", "they need (N, T, D)")),
    "half a demonstration": (
        lambda _: Demonstrations.from_task(ENV_ID, 2.5),
        ("contexts is 2.5", "a whole number", "(N, C)"),
    ),
    "time by another name": (
        lambda folder: from_csv(folder, "Time [s],context_x,q\n0,1,2\n"),
        ("x.csv has the column 'Time [s]'", "a column 'time'", "rename it"),
    ),
    "time as t": (
        lambda folder: from_csv(folder, "t,context_x,q\n0,1,2\n"), ("'t'", "a column 'time'"),
    ),
    "semicolons in a CSV": (
        lambda folder: from_csv(folder, "time;context_x;q\n0;1;2\n"),
        ("separated by ';'", "separated by commas"),
    ),
    "no CSV": (
        lambda folder: Demonstrations.from_csv(folder / "none.csv"),
        ("none.csv cannot be read", "No such file", "give the path"),
    ),
    "a folder as CSV": (
        lambda folder: Demonstrations.from_csv(folder), ("cannot be read", "give the path"),
    ),
    "an open CSV": (
        lambda _: Demonstrations.from_csv(io.StringIO("time,q\n")),  # type: ignore[arg-type]
        ("path is a StringIO", "the path of a file"),
    ),
    "an .npz of other arrays": (
        lambda folder: Demonstrations.load(arrays(folder, a=np.zeros(3))),
        ("contexts and trajectories", "arrays.npz"),
    ),
    "a task without an expert": (
        lambda _: Demonstrations.from_task("Pendulum-v1", 2), ("no expert", "demonstrate(context)"),
    ),
    # learning, answering, loading
    "a budget of nan": (lambda _: made().learn(NAN), ("is nan", "a whole number of rollouts")),
    "a budget of 2.5": (lambda _: made().learn(2.5), ("is 2.5", "a whole number of rollouts")),
    "a budget as text": (lambda _: made().learn("10"), ("is '10'", "a whole number of rollouts")),
    "no budget": (lambda _: made().learn(0), ("total_timesteps is 0", "give at least that")),
    "learning without an environment": (
        lambda folder: GA.load(saved(folder, GA)).learn(20),
        ("loaded without an environment", "GA.load(path, env=env)", "set_env"),
    ),
    "a seed below 0 on loading": (
        lambda folder: GA.load(saved(folder, GA), seed=-3), ("seed is -3", "or None"),
    ),
    "a context and an info": (
        lambda _: made().predict((np.zeros(1), {})), ("a tuple", "probably mixing Gym API"),
    ),
    "a context of another length": (
        lambda _: made().predict(np.zeros(3)), ("(3,)", "(C,) or (N, C), where C is 1"),
    ),
    "a context of nan": (
        lambda _: made().predict(np.array([NAN])), ("[nan]", "not finite", "1 finite numbers"),
    ),
    "an unknown change on loading": (
        lambda folder: REPS.load(saved(folder), n_sampled=8), ("'n_sampled'", "It has policy, env"),
    ),
    "a change that comes too late": (
        lambda folder: REPS.load(saved(folder), n_bases=9), ("n_bases is 9", "leave it out"),
    ),
    "another environment's model": (
        lambda folder: REPS.load(saved(folder), env=gym.make(ENV_ID)), ("spaces do not match",),
    ),
    "a foreign replay buffer": (
        lambda folder: made(GA).load_replay_buffer(str(written(folder, "b.npz", b"no zip"))),
        ("b.npz", "save_replay_buffer"),
    ),
    "rewards of nan": (
        lambda _: buffer().add(np.zeros((1, 1)), np.zeros((1, 5, 2)), np.array([NAN])),
        ("rewards hold", "not finite"),
    ),
    "rollouts of another shape": (
        lambda _: buffer().add(np.zeros((1, 1)), np.zeros((1, 4, 2)), np.zeros(1)),
        ("(1, 4, 2)", "(1, 5, 2)"),
    ),
    # tasks and environments
    "an unknown task": (lambda _: make_task("nmp/Pusch-v0"), ("'nmp/Pusch-v0'", "Did you mean")),
    "a number for a task": (
        lambda _: make_task(3), ("no task '3'", "nmp/Push-v0"),  # type: ignore[arg-type]
    ),
    "a text for a target": (
        lambda _: leave_one_out("nmp/Push-v0", "a"),  # type: ignore[arg-type]
        ("no target a", "numbered 0 to 9"),
    ),
    "a text for a switch": (
        lambda _: task_env(random_bottles="yes"), ("random_bottles is 'yes'", "True or False"),
    ),
    "a text for the field": (
        lambda _: make_task("nmp/PickAndPlace-v1", field="yes"), ("field is 'yes'", "True or"),
    ),
    "a text for a context": (
        lambda _: task_env().reset(options={"context": "a"}), ("context is 'a'", "4 numbers"),
    ),
    "a number for a Fetch task": (
        lambda _: fetch_env(5), ("'5' is no Fetch task", "FetchReach-v4"),  # type: ignore[arg-type]
    ),
    "half a time point": (
        lambda _: wrapped(n_time_points=10.5), ("n_time_points is 10.5", ">= 2, a whole number"),
    ),
    "time points as a text": (
        lambda _: wrapped(n_time_points="10"), ("n_time_points is '10'", "a whole number"),
    ),
    "a rest at nan": (lambda _: wrapped(initial=[NAN]), ("initial is [nan]", "1 finite numbers")),
    "a text for a scale": (
        lambda _: wrapped(exploration_scale="big"), ("exploration_scale is 'big'", "number > 0"),
    ),
    "a text for a bound": (
        lambda _: wrapped(low="a", high=1.0), ("low is 'a'", "finite numbers, shape (D,)"),
    ),
    "an id to wrap": (
        lambda _: TrajectoryActionWrapper("Pendulum-v1"),  # type: ignore[arg-type]
        ("env is 'Pendulum-v1'", "gym.make(id)"),
    ),
    "a text for a context to wrap": (
        lambda _: wrapped().reset(options={"context": "a"}), ("context is 'a'", "3 numbers"),
    ),
    "an unknown setting": (lambda _: task_env(bottles=3), ("'bottles'", "random_bottles")),
    "a render mode that is none": (lambda _: task_env(render_mode="human"), ("human", "rgb_array")),
    "a context of another shape": (
        lambda _: task_env(context=[0.0]), ("(1,)", "(4,)", "bottle"),
    ),
    "a pinned context of nan": (
        lambda _: task_env(context=[NAN] * 4), ("nan", "must lie in", "The whole space"),
    ),
    "a context outside": (
        lambda _: task_env(context=[9.0] * 4), ("is 9", "must lie in", "The whole space"),
    ),
    "an unknown reset option": (
        lambda _: task_env().reset(options={"goal": 1}), ("'goal'", "the only one is 'context'"),
    ),
    "options in a list": (
        lambda _: task_env().reset(options=["context"]),  # type: ignore[arg-type]
        ("options is ['context']", "a dictionary: {'context': c}"),
    ),
    "settings beside a task": (
        lambda _: TrajectoryEnv(make_task(ENV_ID), random_bottles=True),
        ("random_bottles was given beside a task", "or give its id"),
    ),
    "texts for contexts": (
        lambda _: make_task(ENV_ID).simulate("a", TRAJECTORY),
        ("context is 'a'", "(N, C) or (C,)"),
    ),
    "a batch of no rollouts": (
        lambda _: make_task(ENV_ID).simulate(np.zeros((0, 4)), np.zeros((0, 200, 2))),
        ("0 contexts were given", "one context for each"),
    ),
    "a step before the reset": (lambda _: task_env().step(TRAJECTORY), ("call reset()",)),
    "a trajectory of another shape": (
        lambda _: stepped(task_env(), np.zeros((3, 2))), ("(3, 2)", "(200, 2)"),
    ),
    "several trajectories in one episode": (
        lambda _: stepped(task_env(), np.zeros((3, 200, 2))), ("given 3 traj", "an episode of its"),
    ),
    "no trajectory": (
        lambda _: stepped(task_env(), np.zeros((0, 200, 2))), ("given 0 traj", "executes one"),
    ),
    "a trajectory of nan": (
        lambda _: stepped(task_env(), np.full((200, 2), NAN)), ("nan at time point 0", "finite"),
    ),
    "a batch of another environment": (
        lambda _: TrajectoryVecEnv([Plain]), ("Plain", "use DummyVecEnv or SubprocVecEnv"),
    ),
    "a batch of mixed settings": (
        lambda _: TrajectoryVecEnv([task_env, lambda: task_env(random_bottles=True)]),
        ("environment 1", "environment 0", "for a mix"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", BAD)
def test_bad_input_is_told_with_value_rule_and_way_out(kind: str, tmp_path: Path) -> None:
    call, parts = BAD[kind]
    with pytest.raises(ValueError) as caught:  # all our errors are; TypeErrors of Python's are not
        call(tmp_path)
    message = str(caught.value)
    assert [part for part in parts if part not in message] == [], message
    assert message.rstrip()[-1] in ".)" or "https://" in message, message
