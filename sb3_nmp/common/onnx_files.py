"""Policies as ONNX: contexts to trajectories, on machines without PyTorch and this library."""

import warnings
from importlib.util import find_spec
from io import BytesIO
from typing import Any, cast

import torch as th
from gymnasium import spaces
from stable_baselines3.common.base_class import BaseAlgorithm
from torch import nn

from sb3_nmp.common.elites import SAME_CONTEXT
from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.common.files import AnyPath, writing
from sb3_nmp.common.policies import ElitePolicy, TrajectoryPolicy

INPUT, OUTPUT = "contexts", "trajectories"
OPSET = 17


class Greedy(nn.Module):
    """What ``predict(contexts, deterministic=True)`` answers, as one computation without branches.

    :param policy: whose answers
    """

    low: th.Tensor
    high: th.Tensor
    may_answer: th.Tensor

    def __init__(self, policy: ElitePolicy) -> None:
        super().__init__()
        self.policy = policy
        space = cast(spaces.Box, policy.action_space)
        self.register_buffer("low", th.as_tensor(space.low))
        self.register_buffer("high", th.as_tensor(space.high))
        n = len(policy.elites.rewards)
        self.register_buffer("may_answer", th.tensor([policy._may_answer(i) for i in range(n)]))

    def forward(self, context: th.Tensor) -> th.Tensor:
        """Return a trajectory inside the action space, shape (T, D).

        :param context: shape (C,)
        """
        policy, contexts = self.policy, context[None]
        answers = policy.generalise(contexts)
        if len(policy.repertoire.achieved):
            known = policy.repertoire.find(contexts)
            repeated = policy.repertoire.trajectories[known.clamp(min=0)]
            answers = th.where((known >= 0)[:, None, None], repeated, answers)
        if len(self.may_answer):
            distances = (contexts[:, None] - policy.elites.contexts).abs().amax(dim=2)
            nearest = distances.argmin(dim=1, keepdim=True)
            same = distances.gather(1, nearest) <= SAME_CONTEXT
            hit = (same & self.may_answer[nearest])[:, 0]
            remembered = policy.elites.trajectories[nearest[:, 0]]
            answers = th.where(hit[:, None, None], remembered, answers)
        return th.minimum(th.maximum(answers[0], self.low), self.high)


def export_onnx(policy: TrajectoryPolicy, path: AnyPath) -> None:
    """Write a policy's greedy answers as ONNX: ``contexts`` (N, C) to ``trajectories`` (N, T, D).

    Both are float32, N is free. What is remembered of rollouts is part of it.

    :param policy: of a model, ``model.policy``; one whose answers are a network's
    :param path: of the file, or an open one
    :raises ConfigurationError: a model instead of its policy, answers that are no network's, or
        onnx is not installed
    """
    if isinstance(policy, BaseAlgorithm):
        raise ConfigurationError("export_onnx takes a policy: give model.policy, not the model.")
    if not isinstance(policy, ElitePolicy) or not policy.answers_by_network:
        raise ConfigurationError(
            f"a {type(policy).__name__} in this state answers each context by a computation that "
            "ONNX has no words for; export the trajectories for your contexts instead, as .csv or "
            ".mcap. ACNMP's policy can be exported, and RC-NMP's of one context."
        )
    if find_spec("onnx") is None:
        raise ConfigurationError("onnx is not installed: pip install 'sb3-nmp[onnx]'.")
    with writing(path) as file:
        file.write(_for_each_context(_traced(policy), policy))


def _traced(policy: ElitePolicy) -> bytes:
    """Return the answer to a single context as ONNX."""
    buffer: Any = BytesIO()  # which PyTorch takes, though its types do not say so
    device = policy.device
    context = th.as_tensor(cast(spaces.Box, policy.observation_space).low.clip(-1e3, 1e3)).float()
    greedy = Greedy(policy.to("cpu")).eval()
    try:
        with th.no_grad(), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the tracer: all sizes are constant here
            th.onnx.export(
                greedy,
                (context,),
                buffer,
                input_names=["context"],
                output_names=["trajectory"],
                opset_version=OPSET,
                dynamo=False,
            )
    finally:
        policy.to(device)
    return buffer.getvalue()


def _for_each_context(single: bytes, policy: ElitePolicy) -> bytes:
    """Return as ONNX what answers many contexts, one after the other, as one is answered."""
    from onnx import TensorProto, checker, helper, load_from_string

    one = load_from_string(single)
    node = helper.make_node("Scan", [INPUT], [OUTPUT], num_scan_inputs=1, body=one.graph)
    shapes = {INPUT: ["N", policy.context_dim], OUTPUT: ["N", *policy.trajectory_shape]}
    ends = [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in shapes.items()]
    graph = helper.make_graph([node], "policy", ends[:1], ends[1:])
    model = helper.make_model(graph, opset_imports=one.opset_import, ir_version=one.ir_version)
    checker.check_model(model)
    return model.SerializeToString()
