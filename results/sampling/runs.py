"""The runs of thesis 6.2.1: networks trained on curves, and what their samples are like.

A run is one network, trained with one seed; it has a record as runs of suites have, but no
rollouts: its budget counts training steps.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from results.harness.records import ProtocolRecord, SpecificationRecord, SuiteRecord, TaskRecord
from results.harness.training_runs import train_missing
from results.sampling.curves import BUNDLES, HEIGHTS, bundle_heights, curves
from results.sampling.measures import bundles_found, in_gap, inside, spanned
from results.sampling.models import SamplingTraining, train_cnmp, train_sampler

N_SAMPLES, N_KEPT, DECIMALS = 1000, 60, 4
SIX = "six demonstrations"
TASK = TaskRecord((), ("y",), 1 / 199)
#: the wider what z has to fill, the more steps until few samples leave it
PLAIN, WIDE, NARROW = SamplingTraining(6000), SamplingTraining(4000), SamplingTraining(2000)
CNMP_STEPS = 3000


@dataclass(frozen=True)
class SamplingRun:
    """One network to be trained.

    :param variant: the demonstrations: `SIX`, or one of `BUNDLES`
    :param n_categories: K of RC-NMP's network; 0 is a CNMP
    :param seed: of weights, batches and samples
    :param training: of the network; a CNMP takes its number of steps alone
    """

    variant: str
    n_categories: int
    seed: int
    training: SamplingTraining

    @property
    def record(self) -> SpecificationRecord:
        """The specification as records keep it."""
        k = self.n_categories
        label = "CNMP" if k == 0 else "RC-NMP" if k == 1 else f"RC-NMP, {k} categories"
        settings: dict[str, Any] = {"n_categories": k} | ({} if k == 0 else asdict(self.training))
        return SpecificationRecord(
            label, "", "cnmp" if k == 0 else "rcnmp", settings, "sampling", {}, self.seed,
            self.training.n_steps, True, ProtocolRecord("sampling"), SuiteRecord("fig-6.2"),
            self.variant,
        )  # fmt: skip


def sampling_runs(
    seeds: Sequence[int], categories: Sequence[int], shortened: float = 1.0
) -> list[SamplingRun]:
    """Return the runs of the figure.

    :param seeds: of each network
    :param categories: K on the six bundles
    :param shortened: factor on the numbers of training steps
    """

    def steps(training: SamplingTraining) -> SamplingTraining:
        n_steps, start_steps = (
            round(shortened * n) for n in (training.n_steps, training.start_steps)
        )
        return replace(training, n_steps=n_steps, start_steps=start_steps)

    wanted = [(SIX, 0, replace(PLAIN, n_steps=CNMP_STEPS)), (SIX, 1, PLAIN)]
    wanted += [("two bundles", k, WIDE) for k in (1, 2)]
    wanted += [("six bundles", k, NARROW) for k in categories]
    return [SamplingRun(what, k, seed, steps(t)) for seed in seeds for what, k, t in wanted]


def measure(run: SamplingRun) -> dict[str, Any]:
    """Train a network and return the numbers about its samples, as JSON values.

    :param run: which
    """
    if run.n_categories == 0:
        shown = curves(HEIGHTS)
        band = train_cnmp(shown, run.seed, run.training.n_steps)
        return {"mean": _plain(band.mean[:, 0].numpy()), "std": _plain(band.stddev[:, 0].numpy())}
    bundles = BUNDLES.get(run.variant)
    shown = curves(HEIGHTS if bundles is None else bundle_heights(bundles))
    sampler = train_sampler(shown, run.n_categories, run.seed, run.training)
    drawn, categories = sampler.draw(N_SAMPLES, np.random.default_rng(run.seed))
    kept = {"samples": _plain(drawn[:N_KEPT, :, 0]), "categories": categories[:N_KEPT].tolist()}
    if bundles is None:
        paths, envelope = drawn[..., 0], shown[..., 0]
        within = float(inside(paths, envelope).mean())
        return kept | {"inside": within, "spanned": spanned(paths, envelope)}
    found = bundles_found(drawn, categories, bundles)
    return kept | {"gap": float(in_gap(drawn, bundles).mean()), "found": found}


def _plain(values: np.ndarray) -> list[Any]:
    return values.round(DECIMALS).astype(float).round(DECIMALS).tolist()


def run_sampling(
    folder: Path,
    runs: Sequence[SamplingRun],
    n_workers: int | None,
    tell: Callable[[str], None],
) -> None:
    """Do the runs that a folder does not hold yet, in parallel processes.

    :param folder: of the runs
    :param runs: those wanted
    :param n_workers: processes; one per core by default
    :param tell: is told the name of each run that has ended
    :raises SettingsClashError: the folder holds one of them with other settings
    """
    train_missing(folder, runs, measure, TASK, n_workers, tell)
