"""What a figure or table of the thesis is here: runs, claims, our numbers beside the thesis's."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from results.exceptions import BenchmarkError
from results.harness.records import RunRecord, finished
from results.report.text_table import TextTable

if TYPE_CHECKING:  # drawing is imported where it is asked for
    from matplotlib.figure import Figure

Verdict = Literal["held", "held in part", "not held"]
#: the records by the name of the folder that holds them
Records = Mapping[str, Sequence[RunRecord]]


@dataclass(frozen=True)
class SuiteRuns:
    """Runs of a suite.

    :param folder: that holds them, inside the folder of all runs
    :param suite: its name
    :param labels: of the algorithms that the figure shows
    :param n_seeds: from 0 on; the suite's own number by default
    :param budget: rollouts of a run; the suite's own by default
    :param variants: of the tasks; all by default
    :param numbers: of the contexts, where the suite's protocols number them; all by default
    """

    folder: str
    suite: str
    labels: tuple[str, ...]
    n_seeds: int | None = None
    budget: int | None = None
    variants: tuple[str, ...] | None = None
    numbers: tuple[int, ...] | None = None


@dataclass(frozen=True)
class SamplingRuns:
    """Networks that are trained on curves, without any rollout.

    :param folder: that holds their records
    :param n_seeds: from 0 on
    :param categories: K on the six bundles
    :param shortened: factor on the numbers of training steps
    """

    folder: str
    n_seeds: int
    categories: tuple[int, ...]
    shortened: float = 1.0


@dataclass(frozen=True)
class TransferRuns:
    """Trainings of two arms' networks on proxy skills.

    :param folder: that holds their records
    :param n_seeds: from 2 on; the settings were chosen on 0 and 1
    :param shortened: factor on the number of training steps
    """

    folder: str
    n_seeds: int
    shortened: float = 1.0


#: what `nmp-bench reproduce` knows to make
Runs = SuiteRuns | SamplingRuns | TransferRuns


@dataclass(frozen=True)
class Finding:
    """One claim of the thesis, and what came out here.

    :param claim: in our words
    :param thesis: its number, where it gives one
    :param here: our number
    :param held: whether the claim holds here
    """

    claim: str
    thesis: str
    here: str
    held: bool


@dataclass(frozen=True)
class ThesisFigure:
    """A figure or table of the thesis that a command makes anew.

    :param name: such as ``"fig-6.2"`` or ``"table-5.1"``
    :param made: how it is made and what is measured
    :param full: the runs behind it
    :param quick: the runs of ``--quick``, too few for conclusions
    :param findings: of the records; the first argument of both is what `records_in` returns
    :param draw: the picture; None where there is none
    :param tables: of text, where there are any
    """

    name: str
    made: str
    full: tuple[Runs, ...]
    quick: tuple[Runs, ...]
    findings: Callable[[Records], list[Finding]]
    draw: Callable[[Records], "Figure"] | None = None
    tables: Callable[[Records], Sequence[TextTable]] | None = None


def verdict(findings: Sequence[Finding]) -> Verdict:
    """Return whether all claims held, some, or none.

    >>> verdict([Finding("a", "", "", True), Finding("b", "", "", False)])
    'held in part'

    :param findings: at least one
    """
    n_held = sum(finding.held for finding in findings)
    if n_held == len(findings):
        return "held"
    return "held in part" if n_held else "not held"


def chosen(
    records: Sequence[RunRecord], label: str, variant: str | None = None, number: int | None = None
) -> list[RunRecord]:
    """Return the finished runs of an algorithm, seed by seed.

    :param records: of one folder
    :param label: the algorithm's
    :param variant: of the task; all by default
    :param number: of the context; all by default
    :raises BenchmarkError: there are none
    """
    found = [
        record
        for record in finished(records)
        if record.specification.label == label
        and variant in (None, record.specification.variant)
        and number in (None, record.specification.protocol.number)
    ]
    if not found:
        where = f" on {variant}" if variant else ""
        where += "" if number is None else f" in context {number}"
        known = sorted({record.specification.label for record in finished(records)})
        raise BenchmarkError(
            f"no run of {label}{where} has finished; the folder holds finished runs of "
            f"{', '.join(known) or 'nothing'}. Failed runs keep their reason in *.failed.json."
        )
    return sorted(found, key=lambda record: record.specification.seed)
