"""What all algorithms share: the loop, constructors, noise, buffers, exceptions.

An algorithm of one's own supplies three methods of `TrajectoryAlgorithm`. This one tries noisy
copies of the environment's initial trajectory and remembers the best:

>>> from typing import ClassVar
>>> import numpy as np, torch as th
>>> import benchmark_envs
>>> from sb3_nmp import SmoothNoise, TrajectoryAlgorithm
>>> from sb3_nmp.common.policies import ElitePolicy
>>> class Policy(ElitePolicy):
...     def __init__(self, observation_space, action_space, lr_schedule):
...         super().__init__(observation_space, action_space)
...
...     def generalise(self, contexts, deterministic=True):
...         return th.zeros(len(contexts), *self.trajectory_shape)
>>> class RandomSearch(TrajectoryAlgorithm):
...     policy_aliases: ClassVar = {"MlpPolicy": Policy}
...
...     def _begin_generation(self):
...         n, shape = self.population_size, self.policy.trajectory_shape
...         self.noise = self.first_scale() * SmoothNoise().sample(self.rng, n, shape)
...
...     def _propose(self, members, contexts):
...         return self.initial_trajectory() + self.noise[members]
...
...     def _end_generation(self, generation):
...         done = generation
...         self.policy.elites.update(done.contexts, done.trajectories, done.rewards)
>>> model = RandomSearch("MlpPolicy", "nmp/Bottles-v0", population_size=10, seed=0).learn(30)
>>> model.num_timesteps, len(model.policy.elites.rewards)
(30, 1)
"""
