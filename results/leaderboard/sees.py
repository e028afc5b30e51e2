"""What a row says that its algorithm learns from, held to what the algorithm itself says."""

from collections.abc import Iterator
from inspect import signature
from typing import Any

from benchmark_envs import Task
from results.exceptions import BenchmarkError
from results.harness.runner import sees, setting_of
from results.harness.specification import RunSpecification
from results.leaderboard.rows import Row
from results.stream.protocol import Stream
from sb3_nmp import CNMPPretraining, ConfigurationError
from sb3_nmp.common.rollouts import Information
from sb3_nmp.common.skill_search import SkillSearch

REWARD, ACHIEVED = str(Information.REWARD), str(Information.ACHIEVED_CONTEXTS)
Seen = frozenset[str]


class UntoldError(Exception):
    """What an algorithm learns from cannot be told here; the message says why."""


def about_sees(row: Row, run: RunSpecification) -> Iterator[str]:
    """Yield what is wrong with what a row says that its algorithm learns from.

    Whether achieved contexts were learned from is decided in the runs, so a row may tell them or
    not where its algorithm can; all else must be as its class and settings have it.

    :param row: its claims
    :param run: one of its runs, as the board asks for it
    :raises UntoldError: the algorithm cannot be made here
    """
    choices = what_it_may_see(run)
    said = None if row.sees is None else frozenset(row.sees)
    if said in choices and list(row.sees or ()) == sorted(said or ()):
        return
    told = " or ".join(str(None if each is None else sorted(each)) for each in choices)
    yield (
        f"its sees is {None if row.sees is None else list(row.sees)}, but '{row.label}' learns "
        f"from {told}. Restore the row from the repository, or make it anew."
    )


def what_it_may_see(run: RunSpecification) -> list[Seen | None]:
    """Return what an algorithm may have learned from after its runs; None where it does not say.

    :param run: one of them
    :raises UntoldError: the algorithm cannot be made here
    """
    setting = setting_of(run)
    prepared = run.protocol.prepare(setting)
    try:
        kind, arguments = run.algorithm.load(), run.algorithm.arguments(prepared.demonstrations)
        if "pretraining" in signature(kind).parameters:  # takes long, and decides nothing here
            arguments["pretraining"] = CNMPPretraining(n_steps=0)
        model = kind("MlpPolicy", prepared.env, seed=run.seed, **arguments)
    except (BenchmarkError, ConfigurationError, ImportError) as error:
        raise UntoldError(f"what the algorithm learns from: it cannot be made ({error})") from error
    finally:
        prepared.env.close()
    before = sees(model)
    if before is None:
        return [None]
    return _after(frozenset(before), model, setting.task, isinstance(run.protocol, Stream))


def _after(before: Seen, model: Any, task: Task, over_many: bool) -> list[Seen | None]:  # noqa: ANN401
    """Return what runs can make of what a new model learns from: achieved contexts come in.

    :param before: what the model tells before its first rollout
    :param model: of any class
    :param task: of the runs
    :param over_many: whether contexts vary in a run
    """
    choices: list[Seen | None] = [before]
    if not task.tells_achievement:
        return choices
    critic = getattr(model, "critic", None)  # of ACNMP, where it searches by one, and its twins
    aims = critic is not None and critic.achieved and getattr(model, "search", "") != "policy"
    relabels = over_many and isinstance(model, SkillSearch) and _relabels(model)
    if aims or relabels:
        choices.append(before | {ACHIEVED})
    if relabels:  # in all runs, and not in some alone
        choices.append(before - {REWARD} | {ACHIEVED})
    return choices


def _relabels(model: SkillSearch) -> bool:
    """Tell whether rollouts count for what they achieved: by default not beside demonstrations."""
    return model.demonstrations is None if model.relabel is None else model.relabel
