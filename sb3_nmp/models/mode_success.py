"""`ModeSuccess`: how likely the answer of each mode succeeds in a context.

Shape letters: N contexts, M answers that were tried, C context, K modes.
"""

import warnings
from typing import Any, ClassVar, cast

import numpy as np
import torch as th
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessClassifier
from sklearn.gaussian_process.kernels import RBF, ConstantKernel
from torch import nn

from sb3_nmp.common.growing import GrowingModule

#: answers that are remembered: of failures the newest ones, at most half, and the newest successes
N_REMEMBERED = 300
#: learned anew when so many times the answers are known
RELEARN = 1.1
KERNEL = ConstantKernel(4.0, (0.1, 1e3)) * RBF(1.0, (0.1, 30.0))
#: between contexts of two modes, far beyond any length: a success tells nothing of another mode
APART = 1e3


class ModeSuccess(GrowingModule):
    """Gaussian process classification of contexts and modes.

    Rasmussen and Williams, "Gaussian processes for machine learning", 2006, chapter 3, by
    scikit-learn; here is the mean of the latent function alone. Where nothing is known it is 0.

    >>> outcomes = ModeSuccess(context_dim=1, n_modes=2)
    >>> tried = th.tensor([[-1.0], [-0.8], [0.8], [1.0]])
    >>> outcomes.remember(tried, th.zeros(4, dtype=th.long), th.tensor([True, True, False, False]))
    >>> outcomes.learn(tried[:0], th.zeros(0, dtype=th.long))
    >>> outcomes(th.tensor([[0.9]])).argmax().item()  # of mode 1 nothing is known
    1

    :param context_dim: C
    :param n_modes: K
    """

    growing: ClassVar[tuple[str, ...]] = (
        "tried_contexts", "tried_modes", "tried_successes", "contexts", "weights",
    )  # fmt: skip

    tried_contexts: th.Tensor
    tried_modes: th.Tensor
    tried_successes: th.Tensor
    contexts: th.Tensor
    weights: th.Tensor
    length: th.Tensor
    variance: th.Tensor
    n_tried: th.Tensor
    n_learned: th.Tensor

    def __init__(self, context_dim: int, n_modes: int) -> None:
        super().__init__()
        self.n_modes = n_modes
        self.register_buffer("tried_contexts", th.empty(0, context_dim))
        self.register_buffer("tried_modes", th.empty(0, dtype=th.long))
        self.register_buffer("tried_successes", th.empty(0, dtype=th.bool))
        self.register_buffer("contexts", th.empty(0, context_dim))
        self.register_buffer("weights", th.empty(0, n_modes))  # 0 but for each context's mode
        self.register_buffer("length", th.ones(()))
        self.register_buffer("variance", th.zeros(()))
        self.register_buffer("n_tried", th.zeros((), dtype=th.long))  # ever
        self.register_buffer("n_learned", th.zeros((), dtype=th.long))

    @property
    def knows_failures(self) -> bool:
        """Whether any answer that failed has been learned from."""
        return bool(self.variance > 0)

    @property
    def is_to_learn(self) -> bool:
        """Whether so many more answers are known that they are to be learned."""
        return int(self.n_tried) > RELEARN * int(self.n_learned)

    def remember(self, contexts: th.Tensor, modes: th.Tensor, successes: th.Tensor) -> None:
        """Take note of answers that were tried; `learn` learns from them.

        :param contexts: standardised, shape (M, C)
        :param modes: that answered, shape (M,)
        :param successes: whether each did, shape (M,)
        """
        self.n_tried += len(modes)
        kept = worth_keeping(
            th.cat([self.tried_successes, successes.to(self.tried_successes)]), N_REMEMBERED
        )
        for name, new in (("contexts", contexts), ("modes", modes), ("successes", successes)):
            known = getattr(self, f"tried_{name}")
            setattr(self, f"tried_{name}", th.cat([known, new.to(known)])[kept])

    def learn(self, shown: th.Tensor, modes: th.Tensor) -> None:
        """Learn from what was tried, and from demonstrations, which succeed in their mode.

        :param shown: contexts of the demonstrations, standardised, shape (N, C)
        :param modes: theirs, shape (N,)
        """
        self.n_learned.copy_(self.n_tried)
        self.contexts = th.cat([self.tried_contexts, shown.to(self.tried_contexts)])
        of_mode = th.cat([self.tried_modes, modes.to(self.tried_modes)])
        succeeded = th.cat([self.tried_successes, th.ones_like(modes, dtype=th.bool)])
        self.weights = self.weights.new_zeros(len(self.contexts), self.n_modes)
        self.variance.zero_()
        if succeeded.all() or not succeeded.any():
            return
        apart = APART * nn.functional.one_hot(of_mode, self.n_modes)
        seen = th.cat([self.contexts, apart], dim=1).cpu().numpy().astype(np.float64)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # a length at its bound will do
            found = GaussianProcessClassifier(KERNEL).fit(seen, succeeded.cpu().numpy())
        process = cast(Any, found.base_estimator_)  # binary: no one-against-the-rest around it
        variance, length = np.exp(process.kernel_.theta)
        self.variance.fill_(float(variance))
        self.length.fill_(float(length))
        left = th.as_tensor(process.y_train_ - process.pi_).to(self.weights)
        self.weights.scatter_(1, of_mode[:, None], left[:, None])

    def forward(self, contexts: th.Tensor) -> th.Tensor:
        """Return the log-odds of each mode's success, shape (N, K).

        :param contexts: standardised, shape (N, C)
        """
        squares = (contexts[:, None] - self.contexts).square().sum(dim=2)
        return self.variance * th.exp(-0.5 * squares / self.length.square()) @ self.weights


def worth_keeping(successes: th.Tensor, n: int) -> th.Tensor:
    """Return the rows of at most n answers, in order; successes are forgotten before failures.

    Where most answers succeed, the failures tell where modes end. Forgetting them let the choice of
    the mode become worse again after 300 answers (``results/experiments/acnmp.md``).

    >>> worth_keeping(th.tensor([False, True, True, False, True, True]), 4).tolist()
    [0, 3, 4, 5]

    :param successes: of answers, oldest first, shape (M,)
    :param n: even
    """
    failed, succeeded = th.where(~successes)[0][-n // 2 :], th.where(successes)[0]
    n_forgotten = max(0, len(succeeded) + len(failed) - n)
    return th.cat([failed, succeeded[n_forgotten:]]).sort().values
