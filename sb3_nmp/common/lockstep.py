"""Runs side by side in one process, whose networks are trained as one.

The networks here are small: a step of training costs more in calls than in arithmetic. `together`
lets several runs go on in turn, each as far as its next `train`. Phases of one kind, such as those
of the same network under several seeds, are then done as one, on stacked parameters. Each run keeps
its own random numbers, those of the global generators too, so what a phase teaches it is what it
would learn alone, up to rounding.

Only one run moves at any time: nothing here needs to be safe for threads.
"""

import ctypes
import random
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Sequence
from contextvars import ContextVar, copy_context
from threading import Semaphore, Thread
from typing import Any, Generic, Self, TypeVar

import numpy as np
import torch as th

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


def n_met() -> int:
    """Return the most runs that this one has trained with as one, itself included; alone 1."""
    member = _MEMBER.get()
    return 1 if member is None else member.n_met


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
    try:
        for member in members:
            member.go_on()
        while waiting := [member for member in members if member.phase is not None]:
            first = min(waiting, key=lambda member: member.n_phases)
            met = [member for member in waiting if member.kind == first.kind]
            _train_as_one(met)
            for member in met:
                member.go_on()
    except BaseException:  # such as Ctrl-C: no thread may go on behind the caller's back
        for member in members:
            member.abandon()
        raise
    for member in members:
        if member.error is not None:
            raise member.error
    return [member.result for member in members]


def _train_as_one(members: Sequence["_Member"]) -> None:
    """Do what members wait for; each is told an error."""
    phases = [member.phase for member in members if member.phase is not None]
    begin, error = time.perf_counter(), None
    try:
        with th.enable_grad():
            if len(phases) == 1:
                phases[0].alone()
            else:
                type(phases[0]).as_one(phases)
    except Exception as raised:  # whatever a network or an optimizer raises
        error = raised
    share = (time.perf_counter() - begin) / len(members)
    for member in members:
        member.share, member.n_met = share, max(member.n_met, len(phases))
        member.failure = error if error is None or len(phases) == 1 else _shared(error, len(phases))


def _shared(error: Exception, n: int) -> RuntimeError:
    told = RuntimeError(
        f"the training of {n} runs as one failed ({type(error).__name__}: {error}); each by itself "
        "tells which of them is to blame."
    )
    told.__cause__ = error
    return told


class _AbandonedError(BaseException):
    """Ends a task whose caller has gone."""


class _Member(Generic[T]):
    """A task in a thread of its own, which moves only while `go_on` waits for it.

    :param task: what it does
    """

    result: T

    def __init__(self, task: Callable[[], T]) -> None:
        self._task = task
        self._may_move, self._has_stopped = Semaphore(0), Semaphore(0)
        #: what it waits for, and its kind; None before its start and after its end
        self.phase: TrainingPhase | None = None
        self.kind: Hashable = None
        self.n_phases, self.n_met = 0, 1
        self.error: BaseException | None = None
        #: of the phase that was done
        self.failure: BaseException | None = None
        self.share = 0.0
        #: time that was spent on others, in s
        self.elsewhere = 0.0
        self._thread = Thread(target=copy_context().run, args=(self._work,), daemon=True)
        self._thread.start()

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
        self.kind = type(phase), phase.kind
        begin, generators = time.perf_counter(), _generators()
        self.n_phases += 1
        self.phase = phase
        self._has_stopped.release()
        self._may_move.acquire()
        _set_generators(generators)
        self.elsewhere += time.perf_counter() - begin - self.share
        if self.failure is not None:
            raise self.failure

    def abandon(self) -> None:
        """End the task wherever it is, and wait until it has ended."""
        if not self._thread.is_alive():
            return
        self.failure = _AbandonedError()
        if self.phase is None and self._thread.ident is not None:  # it moves
            raised = ctypes.py_object(_AbandonedError)
            ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(self._thread.ident), raised)
        self._may_move.release()
        self._thread.join()

    def _work(self) -> None:
        try:
            self._may_move.acquire()
            _MEMBER.set(self)
            if self.failure is None:
                self.result = self._task()
        except BaseException as error:  # raised again by `together`
            self.error = error
        self._has_stopped.release()


def _generators() -> tuple[Any, ...]:
    """Return the states of the global generators."""
    return random.getstate(), np.random.get_state(), th.get_rng_state()


def _set_generators(states: tuple[Any, ...]) -> None:
    python, numpy, torch = states
    random.setstate(python)
    np.random.set_state(numpy)
    th.set_rng_state(torch)


_MEMBER: ContextVar["_Member | None"] = ContextVar("member", default=None)
