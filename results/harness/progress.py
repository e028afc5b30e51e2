"""What `nmp-bench run` shows while a plan's runs are done, and what it says at the end."""

import sys
from collections.abc import Iterable

from joblib.externals.loky.process_executor import BrokenProcessPool
from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from results.harness.cluster import ClusterGoneError
from results.harness.counters import RolloutCounters
from results.harness.record_files import FAILED
from results.harness.resume import Plan, finished_path
from results.harness.runner import Backend, Outcome, run_plan

DONE, ALL_FAILED, INTERRUPTED = 0, 1, 130
MISSING = ALL_FAILED  # where a file that is there cannot be read


class RunProgress(Progress):
    """A bar over the rollouts of all runs, with the number of runs that have ended.

    :param plan: what is being done
    :param counters: of the rollouts
    :param console: to draw on; nothing is drawn unless it is a terminal
    """

    def __init__(self, plan: Plan, counters: RolloutCounters, console: Console) -> None:
        self._counters = counters  # the bar is drawn once while it is built
        super().__init__(
            TextColumn("{task.fields[runs]}/{task.fields[n_runs]} runs"),
            BarColumn(None),
            MofNCompleteColumn(),
            TextColumn("rollouts"),
            TimeRemainingColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        total = sum(run.budget for run in plan.todo)
        self._bar = self.add_task("", total=total, runs=0, n_runs=len(plan.todo))

    def ended(self, n_runs: int) -> None:
        """Show how many runs have ended.

        :param n_runs: finished and failed ones
        """
        self.update(self._bar, runs=n_runs)

    def get_renderables(self) -> Iterable[RenderableType]:
        """Read the counters whenever the bar is drawn."""
        for task_id in self.task_ids:
            self.update(task_id, completed=self._counters.total())
        yield from super().get_renderables()


def run_with_progress(
    plan: Plan,
    n_workers: int | None,
    backend: Backend = "processes",
    n_together: int = 1,
) -> int:
    """Do the runs of a plan, tell about each, and return the exit status.

    :param plan: what is to be done
    :param n_workers: processes; one per core by default
    :param backend: where, see `run_plan`
    :param n_together: runs side by side in one process, see `run_plan`
    """
    console = Console(highlight=False, soft_wrap=True)
    for why in plan.unreadable:
        print(f"nmp-bench: {why}", file=sys.stderr)
    if plan.kept:
        console.print(
            f"{len(plan.kept)} of {plan.n_asked} runs are finished in "
            f"{plan.folder} already and are kept (--overwrite does them again)."
        )
    if plan.missing:
        print(
            f"nmp-bench: {len(plan.missing)} of {plan.n_asked} runs are not done, for their files "
            "cannot be read.",
            file=sys.stderr,
        )
    if not plan.todo:
        return MISSING if plan.missing else DONE
    ended: list[Outcome] = []
    try:
        with (
            RolloutCounters(len(plan.todo)) as counters,
            RunProgress(plan, counters, console) as progress,
        ):
            for outcome in run_plan(plan, n_workers, counters, backend, n_together):
                ended.append(outcome)
                progress.ended(len(ended))
                progress.console.print(describe(outcome), markup=False)
    except ClusterGoneError as error:
        return _stopped(plan, str(error), ALL_FAILED)
    except KeyboardInterrupt:
        return _stopped(plan, "interrupted", INTERRUPTED)
    except BrokenProcessPool:
        less = "fewer --workers" if n_together == 1 else "fewer --workers, or a smaller --together"
        why = f"a worker process died (out of memory? then use {less})"
        return _stopped(plan, why, ALL_FAILED)
    failed = [outcome for outcome in ended if not outcome.record.finished]
    console.print(
        f"{len(ended) - len(failed)} of {len(ended)} runs finished: {plan.folder}", markup=False
    )
    if failed:
        print(
            f"{len(failed)} of {len(ended)} runs failed; the tracebacks are in "
            f"{plan.folder}/*{FAILED}, and the same command tries them again.",
            file=sys.stderr,
        )
    return ALL_FAILED if len(failed) == len(ended) else MISSING if plan.missing else DONE


def describe(outcome: Outcome) -> str:
    """Return one line about a run that has ended.

    :param outcome: of the run
    """
    record = outcome.record
    if not record.finished:
        return f"{outcome.run.name}: failed, {' '.join(record.reason.split())}"
    return f"{outcome.run.name}: {outcome.run.protocol.headline(record.curve)}"


def _stopped(plan: Plan, why: str, status: int) -> int:
    """Tell what an interrupted plan leaves, files of the last moment included."""
    runs = (*plan.kept, *plan.todo)
    finished = sum(finished_path(plan.folder, run).exists() for run in runs)
    command = "the same command" + (" without --overwrite" if plan.overwrite else "")
    print(
        f"\nnmp-bench: {why}. {finished} of {plan.n_asked} runs are finished in "
        f"{plan.folder}; {command} does the rest.",
        file=sys.stderr,
    )
    return status
