"""`Assimilation`: adaptation that tells where the latent space has what was found (Fig. 5.5)."""

from copy import deepcopy
from dataclasses import dataclass
from typing import Any, ClassVar, cast

import numpy as np
import torch as th

from benchmark_envs import extrapolation
from results.adaptation.protocol import Adaptation, AdaptationEvaluation
from results.harness.environments import FloatArray, RunTask
from results.harness.greedy import DECIMALS
from results.harness.protocol import OnRollouts, PreparedRun
from results.harness.records import Measurements
from sb3_nmp import ACNMP, Demonstrations
from sb3_nmp.models.cnmp import CNMP


class LatentEvaluation(AdaptationEvaluation):
    """Keeps the network as it was before the first rollout, to compare its latent space."""

    before: CNMP
    #: the expert's answers in the two contexts beside the run's own
    neighbours: Demonstrations

    def _on_training_start(self) -> None:
        super()._on_training_start()
        self.before = deepcopy(cast(ACNMP, self.model).policy.cnmp)

    def measured(self) -> Measurements:
        """Return what an adaptation measures, and ``more["latents"]``, before and after."""
        measured = super().measured()
        found = self.greedy.trajectories
        after = cast(ACNMP, self.model).policy.cnmp
        measured.more["latents"] = {
            "before": self._latents(self.before, found),
            "after": self._latents(after, found),
        }
        return measured

    @th.no_grad()
    def _latents(self, cnmp: CNMP, found: FloatArray) -> dict[str, Any]:
        """Return where whole trajectories lie in a network's latent space.

        ``error`` is that of the trajectory that the network makes of the found one's latent, and
        ``solved`` tells whether it is enough.

        :param cnmp: the network
        :param found: the run's solution, shape (1, T, D)
        """
        asked = self.context[None]
        latent = cnmp.encode_whole(Demonstrations(asked, found))
        decoded = cnmp.mean(cnmp.condition(latent.new_tensor(asked)), latent).cpu().numpy()
        rollouts = self.task.simulate(asked, decoded)
        codes = {
            "shown": cnmp.encode_whole(cast(Demonstrations, self.demonstrations)),
            "neighbours": cnmp.encode_whole(self.neighbours),
            "found": latent[0],
        }
        return {
            **{name: code.cpu().numpy().round(DECIMALS).tolist() for name, code in codes.items()},
            "error": round(-float(rollouts.rewards[0]), DECIMALS),
            "solved": bool(rollouts.successes[0]),
        }


@dataclass(frozen=True)
class Assimilation(Adaptation):
    """Adapt in a context beyond a task's demonstrations, or in one left out between them.

    The contexts beside it are the next demonstrated ones on both sides; beyond them all it is the
    last one, and its mirror image on the other side, which was never shown.

    >>> shown, asked = Assimilation(4, between=True).split("nmp/Obstacles-v0")
    >>> shown.round(2)[-2:, 1].tolist(), asked.round(2).tolist()
    ([0.15, 0.45], [-0.26, 0.3])

    :param target: the number of the extrapolation context, or of the left-out demonstration
    :param between: a demonstration is left out
    """

    target: int
    between: bool

    name: ClassVar[str] = "assimilation"
    evaluation: ClassVar[type[AdaptationEvaluation]] = LatentEvaluation

    @property
    def kind(self) -> str:
        """Whether the context lies between the demonstrated ones or beyond them."""
        return "between" if self.between else "beyond"

    def split(self, task_id: str) -> tuple[FloatArray, FloatArray]:
        """Return the demonstrated contexts, and the one to adapt to.

        :param task_id: of the task
        """
        if not self.between:
            return extrapolation(task_id, self.target)
        shown, _ = extrapolation(task_id, 0)
        return np.delete(shown, self.target, axis=0), shown[self.target]

    def beside(self, task_id: str) -> FloatArray:
        """Return the contexts on both sides of the one to adapt to, shape (2, C).

        :param task_id: of the task
        """
        shown, asked = self.split(task_id)
        if self.between:
            return shown[[self.target - 1, self.target]]
        last = shown[np.square(shown - asked).sum(axis=1).argmin()]
        return np.stack([last, 2 * asked - last])

    def prepare(self, run: RunTask, on_rollouts: OnRollouts | None = None) -> PreparedRun:
        """Prepare an adaptation, and what is compared in the latent space.

        :param run: its task, seed and budget
        :param on_rollouts: told the number of rollouts so far
        """
        prepared = super().prepare(run, on_rollouts)
        evaluation = cast(LatentEvaluation, prepared.evaluation)
        evaluation.neighbours = run.demonstrated(self.beside(run.task_id))
        return prepared
