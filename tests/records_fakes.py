"""Records that no run has made: what tables and figures are tested with."""

from typing import Any

from results.harness.records import (
    ContextRecord,
    ErrorRecord,
    Measurements,
    ProtocolRecord,
    Provenance,
    Result,
    RolloutRecord,
    RunRecord,
    Seconds,
    SpecificationRecord,
    SuiteRecord,
    TaskRecord,
)

ORIGIN = Provenance("c0ffee", False, {"numpy": "2.0"}, "3.11", "Linux", "2026-01-01T00:00:00")
PLANAR = TaskRecord(("x [m]",), ("hand x [m]", "hand y [m]"), 0.01)


def specification(
    label: str,
    seed: int,
    task: str = "nmp/Bottles-v0",
    budget: int = 4,
    protocol: ProtocolRecord | None = None,
    suite: SuiteRecord | None = None,
    **more: Any,
) -> SpecificationRecord:
    """What was asked for."""
    return SpecificationRecord(
        label, more.get("description", ""), label.lower(), {}, task, {}, seed, budget,
        more.get("own_budget", False), protocol or ProtocolRecord("one-context"),
        suite or SuiteRecord(), more.get("variant", ""),
    )  # fmt: skip


def finished_run(
    asked: SpecificationRecord,
    curve: dict[str, list[Any]],
    task: TaskRecord = PLANAR,
    training: float = 1.0,
    context: ContextRecord | None = None,
    rollouts: dict[str, RolloutRecord] | None = None,
    more: dict[str, Any] | None = None,
) -> RunRecord:
    """A run that ended as it should."""
    measured = Measurements(curve, context, rollouts or {}, more or {})
    return RunRecord(asked, ORIGIN, "finished", Result(task, Seconds(training, 0.0), measured))


def failed_run(asked: SpecificationRecord, message: str = "singular") -> RunRecord:
    """A run that raised an error."""
    return RunRecord(asked, ORIGIN, "failed", error=ErrorRecord("RuntimeError", message, "..."))


def curve_of(rewards: list[float], successes: list[bool], first: int = 1) -> dict[str, list[Any]]:
    """A curve with one row per rollout."""
    best = [max(rewards[: i + 1]) for i in range(len(rewards))]
    return {
        "rollouts": list(range(first, first + len(rewards))),
        "best_reward": best,
        "best_success": successes,
        "any_success": [any(successes[: i + 1]) for i in range(len(successes))],
        "greedy_reward": rewards,
        "greedy_success": successes,
    }
