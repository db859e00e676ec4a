# ruff: noqa: E501 - texts of the page
"""Limits on the page about security and in the launch file, compared with those of the code."""

import ast
from math import log10
from typing import Any, Dict
from xml.etree import ElementTree

import pytest
from parsed_sources import ROOT, TREES

from retalis import Settings
from retalis.engine.event_input import MAX_EVENT_TEXT_CHARACTERS
from retalis.events.knowledge import event_states
from retalis.events.language import state_parser
from retalis.events.program import topic_configuration
from retalis.events.rules import program_timers
from retalis.foundation import errors, ros_name_checks
from retalis.foundation.displayed_text import MAX_SHOWN_CHARACTERS
from retalis.foundation.errors import MAX_MESSAGE_CHARACTERS
from retalis.messages import type_definition, type_registry
from retalis.prolog.builtins import text_arguments, text_streams
from retalis.prolog.machine import arithmetic
from retalis.prolog.terms import term_traversal

PAGE = (ROOT / "docs" / "explanation" / "security.md").read_text(encoding="utf-8")
MILLION = 1_000_000


def table(heading: str) -> Dict[Any, Any]:
    """Return the rows of the table whose first line begins with a cell, by their first cells."""
    lines = PAGE[PAGE.index(heading) :].split("\n\n", 1)[0].splitlines()[2:]
    rows = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in lines]
    return {row[0]: row[1:] for row in rows}


def millions(number: Any) -> str:
    """Return a number of millions in words."""
    assert number % MILLION == 0
    return f"{number // MILLION} million"


STATES = f"{event_states.MAX_STATES:,} declarations; of each {state_parser.DEFAULT_MAX_OPEN:,} open and {state_parser.DEFAULT_MAX_PAST:,} past ones"
FIXED_LIMITS = {
    "names of packages, types, slots": f"beginning with a letter; {ros_name_checks.MAX_NAME_CHARACTERS} characters",
    "text of an event": f"{millions(MAX_EVENT_TEXT_CHARACTERS)} characters",
    "type definitions that publishers send": (
        f"{type_registry.MAX_ADDED_TYPES:,} types, {millions(type_registry.MAX_ADDED_CHARACTERS)} characters in all; each "
        f"{millions(type_registry.MAX_DEFINITION_CHARACTERS)} characters, {type_definition.MAX_SLOTS:,} slots, depth {type_definition.MAX_TYPE_DEPTH}"
    ),
    "`pub_sub.xml`": f"{millions(topic_configuration.MAX_XML_CHARACTERS)} characters, depth {topic_configuration.MAX_XML_DEPTH}, no DOCTYPE",
    "errors of one file that are shown": f"{errors.MAX_ERRORS}, and the number",
    "characters of a text from outside that are shown": f"{MAX_SHOWN_CHARACTERS}; {MAX_MESSAGE_CHARACTERS:,} of a whole error",
    "open streams": f"{text_streams.MAX_OPEN_STREAMS}",
    "integers": f"{arithmetic.MAX_INTEGER_BITS:,} bits ({int(arithmetic.MAX_INTEGER_BITS * log10(2)) + 1:,} digits)",
    "texts that goals make": f"{millions(text_arguments.MAX_TEXT_CHARACTERS)} characters",
    "terms that goals traverse": f"{millions(term_traversal.MAX_STEPS)} parts",
    "timers": f"{program_timers.MAX_TIMERS:,}, each at most once a millisecond; {program_timers.MAX_FIRINGS_PER_JUMP:,} firings at once",
    "states": STATES,
}


@pytest.mark.parametrize("name", FIXED_LIMITS)
def test_page_has_fixed_limit(name: str) -> None:
    (limit,) = table("| what | limit |")[name]
    assert FIXED_LIMITS[name] in limit


def node_limits() -> Dict[Any, Any]:
    """Return the default limits of a node from the module of its parameters."""
    (path,) = [path for path in TREES if path.endswith("node/parameters.py")]
    for statement in TREES[path].body:
        if not isinstance(statement, ast.Assign) or not isinstance(statement.value, ast.Call):
            continue
        (target,) = statement.targets
        if isinstance(target, ast.Name) and target.id == "DEFAULT_LIMITS":
            return {keyword.arg: ast.literal_eval(keyword.value) for keyword in statement.value.keywords}
    raise AssertionError(path)


LAUNCH_DEFAULTS = {
    argument.get("name"): argument.get("default")
    for argument in ElementTree.parse(ROOT / "launch" / "retalis.launch").getroot().iter("arg")
}
NONE = "none"
ENGINE = Settings()
NODE_LIMITS = {"output_megabytes": ENGINE.limits.output_megabytes, **node_limits()}


@pytest.mark.parametrize(
    ("parameter", "node", "engine", "unit"),
    [
        ("max_seconds", NODE_LIMITS["seconds"], ENGINE.limits.seconds, " s"),
        ("max_megabytes", NODE_LIMITS["megabytes"], ENGINE.limits.megabytes, " MB"),
        ("max_output_megabytes", NODE_LIMITS["output_megabytes"], ENGINE.limits.output_megabytes, " MB"),
        ("max_inferences", NODE_LIMITS.get("inferences"), ENGINE.limits.inferences, ""),
        ("max_file_megabytes", ENGINE.max_file_megabytes, ENGINE.max_file_megabytes, " MB"),
        ("queue", ENGINE.queue, ENGINE.queue, ""),
        ("max_depth", ENGINE.max_depth, ENGINE.max_depth, ""),
    ],
)
def test_page_and_launch_file_have_default(parameter: str, node: Any, engine: Any, unit: str) -> None:
    rows = {cells[0]: cells[1:] for cells in table("| what | node |").values()}
    texts = [NONE if value is None else f"{value:g}{unit}" for value in (node, engine)]
    assert rows[f"`~{parameter}`"] == texts
    launch_default = LAUNCH_DEFAULTS[parameter]
    assert launch_default is not None
    assert launch_default == NONE or float(launch_default) == (node or 0)
