"""Random rules and streams, for hypothesis and for long runs with a plain random generator.

Both draw with one function, ``choice(options)``, so that they generate the same kinds of cases. Rules have few
names, few variables and small integers, so that many events match.
"""

from dataclasses import dataclass, replace
from fractions import Fraction
from random import Random
from typing import Any, Callable, Dict, List, Optional, Sequence, Set, Tuple

from asserting_accessors import compound, name_of
from events.operator_table import EITHER_ORDER, INSTANTS, VALUELESS_AGGREGATES
from hypothesis import strategies as st

from retalis import Term, Var, atom, functor, list_items, make_list
from retalis.prolog.terms.term_traversal import variables
from retalis.prolog.terms.types import NIL

from .evaluator import run
from .goal_evaluator import show
from .matches import POLICIES, RESULTS
from .pattern_classes import (
    HELD,
    HELD_KINDS,
    NEGATIONS,
    STREAMED,
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
    pattern_variables,
    walk,
    with_own,
)
from .rule_notation import write_rule

Choice = Callable[[Any], Any]
Stream = List[Tuple[Term, int, int]]

REV = functor("rev", 1)
ARITY = {"a": 1, "b": 1, "c": 2, "d": 0}
NUMBERS = (0, 1, 1, 1, 2)
NEUTRAL = (
    ("rule_sharing,on",),
    ("etalis_justification,on",),
    ("revision_flag,on",),
    ("garbage_control,general", "garbage_window,100000", "garbage_window_step,1"),
    ("rule_sharing,on", "revision_flag,on", "etalis_justification,on"),
)
SHORT = 20
SPANS = (1, 2, 3, 5, Fraction(1, 2), Fraction(5, 2))
COMPARISONS = ("<", ">", "=<", ">=", "=:=", "=\\=", "==", "\\==")


def event_name(term: Term) -> str:
    """Return the name of an event: of an atom, or of the functor of a compound term."""
    return compound(term)[0].name if term.__class__ is tuple else name_of(term)


@dataclass(frozen=True)
class Case:
    """A program with its flags and a stream."""

    rules: Tuple[Rule, ...]
    policy: str
    out_of_order: bool
    stream: Tuple[Tuple[Term, int, int], ...]
    neutral: Tuple[str, ...] = ()
    """Other flags with their values, which change no event."""

    def expected(self, **options: Any) -> List[Tuple[str, Any, Any]]:
        """Return the events of the oracle."""
        return run(self.rules, self.stream, policy=self.policy, out_of_order=self.out_of_order, **options)

    def text(self, form: str = "V{}") -> str:
        """Return the text of the rules; ``form`` is the format of variable names."""
        return "\n".join(write_rule(rule, form) for rule in self.rules)

    def goals(self) -> str:
        """Return the goals that set the flags."""
        flags = [f"set_etalis_flag(event_consumption_policy,{self.policy})"]
        if self.out_of_order:
            flags.append("set_etalis_flag(out_of_order,on)")
        if self.revises():
            flags.append("set_etalis_flag(revision_flag,on)")
        flags += [f"set_etalis_flag({flag})" for flag in self.neutral]
        return "".join(f"{flag}.\n" for flag in flags)

    def revises(self) -> bool:
        """Return whether the stream retracts events."""
        return any(is_revision(term) for term, _, _ in self.stream)

    def policies(self) -> Set[str]:
        """Return the consumption policies of its rules."""
        return {self.policy, *(rule.policy_by(self.policy) for rule in self.rules)}

    def has_streams(self) -> bool:
        """Return whether the program has operators on streams, which depend on the clock."""
        return any(isinstance(node, STREAMED) for rule in self.rules for node in walk(rule.pattern))

    def has_limits(self) -> bool:
        """Return whether the program has a window or a within."""
        return any(
            rule.window is not None or any(isinstance(node, Within) for node in walk(rule.pattern))
            for rule in self.rules
        )

    def __repr__(self) -> str:
        events = " ".join(f"{show(term)}@{start}-{end}" for term, start, end in self.stream)
        flags = "".join(f" {flag}" for flag in [*["out_of_order"] * self.out_of_order, *self.neutral])
        return f"<{self.policy}{flags}\n{self.text()}\n{events}>"


def certain_in_order(node: Pattern) -> List[Var]:
    """Return the variables of `certain` in the order of the pattern."""
    bound = certain(node)
    return [var for var in pattern_variables(node) if var in bound]


def certain(node: Pattern) -> Set[Var]:
    """Return the variables that every match of a pattern binds."""
    if isinstance(node, Leaf):
        return set(variables(node.term))
    if isinstance(node, Or):
        return certain(node.left) & certain(node.right)
    if isinstance(node, Both):
        return certain(node.left) | certain(node.right)
    if isinstance(node, Star):
        return certain(node.first)
    if isinstance(node, Aggregate):
        return certain(node.first) | set(variables(node.result))
    if isinstance(node, Windowed):
        kinds = [word.partition("@")[0] for word in node.kinds.split()]
        results = zip(kinds, list_items(node.results) or [])  # lists are not compared as numbers
        return {var for kind, term in results for var in variables(term) if kind not in ("list", "distinct")}
    if isinstance(node, (*NEGATIONS, Within, Ntimes, Shaped, Awaited, Preceded, Instant)):
        return certain(node.pattern)
    if isinstance(node, Sub):
        return set(variables(node.head))
    return certain(node.pattern) | set(variables(node.goal))  # type: ignore[attr-defined]


def bindable(node: Pattern) -> List[Var]:
    """Return the variables that some match of a pattern binds."""
    if isinstance(node, (*NEGATIONS, Awaited, Preceded)):
        return bindable(node.pattern)
    return pattern_variables(node)


def has_steps(pattern: Pattern) -> bool:
    """Return whether a pattern has a window of steps, for which the oracle does not define the effect of limits."""
    return any(isinstance(node, Windowed) and node.window == "steps" for node in walk(pattern))


class Generator:
    """Generator of rules, streams and cases; ``choice`` makes all decisions."""

    def __init__(
        self,
        choice: Choice,
        revision: bool = False,
        unsure: bool = False,
        streams: bool = False,
        instants: bool = False,
        overlaps: bool = False,
    ) -> None:
        self.choice = choice
        self.are_numbers = False
        """Whether the conditions of steps may have aggregates of numbers."""
        self.overlaps = overlaps
        """Draw ``without``, too."""
        self.instants = instants
        """Draw instants of matches, too."""
        self.streams = streams
        """Draw windows, rate operators and absences with a deadline, too."""
        self.unsure = unsure
        """Draw also conditions on variables that some matches of a pattern leave unbound."""
        self.revision = revision
        """Draw only programs for which revision is defined, and retractions."""
        self.negating = False
        """Draw mostly absences, whose patterns contain absences, repetitions and conditions, too."""
        self.pool = [Var(), Var(), Var()]
        self.names: Dict[str, int] = dict(ARITY)
        self.subpatterns = 0

    def chance(self, percent: int) -> bool:
        """Return True with a probability in percent; hypothesis shrinks it to False."""
        return bool(self.choice([False] * (100 - percent) + [True] * percent))

    def known(self, node: Pattern) -> List[Var]:
        """Return variables of a pattern for conditions."""
        return bindable(node) if self.unsure and self.chance(60) else certain_in_order(node)

    # Patterns. ``left`` are the variables that patterns to the left are certain to bind, or may bind.

    def leaf(self, pool: Optional[List[Var]] = None) -> Leaf:
        """Draw a pattern of one event."""
        name = self.choice(list(self.names))
        shared = (pool or self.pool)[:3] * (4 if self.negating or self.unsure else 1)
        arguments = [
            self.choice([*shared, Var(), Var(), Var(), self.value(2)]) for _ in range(self.names[name])
        ]
        return Leaf(functor(name, len(arguments))(*arguments) if arguments else atom(name))

    def pattern(self, depth: int, left: Tuple[Var, ...] = ()) -> Pattern:  # noqa: C901 - a case for each kind of pattern
        """Draw a pattern up to a depth of operators."""
        if depth == 0 or self.chance(5 if self.negating else 15):
            return self.leaf()
        kinds = ["seq"] * 5 + ["and"] * 2 + [*EITHER_ORDER, "or", "where", "where", "check", "do", "multiply"]
        kinds += [
            "prolog",
            "cnot",
            "cnot",
            "fnot",
            "ntimes",
            "ntimes",
            "within",
            "star",
            "aggregate",
            "forall_seq",
        ]
        kinds += ["without", "without"] * (4 * self.overlaps)
        kinds += ["cnot", "fnot", "fnot", "where", "star", "aggregate"] * (3 * self.negating)
        kinds += [*INSTANTS] * (8 * self.instants)
        if self.streams:  # the timestamps of deadlines are no numbers
            kinds = [kind for kind in kinds if kind != "check"]
        kinds += ["windowed", "windowed", "shaped", "shaped", "awaited", "awaited"] * (2 * self.streams)
        kinds += ["preceded", "preceded"] * self.streams
        kind = self.choice([*kinds, "subpattern"])
        if kind in ("windowed", "shaped", "awaited", "preceded"):
            return getattr(self, kind)(depth, left)
        if kind in ("seq", "forall_seq", *EITHER_ORDER):
            first = self.pattern(depth - 1, left)
            return Both(kind, first, self.pattern(depth - 1, (*left, *self.known(first))))
        if kind == "or":
            return Or(self.pattern(depth - 1, left), self.pattern(depth - 1, left))
        if kind in ("star", "aggregate"):
            return self.repetition(kind, depth, left)
        if kind == "subpattern":
            return self.subpattern(min(depth - 1, 2))
        if kind == "ntimes":
            below = self.pattern(min(depth - 1, self.choice([0, 1, 1])))
            # unrestricted, the combinations grow with the power of the repetitions
            return Ntimes(below, self.choice([1, 2, 3, 3, 4, 5] if isinstance(below, Leaf) else [1, 2, 3]))
        if kind in ("do", "multiply"):
            below = self.pattern(depth - 1)
            if kind == "do":
                return Do(below, self.goal(below, (), binds=True))
            return Multiply(below, self.several(below))
        below = self.pattern(depth - 1, left)
        if kind in INSTANTS:
            return Instant(below, kind)
        if kind == "within":
            if has_steps(below):
                return below
            return Within(below, self.choice([1, 2, 3, 4, 6, Fraction(1, 2), Fraction(5, 2)]))
        if kind == "check":
            return Check(below, self.stamp_goal())
        if kind in ("cnot", "fnot", "without"):
            if kind == "without" and self.chance(40):
                below = Both(self.choice(["seq", "seq", "and"]), below, self.pattern(min(depth - 1, 1)))
            if kind == "cnot" and self.chance(60):
                below = Both("seq", below, self.pattern(min(depth - 1, 1)))
            absent = self.absent(below, left, min(depth - 1, 2))
            return {"cnot": Cnot, "fnot": Fnot, "without": Without}[kind](below, absent)
        goal = self.goal(below, left, binds=True)
        if kind == "prolog":
            return Prolog(below, goal, self.chance(30), self.choice(["prolog", "query", "db"]))
        return Where(below, goal)

    def revived(self, depth: int) -> Pattern:
        """Draw a sequence with a side that may return when an event is retracted."""
        below = self.pattern(min(depth - 1, 1)) if depth > 1 else self.leaf()
        kind = self.choice(["fnot", "cnot", "star", "aggregate"])
        if kind in ("star", "aggregate"):
            side = self.repetition(kind, 1, ())
        else:
            over = Both("seq", below, self.leaf()) if kind == "cnot" else below
            side = (Cnot if kind == "cnot" else Fnot)(over, self.absent(over, (), 0))
        other = self.leaf()
        kind = self.choice(["seq", "seq", "seq", "forall_seq", "star", "aggregate"])
        if kind == "star":
            return Star(side, other)
        if kind == "aggregate":
            return Aggregate(side, "count", None, other, Var())
        return Both(kind, side, other) if self.chance(70) else Both(kind, other, side)

    def repetition(self, kind: str, depth: int, left: Tuple[Var, ...]) -> Pattern:
        """Draw a star_times or an aggregate."""
        first = self.pattern(depth - 1, left)
        below = min(depth - 1, 1)
        further = (*left, *self.known(first))
        repeated: Pattern = self.leaf()
        if self.chance(30):
            repeated = self.pattern(below, further)
        elif self.chance(70 if self.negating else 30):
            repeated = Where(repeated, self.goal(repeated, further, binds=True, outer=70))
        if kind == "star":
            return Star(first, repeated)
        values = [var for var in variables_in_order(repeated) if var in certain(repeated)]
        which = self.choice([*RESULTS, "rate"] if values else ["count", "rate"])
        value = self.choice(values) if which not in VALUELESS_AGGREGATES else None
        return Aggregate(first, which, value, repeated, self.choice([Var(), Var(), Var(), 2]))

    def windowed(self, depth: int, left: Tuple[Var, ...]) -> Pattern:
        """Draw a window over a pattern."""
        below = self.pattern(self.choice([0, 0, 0, min(depth - 1, 1)]))
        bound = certain_in_order(below)
        kinds = [self.choice([*RESULTS, "rate"] if bound else ["count", "rate"])]
        kinds += [self.choice(["count", "list", "avg"] if bound else ["count"])] if self.chance(30) else []
        values = make_list([self.choice(bound) for kind in kinds if kind not in ("count", "rate")])
        results = make_list([self.choice([Var(), Var(), Var(), 2, self.choice(self.pool)]) for _ in kinds])
        window = self.choice(list(WINDOWS) if bound else [name for name in WINDOWS if name not in HELD])
        if window in HELD:
            kinds = [self.choice(HELD_KINDS) for _ in kinds]
            measured: List[Any] = [self.choice(bound) for _ in kinds]
            goals = [functor(self.choice(["<", ">"]), 2)(value, self.choice(NUMBERS)) for value in measured]
            values = make_list(
                [goal if kind == "duration" else value for kind, value, goal in zip(kinds, measured, goals)]
            )
        span: Any = self.choice([1, 2, 3] if window in ("newest", "batch", "running_batch") else SPANS)
        step = self.choice([span, span, *SPANS])
        if window == "bounded_session":
            step += span
        if window not in HELD and self.chance(25):
            steps = self.steps(bound)
            kinds = [
                f"{kind}@{self.choice(range(len(steps)))}" if self.chance(30) else kind for kind in kinds
            ]
            skip = self.skip(steps)
            return Windowed(
                kinds=" ".join(kinds),
                collected=below,
                values=values,
                results=results,
                window="steps",
                span=0,
                step=0,
                steps=make_list(steps),
                skip=skip,
            )
        return Windowed(" ".join(kinds), below, values, results, window, span, step)

    def steps(self, bound: List[Var], are_numbers: bool = False) -> List[Term]:
        """Draw the steps of a window with conditions of some variables."""
        self.are_numbers = are_numbers
        names = ["one", "two", "three"][: self.choice([1, 1, 2, 2, 3])]
        steps: List[Any] = []
        for name in names:
            least, more = self.choice([0, 1, 1, 2]), self.choice([0, 0, 1, "many"])
            most: Any = atom("many") if more == "many" else max(least + more, 1)
            until = [self.step_condition(bound, names)] if self.chance(20) else []
            reluctant = not until and self.chance(30)
            goals = [self.step_condition(bound, names)] if self.chance(75) else []
            later = self.chance(35)
            if (later or not goals) and most.__class__ is not int and not until:
                reluctant = True  # otherwise the step might never end
            steps.append(
                functor("step", 7)(
                    atom(name),
                    least,
                    most,
                    atom("reluctant" if reluctant else "greedy"),
                    atom("later" if later else "next"),
                    make_list(goals),
                    make_list(until),
                )
            )
        if not any(step[2] for step in steps):
            steps[0] = (*steps[0][:2], 1, *steps[0][3:])
        for position in range(len(steps) - 1, -1, -1):  # a later step at the end would wait for more
            if (
                steps[position][5].name == "later"
                and steps[position][2] != steps[position][3]
                and steps[position][7] is NIL
            ):
                steps[position] = (*steps[position][:4], atom("reluctant"), *steps[position][5:])
            if steps[position][2]:
                break
        return steps

    def grouped(self, steps: List[Any]) -> Term:
        """Return steps as a list, possibly with a group that the language accepts."""
        first = self.choice(range(len(steps)))
        last = self.choice(range(first, len(steps)))
        inside = steps[first : last + 1]
        # Steps that may be empty, or that later items may continue, need a step after the group that ends the match.
        is_ended = last < len(steps) - 1 and steps[-1][2] == steps[-1][3]
        is_simple = all(step[5].name == "next" and step[2] for step in inside)
        if not self.chance(60) or not (is_ended or (is_simple and all(step[2] for step in steps))):
            return make_list(steps)
        kinds = ["group", "group", "choice", "alternatives", "permutation"]
        kind = self.choice(kinds if all(step[2] for step in inside) else ["group", "choice", "alternatives"])
        parts = make_list(inside)
        if kind in ("alternatives", "permutation"):
            group = functor(kind, 1)(parts)
        else:
            least, more = self.choice([0, 1, 1, 2]), self.choice([0, 1, 2, "many"])
            has_conditions = any(step[6] is not NIL or step[7] is not NIL for step in inside)
            is_endless = more == "many" and is_simple
            most: Any = atom("many") if is_endless else max(least + (0 if more == "many" else more), 1)
            mode = "reluctant" if is_endless and not has_conditions else self.choice(["greedy", "reluctant"])
            least = max(least, 0 if is_ended else 1)
            if kind == "choice":
                parts = make_list([functor("alternatives", 1)(parts)])
            group = functor("group", 4)(parts, least, most, atom(mode))
        return make_list([*steps[:first], group, *steps[last + 1 :]])

    def skip(self, steps: List[Any]) -> str:
        """Draw where the next match begins."""
        strategy = self.choice(
            ["skip_past_last", "skip_past_last", "skip_to_next", "skip_to_first", "skip_to_last"]
        )
        if strategy in ("skip_past_last", "skip_to_next"):
            return strategy
        number = self.choice(range(len(steps)))
        least, most = steps[0][2], steps[0][3]
        if number == 0 and least and (strategy == "skip_to_first" or most == 1):
            return "skip_to_next"  # the other one would not end
        return f"{strategy}@{number}"

    def step_condition(self, bound: List[Var], names: List[str]) -> Term:
        """Draw a condition of a step without arithmetic; it may refer to earlier items."""
        if not bound:
            return atom(self.choice(["true", "true", "fail"]))
        var = self.choice(bound)
        if self.are_numbers and self.chance(10):
            stamp = atom(self.choice(["t1", "t2"]))
            earlier = functor(self.choice(["prev", "first", "last"]), 1)(stamp)
            if self.chance(50):
                earlier = functor(self.choice(["first", "last"]), 2)(
                    atom(self.choice([*names, "match"])), stamp
                )
            return functor(self.choice(["@<", "@>"]), 2)(earlier, self.choice(range(2, 12)))
        aggregates = ["sum", "avg", "min", "max", "avg"] if self.are_numbers else []
        kind = self.choice(
            ["prev", "prev", "prev", "first", "last", "value", "value", "of", "count", *aggregates]
        )
        if kind == "value":
            other: Term = self.value(2)
        elif kind == "count":
            counted = functor("count", 1)(atom(self.choice([*names, "match"])))
            return functor(self.choice(["==", "@<", "@>"]), 2)(counted, self.choice([1, 2, 3]))
        elif kind in aggregates:
            return self.aggregate_condition(kind, bound, names)
        elif kind == "prev":
            other = (
                functor("prev", 2)(var, self.choice([1, 2, 3]))
                if self.chance(50)
                else functor("prev", 1)(var)
            )
        elif kind == "of":
            other = functor(self.choice(["first", "last"]), 2)(atom(self.choice([*names, "match"])), var)
        else:
            other = functor(kind, 1)(var)
        goal = functor(self.choice(["==", "\\==", "@<", "@>", "@>"]), 2)(var, other)
        return functor(",", 2)(goal, self.step_condition(bound, names)) if self.chance(20) else goal

    def aggregate_condition(self, kind: str, bound: List[Var], names: List[str]) -> Term:
        """Draw a condition of a step with an aggregate of a variable, or in arithmetic of an expression."""
        value: Term = self.choice(bound)
        comparisons = ["==", "\\==", "@<", "@>", "@>"]
        if self.chance(40):
            value = functor(self.choice(["*", "-"]), 2)(value, self.choice([2, self.choice(bound)]))
            comparisons = ["<", ">", "=<"]
        name = self.choice(["", *names, "match"])
        aggregate = functor(kind, 2)(atom(name), value) if name else functor(kind, 1)(value)
        return functor(self.choice(comparisons), 2)(self.choice(bound), aggregate)

    def shaped(self, depth: int, left: Tuple[Var, ...]) -> Pattern:
        """Draw a pattern with matches that only partly continue."""
        below = self.pattern(self.choice([0, 0, min(depth - 1, 1)]))
        bound = certain_in_order(below)
        by = make_list([self.choice(bound)] if bound and self.chance(50) else [])
        shape = self.choice(
            ["throttle", "burst", "debounce", "change", "change_after_first"]
            if bound
            else ["throttle", "burst", "debounce"]
        )
        if shape in ("change", "change_after_first"):
            return Shaped(below, shape, 0, make_list([self.choice(bound)]), by)
        return Shaped(below, shape, self.choice(SPANS), make_list([]), by)

    def awaited(self, depth: int, left: Tuple[Var, ...]) -> Pattern:
        """Draw a pattern and its absence with a deadline."""
        below = self.pattern(min(depth - 1, self.choice([0, 0, 1, 2])), left)
        absent = self.absent(below, (), self.choice([0, 0, min(depth - 1, 1)]))
        bound = bindable(below)
        seconds = self.choice(bound) if bound and self.chance(40) else self.choice(SPANS)
        return Awaited(below, absent, seconds)

    def preceded(self, depth: int, left: Tuple[Var, ...]) -> Pattern:
        """Draw a pattern and its absence before it."""
        below = self.pattern(min(depth - 1, self.choice([0, 0, 1, 2])), left)
        absent = self.absent(below, (), self.choice([0, 0, min(depth - 1, 1)]))
        return Preceded(below, absent, self.choice(SPANS))

    def subpattern(self, depth: int) -> Sub:
        """Draw a named pattern."""
        self.subpatterns += 1
        below = self.pattern(depth)
        arguments = [var for var in pattern_variables(below) if var in certain(below) and self.chance(60)]
        name = f"s{self.subpatterns}"
        return Sub(functor(name, len(arguments))(*arguments) if arguments else atom(name), below)

    def absent(self, below: Pattern, left: Tuple[Var, ...], depth: int) -> Pattern:
        """Draw an absent pattern; its variables are those of the patterns before it, or its own.

        It may have operators, conditions over variables further left, and absences.
        """
        pool = [*[var for var in variables_in_order(below) if var in certain(below)][:2], Var()]
        if left and self.chance(75 if self.negating else 25):
            pool = [self.choice(left), *pool[-2:]]
        if depth == 0 or self.chance(15 if self.negating else 50):
            return self.leaf(pool)
        keep, self.pool = self.pool, (pool * 3)[:3]
        try:
            if not self.negating and self.chance(30):
                return Both(self.choice(["seq", "and", "par"]), self.leaf(), self.leaf())
            return self.pattern(depth, (*left, *self.known(below)))
        finally:
            self.pool = keep

    # Goals.

    def goal(self, below: Pattern, left: Tuple[Var, ...], binds: bool = False, outer: int = 30) -> Term:
        """Draw a condition over the variables of a pattern; ``outer`` percent also over those to its left."""
        own = self.known(below)
        further = [var for var in left if var not in own]
        usable = own + (further if further and self.chance(outer) else [])
        kind = self.choice(
            ["compare"] * 8 + ["true", "is", "is", "member", "not", "equal"] + ["fail"] * self.chance(20)
        )
        if kind == "true" or not usable:
            return atom("true")
        if kind == "fail":
            return atom("fail")
        variable = self.choice(usable)
        if kind == "is" and binds:
            return functor("is", 2)(Var(), functor("+", 2)(variable, 1))
        if kind == "member" and binds:
            return functor("member", 2)(self.choice([Var(), variable]), make_list([1, 2]))
        if kind == "equal":
            return functor("=", 2)(variable, self.choice(NUMBERS))
        test = functor(self.choice(COMPARISONS), 2)(variable, self.choice([*usable, *NUMBERS]))
        return functor("\\+", 1)(test) if kind == "not" else test

    def several(self, below: Pattern) -> Term:
        """Draw a goal with several solutions."""
        var = Var()
        member = functor("member", 2)(var, make_list([1, 2]))
        own = sorted(certain(below), key=pattern_variables(below).index)
        if own and self.chance(40):
            return functor(",", 2)(member, functor("=<", 2)(self.choice(own), var))
        if self.chance(30):
            return functor(";", 2)(functor("=", 2)(var, 1), functor("=", 2)(var, 0))
        return member

    def stamp_goal(self) -> Term:
        """Draw a goal about t1 and t2."""
        start, end = Var(), Var()
        both = functor(",", 2)
        if self.chance(25):
            test = functor(self.choice(["<", "=:=", ">="]), 2)(*self.choice([(start, end), (end, start)]))
        else:
            test = functor(self.choice(["<", ">="]), 2)(functor("-", 2)(end, start), self.choice([1, 2, 4]))
        return both(functor("t1", 1)(start), both(functor("t2", 1)(end), test))

    # Rules, streams, cases.

    def rule(self, head: str, depth: int, bound_only: bool = False) -> Rule:
        """Draw a rule whose head has some of the pattern's variables."""
        self.pool = [Var(), Var(), Var()]
        body = self.revived(depth) if self.revision and self.chance(30) else self.pattern(depth)
        usable = [var for var in dict.fromkeys(bindable(body)) if not bound_only or var in certain(body)]
        do = self.goal(body, (), binds=True) if self.chance(8) else None
        if do is not None and not bound_only:
            usable += [var for var in variables(do) if var not in usable]
        arguments = [var for var in usable if self.chance(70)]
        if bound_only:
            arguments = arguments[:1]
        term = functor(head, len(arguments))(*arguments) if arguments else atom(head)
        window = self.choice([None] * 12 + [1, 2, 4, 8, Fraction(3, 2)])
        window = None if has_steps(body) else window
        label = self.choice([None, f"r_{head}"]) if window is None else f"r_{head}"
        rule = Rule(term, body, label, window, do)
        return with_own(rule) if self.chance(50) else rule

    def value(self, percent: int = 5) -> Term:
        """Draw an argument of an event; ``percent`` of them are no integers."""
        return self.choice([1.5, atom("x")]) if self.chance(percent) else self.choice(NUMBERS)

    def stream(self, size: int, rules: Sequence[Rule]) -> Stream:
        """Draw events: in order of their ends, or some of them late; equal, touching and nested intervals."""
        leaves = [node.term for rule in rules for node in walk(rule.pattern) if isinstance(node, Leaf)]
        used_names = [event_name(term) for term in leaves]
        names = [name for name in used_names if name in ARITY] * 4 + list(ARITY)
        late = self.chance(50)
        events: Stream = []
        now = 10
        for _ in range(size):
            name = self.choice(names)
            arguments = [self.value() for _ in range(ARITY[name])]
            now += self.choice([0, 1, 1, 2, 3])
            end = now - self.choice([0, 0, 1, 3, 5]) if late else now
            start = end - self.choice([0, 0, 0, 1, 2, 4])
            if events and self.chance(50):
                start, end = self.related(*self.choice(events[-4:])[1:])
                if not late:
                    end = max(end, now)
                now = max(now, end)
            events.append(
                (functor(name, len(arguments))(*arguments) if arguments else atom(name), start, end)
            )
        if late and self.chance(30):  # some much later, after the windows of others have ended
            for _ in range(size // 3):
                events.append(events.pop(self.choice(range(size))))
        return events

    def related(self, start: int, end: int) -> Tuple[int, int]:
        """Draw an interval that equals, meets, starts, finishes or contains another one."""
        by = self.choice([1, 2])
        options = [
            (start, end),
            (end, end + by),
            (start, end + by),
            (start - by, end),
            (start - by, end + by),
        ]
        return self.choice(options)

    def with_revisions(self, stream: Stream) -> Stream:
        """Insert retractions of earlier events into a stream."""
        result: Stream = []
        for event in stream:
            result.append(event)
            while self.chance(25):
                term, start, end = self.choice(result)
                if "m" in self.names and self.chance(10):
                    arguments = [self.choice(NUMBERS) for _ in range(self.names["m"])]
                    term = functor("m", len(arguments))(*arguments) if arguments else atom("m")
                if not is_revision(term):
                    result.append((REV(term), event[2], event[2]))
        return result

    def case(self, depth: int = 4) -> Case:
        """Draw a program and a stream."""
        self.negating = self.chance(15)
        deep = [2, 3, 3, 4] if self.negating else [0, 1, 1, 2, 2, 2, 3, 3, 4, 4]
        rules = [self.rule("out", min(depth, self.choice(deep)))]
        if self.chance(25):
            rules = [self.rule("m", self.choice([1, 2]), bound_only=True)]
            self.names["m"] = len(rules[0].head) - 1 if rules[0].head.__class__ is tuple else 0
            rules.append(self.rule("out", self.choice(range(1, max(2, depth)))))
            if self.chance(20):
                rules.reverse()
        stream = self.stream(self.choice([*range(4), *range(4, 30), *range(10, 30)]), rules)
        if self.revision:
            stream = self.with_revisions(stream)
        policy, late = self.choice(POLICIES), self.chance(30)
        neutral = self.choice([(), *NEUTRAL])
        case = Case(tuple(self.with_properties(rule) for rule in rules), policy, late, tuple(stream), neutral)
        # rules that are drawn for another policy may have too many combinations
        return (
            replace(case, stream=case.stream[:SHORT])
            if "unrestricted" in case.policies() - {policy}
            else case
        )

    def with_properties(self, rule: Rule) -> Rule:
        """Draw the properties of a rule's label; they are drawn last, so that they do not change the rest."""
        if not self.chance(40):
            return rule
        return replace(
            rule,
            label=f"r_{event_name(rule.head)}",
            policy=self.choice([None, *POLICIES]),
            out_of_order=self.choice([None, None, False, True, True]),
            after_match=self.choice(["keep", "skip_past_last", "skip_to_next"]),
        )


def is_revision(term: Term) -> bool:
    """Return whether an event is a retraction."""
    return term.__class__ is tuple and term[0] is REV


def variables_in_order(node: Pattern) -> List[Var]:
    """Return the variables of a pattern from left to right."""
    return pattern_variables(node)


@st.composite
def drawn_cases(draw: Any, depth: int = 4, revision: bool = False) -> Case:
    """Programs with streams, drawn by hypothesis piece by piece; with ``revision``, some events are retracted."""
    return Generator(lambda options: draw(st.sampled_from(list(options))), revision).case(depth)


def cases(
    depth: int = 4,
    revision: bool = False,
    unsure: bool = False,
    streams: bool = False,
    instants: bool = False,
    overlaps: bool = False,
) -> st.SearchStrategy[Case]:
    """Programs with streams, drawn as the number of a case.

    Their rules fire more often than those drawn step by step; `comparison.shrink` makes them small.
    """
    return st.integers(0, 10**9).map(
        lambda seed: random_case(seed, depth, revision, unsure, streams, instants, overlaps)
    )


def random_case(
    seed: int,
    depth: int = 4,
    revision: bool = False,
    unsure: bool = False,
    streams: bool = False,
    instants: bool = False,
    overlaps: bool = False,
) -> Case:
    """Return the case of a seed."""
    return Generator(Random(seed).choice, revision, unsure, streams, instants, overlaps).case(depth)
