"""Recorded scenarios as programs for the oracle, as far as they are in its domain.

In the domain are scenarios whose files have event rules only, whose stream has events only, and whose goals
set the policy and out_of_order.
"""

import json
from fractions import Fraction
from pathlib import Path
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Tuple

import retalis.events.language.event_operators  # noqa: F401 -- adds its operators to those of Prolog
from retalis import Operators, Term, deref, list_items
from retalis.prolog.syntax.term_reader import ReadTerm, read_program, read_term
from retalis.prolog.terms.list_terms import conjuncts
from retalis.prolog.terms.timestamps import SECOND, from_term

from .goal_evaluator import show
from .pattern_classes import Check, Do, Multiply, Rule, Where, walk
from .rule_notation import pattern_of

SOLVED = frozenset("true fail false = \\= == \\== < > =< >= =:= =\\= is member \\+ t1 t2".split())  # noqa: SIM905


class Scenario(NamedTuple):
    """A program, its stream, and the expected events."""

    name: str
    rules: List[Rule]
    flags: Dict[str, Any]
    stream: List[Tuple[Term, Any, Any]]
    expected: List[Tuple[str, Any, Any]]


def scenarios(folder: Path) -> Iterator[Scenario]:
    """Yield the scenarios of a folder that the oracle can run."""
    for path in sorted(folder.glob("*.json")):
        data = json.loads(path.read_text())
        flags = _flags(data.get("goals") or [])
        if flags is None or data.get("goals_after_compile") or data.get("files"):
            continue
        if not all(isinstance(item, list) for item in data["stream"] or [{}]):
            continue
        texts = data["rules"] if isinstance(data["rules"], list) else [data["rules"]]
        rules = [_rule(term) for text in texts for term in _terms(text)]
        if not rules or None in rules or not all(_solvable(rule) for rule in rules):  # type: ignore[arg-type]
            continue
        expected = data.get("expected_sane", data["expected"])
        events = [(_term(text), *map(_seconds, stamps)) for text, stamps in data["stream"]]
        expected_events = [
            (show(_term(text)), _seconds(start), _seconds(end)) for text, start, end in expected
        ]
        yield Scenario(path.stem, rules, flags, events, expected_events)  # type: ignore[arg-type]


def _flags(goals: List[str]) -> Optional[Dict[str, Any]]:
    flags: Dict[str, Any] = {}
    for text in goals:
        goal = _term(text)
        if goal.__class__ is not tuple or goal[0].name != "set_etalis_flag":
            return None
        if goal[1].name == "event_consumption_policy":
            flags["policy"] = goal[2].name
        elif goal[1].name == "out_of_order":
            flags["out_of_order"] = goal[2].name == "on"
        else:
            return None
    return None if flags.get("policy") == "foo" else flags


def _terms(text: str) -> List[Any]:
    clauses = list(read_program(text, Operators.prolog(), "scenario"))
    terms = [item.term for item in clauses if isinstance(item, ReadTerm)]
    return terms if len(terms) == len(clauses) else [None]


def _term(text: str) -> Term:
    return read_term(text, Operators.prolog(), "scenario").term


def _seconds(text: str) -> Any:
    instant = Fraction(int(from_term(_term(text))), SECOND)
    return int(instant) if instant.denominator == 1 else instant


def _rule(term: Term) -> Optional[Rule]:
    """Return a rule, or None if the clause is none."""
    if term.__class__ is not tuple or len(term) != 3:
        return None
    if term[0].name == "rule:":
        label, inner = term[1], _rule(term[2])
        if inner is None or inner.label is not None:
            return None
        return Rule(inner.head, inner.pattern, "label", _window(label), inner.do)
    if term[0].name != "<-":
        return None
    head, do = deref(term[1]), None
    if head.__class__ is tuple and head[0].name == "do":
        head, do = head[1], head[2]
    return Rule(head, pattern_of(term[2]), None, None, do)


def _window(label: Term) -> Any:
    properties: List[Any] = (list_items(label[1]) if label.__class__ is tuple else None) or []
    windows = [item[2] for item in properties if item[1].name in ("window", "event_rule_window")]
    return min(windows) if windows else None


def _solvable(rule: Rule) -> bool:
    """Return whether the oracle's evaluator knows all goals of a rule."""
    goals = [node.goal for node in walk(rule.pattern) if isinstance(node, (Where, Check, Do, Multiply))]
    if rule.do is not None:
        goals.append(rule.do)
    for goal in goals:
        for single in conjuncts(goal):
            name = single[0].name if single.__class__ is tuple else getattr(single, "name", None)
            if name not in SOLVED:
                return False
    return True
