"""Runs side by side in one process, whose networks are trained as one.

The networks here are small: a step of training costs more in calls than in arithmetic. `together`
lets several runs go on in turn, each as far as its next `train`. Phases of one kind, such as those
of the same network under several seeds, are then done as one, on stacked parameters. Each run keeps
its own random numbers, so what it learns is what it learns alone, up to rounding.

Only one run moves at any time: nothing here needs to be safe for threads.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Sequence
from contextvars import ContextVar, copy_context
from threading import Semaphore, Thread
from typing import Generic, Self, TypeVar

T = TypeVar("T")


class TrainingPhase(ABC):
    """A phase of training of one network, with all that it needs."""

    @property
    @abstractmethod
    def kind(self) -> Hashable:
        """Phases of one class and kind can be done as one."""

    @abstractmethod
    def alone(self) -> None:
        """Do it."""

    @classmethod
    @abstractmethod
    def as_one(cls, phases: Sequence[Self]) -> None:
        """Do several of one kind.

        :param phases: each of another network
        """


def train(phase: TrainingPhase) -> None:
    """Do a phase of training, in a run of `together` with those of the other runs.

    :param phase: what to do
    """
    member = _MEMBER.get()
    if member is None:
        phase.alone()
    else:
        member.meet(phase)


def clock() -> float:
    """Return a time in s whose differences are what this run took.

    In `together` these are the times when it moved, and its shares of the common training.
    """
    member = _MEMBER.get()
    return time.perf_counter() - (0.0 if member is None else member.elsewhere)


def together(tasks: Sequence[Callable[[], T]]) -> list[T]:
    """Do tasks side by side, and their training phases as one wherever they are of one kind.

    The task that has trained least goes first, with all that wait for the same kind of phase. So
    tasks that have come apart meet again.

    >>> together([lambda: 1, lambda: 2])
    [1, 2]

    :param tasks: such as runs of one algorithm with several seeds
    :return: what each returns
    :raises Exception: what the first of the tasks that failed has raised, once all have ended
    """
    members = [_Member(task) for task in tasks]
    for member in members:
        member.go_on()
    while waiting := [member for member in members if member.phase is not None]:
        first = min(waiting, key=lambda member: member.n_phases)
        met = [member for member in waiting if member.waits_for(first.kind)]
        _train_as_one(met)
        for member in met:
            member.go_on()
    for member in members:
        if member.error is not None:
            raise member.error
    return [member.result for member in members]


def _train_as_one(members: Sequence["_Member"]) -> None:
    """Do what members wait for; an error is each one's."""
    phases = [member.phase for member in members if member.phase is not None]
    begin, error = time.perf_counter(), None
    try:
        if len(phases) == 1:
            phases[0].alone()
        else:
            type(phases[0]).as_one(phases)
    except Exception as raised:  # whatever a network or an optimizer raises
        error = raised
    share = (time.perf_counter() - begin) / len(members)
    for member in members:
        member.share, member.failure = share, error


class _Member(Generic[T]):
    """A task in a thread of its own, which moves only while `go_on` waits for it.

    :param task: what it does
    """

    result: T

    def __init__(self, task: Callable[[], T]) -> None:
        self._task = task
        self._may_move, self._has_stopped = Semaphore(0), Semaphore(0)
        #: what it waits for; None before its start and after its end
        self.phase: TrainingPhase | None = None
        self.n_phases = 0
        self.error: BaseException | None = None
        #: of the phase that was done
        self.failure: Exception | None = None
        self.share = 0.0
        #: time that was spent on others, in s
        self.elsewhere = 0.0
        # of a process that is interrupted no thread is left
        Thread(target=copy_context().run, args=(self._work,), daemon=True).start()

    @property
    def kind(self) -> Hashable:
        """Of the phase that it waits for, its class included."""
        return type(self.phase), None if self.phase is None else self.phase.kind

    def waits_for(self, kind: Hashable) -> bool:
        """Tell whether it waits for a phase of a kind.

        :param kind: as `kind` returns it
        """
        return self.kind == kind

    def go_on(self) -> None:
        """Let it move until it waits for a phase, or ends."""
        self.phase = None
        self._may_move.release()
        self._has_stopped.acquire()

    def meet(self, phase: TrainingPhase) -> None:
        """Wait until a phase is done; called by the task.

        :param phase: of its training
        :raises Exception: what the phase raised
        """
        begin = time.perf_counter()
        self.phase = phase
        self.n_phases += 1
        self._has_stopped.release()
        self._may_move.acquire()
        self.elsewhere += time.perf_counter() - begin - self.share
        if self.failure is not None:
            raise self.failure

    def _work(self) -> None:
        self._may_move.acquire()
        _MEMBER.set(self)
        try:
            self.result = self._task()
        except BaseException as error:  # raised again by `together`
            self.error = error
        self._has_stopped.release()


_MEMBER: ContextVar["_Member | None"] = ContextVar("member", default=None)
