"""The lines of an algorithm's log, under the names that SB3 gives them."""

import sys
import time

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.utils import safe_mean


def write_log(model: BaseAlgorithm, iteration: int) -> None:
    """Write the log's current values.

    :param model: whose log
    :param iteration: generations in this call of ``learn``
    """
    elapsed = max((time.time_ns() - model.start_time) / 1e9, sys.float_info.epsilon)
    model.logger.record("time/iterations", iteration, exclude="tensorboard")
    if model.ep_info_buffer:
        for name, key in (("ep_rew_mean", "r"), ("ep_len_mean", "l")):
            mean = safe_mean([info[key] for info in model.ep_info_buffer])
            model.logger.record(f"rollout/{name}", mean)
    if model.ep_success_buffer:
        model.logger.record("rollout/success_rate", safe_mean(list(model.ep_success_buffer)))
    spent = model.num_timesteps - model._num_timesteps_at_start
    model.logger.record("time/fps", int(spent / elapsed))
    model.logger.record("time/time_elapsed", int(elapsed), exclude="tensorboard")
    model.logger.record("time/total_timesteps", model.num_timesteps, exclude="tensorboard")
    model.logger.dump(step=model.num_timesteps)
