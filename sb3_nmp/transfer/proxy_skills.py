"""`ProxySkills`: what two robots have been shown of the same skills, checked once."""

from dataclasses import dataclass

import numpy as np

from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.exceptions import ConfigurationError, InvalidDataError

#: contexts that differ by less name the same skill
SAME = 1e-6


@dataclass(frozen=True)
class ProxySkills:
    """Demonstrations of the same skills by two robots, row by row.

    The contexts say which skill a row is, for instance a number of the skill and where its target
    is. Both robots must be given the same ones in the same order; joints and time points may
    differ.

    >>> left = Demonstrations([[0.0], [1.0]], [[[0.0], [0.5]], [[1.0], [1.5]]])
    >>> right = Demonstrations([[0.0], [1.0]], [[[0.0, 0.1]] * 5, [[1.0, 0.2]] * 5])
    >>> len(ProxySkills(left, right))
    2

    :param source: demonstrations of one robot, N of them
    :param target: demonstrations of the other robot
    :raises ConfigurationError: one of them is no `Demonstrations`
    :raises InvalidDataError: there is one proxy skill alone, a skill of one robot only, or the
        rows show different skills or another order
    """

    source: Demonstrations
    target: Demonstrations

    def __post_init__(self) -> None:
        """Check that rows belong together."""
        for name in ("source", "target"):
            given = getattr(self, name)
            if not isinstance(given, Demonstrations):
                raise ConfigurationError(
                    f"{name} is {_described(given)}; it must be Demonstrations(contexts, "
                    "trajectories) of the proxy skills, at least two of them."
                )
        self._check_contexts()
        if len(self) < 2:
            raise InvalidDataError(
                "there is 1 proxy skill; at least 2 that differ are needed, for one says nothing "
                "about how the robots' trajectories go together."
            )

    def __len__(self) -> int:
        """Return the number of proxy skills, N."""
        return len(self.source)

    def _check_contexts(self) -> None:
        source, target = self.source, self.target
        if source.context_dim != target.context_dim:
            raise InvalidDataError(
                f"the source's contexts have {source.context_dim} entries and the target's "
                f"{target.context_dim}; both robots' contexts must name the skills alike."
            )
        lonely = [
            f"the {here} shows the skill of context {_lacking(shown, other).tolist()}, and the "
            f"{there} does not"
            for here, there, shown, other in (
                ("source", "target", source, target),
                ("target", "source", target, source),
            )
            if _lacking(shown, other).size
        ]
        if lonely:
            raise InvalidDataError(
                f"{'; '.join(lonely)}. Each proxy skill must be shown by both robots: leave it "
                "out, or record it on the other one."
            )
        if len(source) != len(target):
            raise InvalidDataError(
                f"the source has {len(source)} demonstrations and the target {len(target)} of the "
                "same skills; each row of one needs its row of the other."
            )
        differing = np.abs(source.contexts - target.contexts).max(axis=1) > SAME
        if differing.any():
            row = int(differing.argmax())
            raise InvalidDataError(
                f"row {row} shows the skill of context {source.contexts[row].tolist()} by the "
                f"source and of {target.contexts[row].tolist()} by the target: both robots' "
                "demonstrations must be in the same order. Sort them, such as by "
                "np.lexsort(demonstrations.contexts.T)."
            )


def _lacking(shown: Demonstrations, other: Demonstrations) -> np.ndarray:
    """Return the first context that the other does not have, an empty array where it has all."""
    apart = np.abs(shown.contexts[:, None] - other.contexts[None]).max(axis=2).min(axis=1)
    lonely = np.flatnonzero(apart > SAME)
    return shown.contexts[lonely[0]] if len(lonely) else np.empty(0)


def _described(given: object) -> str:
    empty = isinstance(given, list | tuple) and not given
    return f"an empty {type(given).__name__}" if empty else f"a {type(given).__name__}"
