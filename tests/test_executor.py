"""The batched executor: what it logs, and what it makes of a simulation that breaks down."""

import mujoco
import numpy as np
import pytest

from benchmark_envs import BatchExecutor

SLIDER = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body name="ball">
      <joint name="x" type="slide" axis="1 0 0"/>
      <geom name="ball" size="0.1" mass="1"/>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="x" gear="100"/></actuator>
  <sensor>
    <clock name="clock"/>
    <jointpos name="x" joint="x"/>
  </sensor>
</mujoco>
"""
BROKEN = 1e9  # a hundredth of the force; MuJoCo gives up at an acceleration of 1e10


@pytest.fixture
def executor() -> BatchExecutor:
    return BatchExecutor(mujoco.MjModel.from_xml_string(SLIDER), substeps=4, n_threads=1, chunk=2)


def begin(executor: BatchExecutor, n: int) -> np.ndarray:
    return np.stack([executor.initial_state(np.ones(1))] * n)


def test_readings_are_those_at_the_time_points_and_peaks_those_in_between(
    executor: BatchExecutor,
) -> None:
    controls = np.zeros((1, 40, 1))
    controls[0, :20] = -0.05
    log = executor.run(begin(executor, 1), controls)
    every = executor.run(begin(executor, 1), controls).readings["x"]
    assert log.readings["x"].shape == log.peaks["x"].shape == (1, 10, 1)
    np.testing.assert_allclose(log.readings["clock"][0, :, 0], 0.01 * np.arange(3, 40, 4))
    assert (log.peaks["x"] >= every).all() and (log.peaks["x"] > every).any()
    states = executor.states(begin(executor, 1)[0], controls[0])
    np.testing.assert_array_equal(states[-1], log.final_states[0])


@pytest.mark.parametrize("step", [0, 17, 39])
def test_a_rollout_that_breaks_down_is_marked_reads_0_and_leaves_the_others_alone(
    executor: BatchExecutor, step: int
) -> None:
    controls = np.random.default_rng(0).normal(size=(3, 40, 1))
    healthy = executor.run(begin(executor, 3), controls)
    assert not healthy.diverged.any() and (healthy.readings["x"] != 0).all()
    controls[1, step] = BROKEN
    log = executor.run(begin(executor, 3), controls)
    np.testing.assert_array_equal(log.diverged, [False, True, False])
    for before, after in (
        (healthy.readings["x"], log.readings["x"]),
        (healthy.peaks["x"], log.peaks["x"]),
        (healthy.final_states, log.final_states),
    ):
        assert (after[1] == 0).all()
        np.testing.assert_array_equal(after[[0, 2]], before[[0, 2]])


def test_rollouts_of_several_chunks_read_as_each_alone_and_what_was_returned_stays(
    executor: BatchExecutor,
) -> None:
    controls = np.random.default_rng(0).normal(size=(5, 40, 1))
    log = executor.run(begin(executor, 5), controls)
    states = executor.states(begin(executor, 1)[0], controls[0])
    kept = states.copy()
    for i in range(5):
        alone = executor.run(begin(executor, 1), controls[i : i + 1])
        np.testing.assert_array_equal(log.readings["x"][i], alone.readings["x"][0])
        np.testing.assert_array_equal(log.peaks["x"][i], alone.peaks["x"][0])
        np.testing.assert_array_equal(log.final_states[i], alone.final_states[0])
    np.testing.assert_array_equal(states, kept)
