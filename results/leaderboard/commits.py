"""The commit that a row says it was made from, held to the history of this checkout."""

import re
from collections.abc import Iterator
from datetime import datetime

from results.harness.provenance import git, is_own_repository
from results.harness.records import Provenance

#: digits of a commit: all, or those that tables show
COMMIT = re.compile(r"[0-9a-f]{40}|[0-9a-f]{10}")
#: s; clocks of two machines may differ
CLOCKS = 600.0
WAY_OUT = "Restore the row from the repository, or make it anew."


def about_commit(origin: Provenance) -> Iterator[str]:
    """Yield what is wrong with the commit that a row names.

    A row of this history is made from a commit that leads to HEAD, which was there before its
    runs began. That it is another one of these cannot be told from the row: `check` does runs
    again.

    :param origin: of the row
    """
    commit = origin.commit
    if commit is not None and not COMMIT.fullmatch(commit):
        yield f"its commit is '{commit}', and one has 40 hexadecimal digits, or 10. {WAY_OUT}"
        return
    if why_not_looked_up(origin):
        return
    if commit is None:
        yield f"it names no commit, and this repository's rows do. {WAY_OUT}"
    elif git("merge-base", "--is-ancestor", commit, "HEAD") is None:
        yield (
            f"its commit {commit} is none of those that lead to HEAD, and rows are made from "
            f"these. {WAY_OUT}"
        )
    else:
        yield from _about_date(commit, origin.started)


def _about_date(commit: str, started: str) -> Iterator[str]:
    """Yield that a commit is newer than the runs that are said to be made from it."""
    made = float(git("show", "--no-patch", "--format=%ct", commit) or 0)
    try:
        began = datetime.fromisoformat(started).timestamp()
    except ValueError:
        yield f"its runs started '{started}', which is no date and time. {WAY_OUT}"
        return
    if began + CLOCKS < made:
        yield f"its runs started {started}, before there was its commit {commit}. {WAY_OUT}"


def why_not_looked_up(origin: Provenance) -> str:
    """Say why a row's commit cannot be looked up here; empty where it can.

    :param origin: of the row
    """
    if not is_own_repository():
        return "the commit: this copy of the program has no git history"
    if git("rev-parse", "--is-shallow-repository") != "true":
        return ""
    known = origin.commit and git("merge-base", "--is-ancestor", origin.commit, "HEAD") is not None
    return "" if known else "the commit: this is a shallow clone (git fetch --unshallow)"
