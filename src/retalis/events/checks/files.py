"""Rules of a program's folder that no goal reads."""

import os
from typing import Iterator

from ...foundation import RuleError, UsageError
from ..program import GOALS, RULES, read_text
from .overview import Overview


def unread_rules(program: Overview) -> Iterator[RuleError]:
    """Yield the rule file where it is there and not read."""
    if program.folder is None:
        return
    path = program.folder / RULES
    if not os.path.isfile(path) or program.loaded.files.has_loaded(
        path
    ):  # where we may not look, it is not there
        return
    try:
        goals = read_text(program.folder / GOALS)
    except UsageError:  # said when it was to be loaded
        goals = ""
    if RULES not in goals:
        yield RuleError(f"{path} is not read: no goal in {GOALS} calls compile_event_file('{RULES}')")
