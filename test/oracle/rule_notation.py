"""Texts of the oracle: a small notation for tests, and rules in the notation of the engine.

Terms are canonical (``<(X,Y)``, no operators); patterns are prefix terms, ``seq(a(X),b(Y))``, which are read to
`patterns`. Rules for the engine are written in the notation of the language, with the operands of each operator in
parentheses.
"""

import re
from fractions import Fraction
from typing import Any, Dict, Iterable, Iterator, List, Tuple

from asserting_accessors import compound
from events.operator_table import AGGREGATES, INSTANTS, PAIRS

from retalis import Term, Var, atom, functor, list_items, make_list

from .goal_evaluator import show
from .pattern_classes import (
    NEGATIONS,
    WINDOWS,
    Aggregate,
    Awaited,
    Both,
    Check,
    Cnot,
    Do,
    Fnot,
    Instant,
    Leaf,
    Multiply,
    Ntimes,
    Or,
    Pattern,
    Preceded,
    Prolog,
    Rule,
    Shaped,
    Star,
    Sub,
    Where,
    Windowed,
    Within,
    Without,
    walk,
)
from .row_pattern_matches import steps_of

_TOKEN = re.compile(r"\s*(-?\d+(?:\.\d+)?|[A-Z_]\w*|[a-z]\w*|'[^']*'|\[\]|[-+*/<>=\\:]+|.)")


class Reader:
    """Reader of the terms of one rule: a name denotes the same variable in all of them."""

    def __init__(self) -> None:
        self.names: Dict[str, Var] = {}

    def term(self, text: str) -> Term:
        """Read one term."""
        self.tokens = [token for token in _TOKEN.findall(text) if token.strip()]
        result = self._term()
        assert not self.tokens, f"left over: {self.tokens}"
        return result

    def _term(self) -> Term:
        token = self.tokens.pop(0)
        if token == "[":
            return make_list(self._arguments("]"))
        if re.match(r"-?\d", token):
            return float(token) if "." in token else int(token)
        if token[0].isupper() or token[0] == "_":
            return Var() if token == "_" else self.names.setdefault(token, Var())
        name = token.strip("'")
        if self.tokens and self.tokens[0] == "(":
            self.tokens.pop(0)
            arguments = self._arguments(")")
            return functor(name, len(arguments))(*arguments)
        return atom(name)

    def _arguments(self, close: str) -> List[Term]:
        arguments: List[Any] = []
        while True:
            arguments.append(self._term())
            token = self.tokens.pop(0)
            if token == close:
                return arguments
            assert token == ",", token


def pattern_of(term: Term) -> Pattern:
    """Return the pattern of a term in prefix notation, or of a term of the package's reader."""
    name = term[0].name if term.__class__ is tuple else None
    args = term[1:] if term.__class__ is tuple else ()
    if name in ("seq", "and", "or") and len(args) == 2:
        pattern = _sequence(*args) if name == "seq" else None
        if pattern is not None:
            return pattern
    if len(args) == 2 and name in PAIRS:
        return Both(name, pattern_of(args[0]), pattern_of(args[1]))
    constructors: Dict[str, Any] = {
        "or": lambda p, q: Or(pattern_of(p), pattern_of(q)),
        "cnot": lambda p, q: Cnot(pattern_of(p), pattern_of(q)),
        "fnot": lambda p, q: Fnot(pattern_of(p), pattern_of(q)),
        "without": lambda p, q: Without(pattern_of(p), pattern_of(q)),
        "where": lambda p, goal: Where(pattern_of(p), goal),
        "check": lambda p, goal: Check(pattern_of(p), goal),
        "timestamp": lambda p, goal: Check(pattern_of(p), goal),
        "within": lambda p, n: Within(pattern_of(p), Fraction(n)),
        "do": lambda p, goal: Do(pattern_of(p), goal),
        "event_multiply": lambda p, goal: Multiply(pattern_of(p), goal),
        "ntimes": lambda p, n: Ntimes(pattern_of(p), n),
        "<-": lambda head, p: Sub(head, pattern_of(p)),
    }
    if len(args) == 1 and name in INSTANTS:
        return Instant(pattern_of(args[0]), name)
    if len(args) == 2 and name in constructors:
        result: Pattern = constructors[name](*args)
        return result
    return Leaf(term)


def _sequence(left: Term, right: Term) -> Any:
    """Return the patterns that are written with seq but are not sequences of two events."""
    for goal, other, before in ((right, left, False), (left, right, True)):
        if goal.__class__ is tuple and goal[0].name in ("prolog", "query", "db") and len(goal) == 2:
            return Prolog(pattern_of(other), goal[1], before, goal[0].name)
    if right.__class__ is tuple and right[0].name == "star_times":
        return Star(pattern_of(left), pattern_of(right[1]))
    if right.__class__ is tuple and right[0] is functor("aggregate", 3):
        kind = right[1]
        value = kind[-1] if kind.__class__ is tuple else None
        name = kind[0].name if kind.__class__ is tuple else kind.name
        assert name in AGGREGATES, name
        return Aggregate(pattern_of(left), name, value, pattern_of(right[2]), right[3])
    return None


def rule(head: str, pattern: str, **options: Any) -> Rule:
    """Read a rule from the texts of its head and its pattern, both in prefix notation."""
    reader = Reader()
    if "do" in options:
        options["do"] = reader.term(options["do"])
    return Rule(reader.term(head), pattern_of(reader.term(pattern)), **options)


def stream(text: str) -> List[Tuple[Term, Any, Any]]:
    """Read events ``a(1)@1 b(2)@2-4``: term, start and end in seconds."""
    events: List[Any] = []
    for item in text.split():
        term, times = item.rsplit("@", 1)
        start, _, end = times.partition("-")
        events.append((Reader().term(term), int(start), int(end or start)))
    return events


def brief(events: Iterable[Tuple[str, Any, Any]]) -> str:
    """Write events in the notation of `stream`."""
    return " ".join(f"{term}@{start}" + (f"-{end}" if end != start else "") for term, start, end in events)


class Names(Dict[Var, str]):
    """Names of a rule's variables, numbered by their first occurrence."""

    def __init__(self, form: str = "V{}") -> None:
        super().__init__()
        self.form = form

    def __missing__(self, var: Var) -> str:
        name = self[var] = self.form.format(len(self))
        return name


def write_term(term: Term, names: Names) -> str:
    """Write a term canonically, without operators."""
    if term.__class__ is Var:
        return names[term]
    items = list_items(term)
    if items is not None:
        return "[" + ",".join(write_term(item, names) for item in items) + "]"
    if term.__class__ is tuple:
        inside = ",".join(write_term(argument, names) for argument in term[1:])
        name = show(atom(term[0].name))
        return f"{name}({inside})"
    return show(term)


def write_seconds(seconds: Any) -> str:
    """Write a number of seconds."""
    return str(int(seconds)) if seconds == int(seconds) else str(float(seconds))


def _kinds(node: Windowed, names: Names) -> Iterator[str]:
    """Yield the aggregates of a window in the notation of rules."""
    values = list_items(node.values) or []
    for word in node.kinds.split():
        kind, _, step = word.partition("@")
        if kind not in ("count", "rate"):
            setting = "0.25," if kind == "quantile" else ""
            kind = f"{kind}({setting}{write_term(values.pop(0), names)})"
        yield f"of({steps_of(node.steps)[int(step)].name},{kind})" if step else kind


def _steps(node: Windowed, names: Names) -> str:
    """Write the steps of a window."""

    def write_parts(parts: Any) -> str:
        return ",".join(map(write_part, list_items(parts) or []))

    def write_part(part: Any) -> str:
        kind = part[0].name
        if kind == "step":
            return texts[part[1].name]
        if kind == "alternatives":
            return " or ".join(f"({write_part(inner)})" for inner in list_items(part[1]) or [])
        if kind == "permutation":
            return f"permute([{write_parts(part[1])}])"
        mode = ",reluctant" if part[4].name == "reluctant" else ""
        limit = part[3] if part[3].__class__ is int else "many"
        return f"group([{write_parts(part[1])}],{part[2]},{limit}{mode})"

    texts: Dict[str, str] = {}
    for step in steps_of(node.steps):
        limit = "many" if step.most is None else step.most
        option = ",reluctant" if step.reluctant else ""
        if step.until is not None:
            option = f",until({write_term(step.until, names)})"
        text = f"{step.name}({step.least},{limit}{option})"
        if step.goal is not None:
            text += f" where ({write_term(step.goal, names)})"
        texts[step.name] = f"later({text})" if step.later else text
    strategy, _, number = node.skip.partition("@")
    if number:
        strategy = f"{strategy}({steps_of(node.steps)[int(number)].name})"
    options = "" if strategy == "skip_past_last" else f",[after_match({strategy})]"
    return f"steps([{write_parts(node.steps)}]{options})"


def write_pattern(node: Pattern, names: Names) -> str:  # noqa: C901 - a case for each kind of pattern
    """Write a pattern in the language's notation."""

    def term(part: Term) -> str:
        return "(" + write_term(part, names) + ")"

    def inner(part: Pattern) -> str:
        return "(" + write_pattern(part, names) + ")"

    if isinstance(node, Leaf):
        return write_term(node.term, names)
    if isinstance(node, Both):
        return f"{inner(node.left)} {node.kind} {inner(node.right)}"
    if isinstance(node, Or):
        return f"{inner(node.left)} or {inner(node.right)}"
    if isinstance(node, Prolog):
        goal = f"{node.name}{term(node.goal)}"
        return f"{goal} seq {inner(node.pattern)}" if node.before else f"{inner(node.pattern)} seq {goal}"
    if isinstance(node, Star):
        return f"{inner(node.first)} seq ({inner(node.repeated)} star_times)"
    if isinstance(node, Aggregate):
        kind = node.kind if node.value is None else f"{node.kind}{term(node.value)}"
        if node.kind == "quantile" and node.value is not None:
            kind = f"quantile(0.25,{write_term(node.value, names)})"
        repeated = write_pattern(node.repeated, names)
        if not isinstance(node.repeated, Leaf):
            repeated = f"({repeated})"
        return f"{inner(node.first)} seq aggregate({kind},{repeated},{write_term(node.result, names)})"
    if isinstance(node, Awaited):
        seconds = names[node.seconds] if node.seconds.__class__ is Var else write_seconds(node.seconds)
        return f"{inner(node.pattern)} seq absent({inner(node.absent)},{seconds})"
    if isinstance(node, Preceded):
        seconds = write_seconds(node.seconds)
        return f"{inner(node.pattern)} with not_preceded({inner(node.absent)},{seconds})"
    if isinstance(node, Shaped):
        first = write_seconds(node.seconds) if node.seconds else write_term(compound(node.value)[1], names)
        key = "" if list_items(node.by) == [] else "," + write_term(node.by, names)
        return f"{inner(node.pattern)} with {node.shape}({first}{key})"
    if isinstance(node, Windowed):
        kinds = ",".join(_kinds(node, names))
        if node.window == "steps":
            window = _steps(node, names)
            if node.span:
                window = f"timed_out({window},{write_seconds(node.span)})"
        else:
            window = WINDOWS[node.window].format(write_seconds(node.span), write_seconds(node.step))
        return f"aggregate([{kinds}],{inner(node.collected)},{write_term(node.results, names)},{window})"
    if isinstance(node, Instant):
        return f"{node.name}({write_pattern(node.pattern, names)})"
    if isinstance(node, Ntimes):
        return f"{inner(node.pattern)} ntimes {node.times}"
    if isinstance(node, Within):
        return f"{inner(node.pattern)} within {write_seconds(node.seconds)}"
    if isinstance(node, NEGATIONS):
        return f"{inner(node.pattern)} {type(node).__name__.lower()} {inner(node.absent)}"
    if isinstance(node, Sub):
        return f"{write_term(node.head, names)} <- {write_pattern(node.pattern, names)}"
    words = {Where: "where", Check: "check", Do: "do", Multiply: "event_multiply"}
    return f"{inner(node.pattern)} {words[type(node)]} {term(node.goal)}"  # type: ignore[attr-defined]


def write_rule(rule: Rule, form: str = "V{}") -> str:
    """Write a rule in the language's notation, with its full stop; ``form`` makes names of variables."""
    names = Names(form)
    for node in walk(rule.pattern):
        if isinstance(node, Ntimes):
            names.update(dict.fromkeys(node.own, "_"))
    head = write_term(rule.head, names)
    if rule.do is not None:
        head += f" do ({write_term(rule.do, names)})"
    text = f"{head} <- {write_pattern(rule.pattern, names)}."
    label = rule.label or ("label" if rule.has_properties() else None)
    if label is None:
        return text
    settings = {
        "event_rule_window": None if rule.window is None else write_seconds(rule.window),
        "policy": rule.policy,
        "out_of_order": None if rule.out_of_order is None else ("on" if rule.out_of_order else "off"),
        "after_match": None if rule.after_match == "keep" else rule.after_match,
    }
    properties = ",".join(
        f"property({name},{value})" for name, value in settings.items() if value is not None
    )
    return f"{label}([{properties}]) 'rule:' {text}" if properties else f"{label} 'rule:' {text}"
