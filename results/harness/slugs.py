"""Names that are fit for files."""

import re


def slug(text: str) -> str:
    """Return a name that is fit for a file.

    >>> slug("RC-NMP, no crossover")
    'rc-nmp-no-crossover'

    :param text: any name
    """
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def task_slug(task: str) -> str:
    """Return a task's name for files.

    >>> task_slug("nmp/Push-v0")
    'push-v0'

    :param task: its id
    """
    return slug(task.removeprefix("nmp/"))
