"""``nmp-bench reproduce``: makes the runs behind a figure or table of the thesis, and judges it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from results.exceptions import BenchmarkError
from results.harness.progress import run_with_progress
from results.harness.record_files import read_records
from results.harness.records import RunRecord
from results.harness.resume import plan_runs
from results.harness.specification import RunSpecification
from results.harness.suite import make_suite
from results.report.figure_style import save_figures
from results.report.text_table import Page, Section, TextTable
from results.suites import find_recipe
from results.thesis import find_figure
from results.thesis.interface import (
    Finding,
    Runs,
    SamplingRuns,
    SuiteRuns,
    ThesisFigure,
    TransferRuns,
    verdict,
)

QUICK_NOTE = "These are quick runs, too few and too short for conclusions; leave out --quick."


@dataclass(frozen=True)
class Request:
    """How figures are to be made.

    :param folder: of all runs
    :param quick: fewer seeds and smaller budgets, in folders of their own
    :param n_workers: processes; one per core by default
    """

    folder: Path
    quick: bool = False
    n_workers: int | None = None

    def file(self, name: str) -> str:
        """Return the name of a figure's files, without an ending.

        :param name: of the figure
        """
        return f"{name}-quick" if self.quick else name

    def place(self, asked: Runs) -> Path:
        """Return the folder of some of the runs.

        :param asked: the runs
        """
        return self.folder / self.file(asked.folder)


def reproduce(name: str, request: Request, tell: Callable[[str], None] = print) -> Page:
    """Make the runs behind a figure that are still missing, draw it, and return what it says.

    :param name: of the figure
    :param request: how
    :param tell: is told about runs and files
    :raises BenchmarkError: there is no such figure, or none of its runs has finished
    """
    figure = find_figure(name)
    asked = figure.quick if request.quick else figure.full
    records: dict[str, list[RunRecord]] = {}
    for runs in asked:
        if isinstance(runs, SamplingRuns):
            _run_sampling(runs, request, tell)
        elif isinstance(runs, TransferRuns):
            _run_transfer(runs, request, tell)
        else:
            _run_suite(runs, request)
        records[runs.folder] = read_records(request.place(runs)).records
    found = figure.findings(records)
    drawn = {} if figure.draw is None else {f"{request.file(name)}.png": figure.draw(records)}
    for path in save_figures(request.folder, drawn):
        tell(f"Written: {path}")
    tables = () if figure.tables is None else figure.tables(records)
    return page(figure, found, request.quick, tables)


def page(
    figure: ThesisFigure, found: list[Finding], quick: bool, tables: Sequence[TextTable] = ()
) -> Page:
    """Return the claims of a figure with the thesis's numbers beside ours, and last the verdict.

    :param figure: of the thesis
    :param found: about its claims
    :param quick: whether the runs were quick ones
    :param tables: above the claims
    """
    claims = [
        Section(
            f"{'Held' if f.held else 'Not held'}: {f.claim}",
            [f"thesis: {f.thesis}", f"here: {f.here}"],
            "green" if f.held else "red",
        )
        for f in found
    ]
    judged = Section("Verdict", [f"{figure.name}: {verdict(found)}"], "bold")
    notes = [figure.made, *([QUICK_NOTE] if quick else [])]
    return Page(tables, [*claims, Section("How it is made", notes, "dim"), judged])


def _run_sampling(asked: SamplingRuns, request: Request, tell: Callable[[str], None]) -> None:
    from results.sampling.runs import run_sampling, sampling_runs

    runs = sampling_runs(range(asked.n_seeds), asked.categories, asked.shortened)
    run_sampling(request.place(asked), runs, request.n_workers, tell)


def _run_transfer(asked: TransferRuns, request: Request, tell: Callable[[str], None]) -> None:
    from results.transfer.latents import latent_runs, run_latents

    runs = latent_runs(asked.n_seeds, asked.shortened)
    run_latents(request.place(asked), runs, request.n_workers, tell)


def _run_suite(asked: SuiteRuns, request: Request) -> None:
    """Make the runs of a suite that its folder does not hold yet."""
    runs = specifications(asked)
    run_with_progress(plan_runs(request.place(asked), runs), request.n_workers)


def specifications(asked: SuiteRuns) -> list[RunSpecification]:
    """Return the runs of a suite that are asked for.

    :param asked: which
    :raises BenchmarkError: the suite has no such variant, or no context of such a number
    """
    seeds = None if asked.n_seeds is None else range(asked.n_seeds)
    recipe = find_recipe(asked.suite)
    suite = make_suite(asked.suite, recipe, seeds, asked.budget, asked.labels)
    variants = tuple(recipe.variants) if asked.variants is None else asked.variants
    unknown = set(variants) - set(recipe.variants)
    if unknown:
        raise BenchmarkError(
            f"the suite '{asked.suite}' has no variant {', '.join(sorted(unknown))}; it has "
            f"{', '.join(recipe.variants)}."
        )
    known = {run.protocol.number for run in suite.specifications}
    numbers = known if asked.numbers is None else set(asked.numbers)
    if numbers - known:
        raise BenchmarkError(
            f"the suite '{asked.suite}' has no context {sorted(numbers - known, key=str)}; it has "
            f"{sorted(known, key=str)}."
        )
    return [
        run
        for run in suite.specifications
        if run.variant in variants and run.protocol.number in numbers
    ]
