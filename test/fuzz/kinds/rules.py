"""Texts of rule files, and events for their rules."""

from typing import Any, Tuple

from events.operator_table import AGGREGATES, AGGREGATES_WITH_SETTINGS, PAIRS, VALUELESS_AGGREGATES

from ..mutate import mutate_text, random_tokens, to_bytes, to_text
from .base import ARGUMENTS, LOGGED, Kind, create_silent_engine

PIECES: Tuple[str, ...] = (
    " <- ",
    " or ",
    " where ",
    " within ",
    " cnot ",
    " fnot ",
    " without ",
    " do ",
    " check ",
    " star_times",
    " ntimes 3",
)
PIECES += tuple(f" {name} " for name in PAIRS)
PIECES += (
    " event_multiply ",
    "aggregate(sum(X),b(X),S)",
    "prolog(true)",
    " : ",
    ":- ",
    ". ",
    "a(X)",
    "b(Y)",
    "c",
)
PIECES += (
    ":- dynamic f/1. ",
    "-->",
    "label([property(a,b)])",
    "X",
    "_",
    "(",
    ")",
    ",",
    "|",
    "\\+",
    "!",
    " is ",
    "1",
)
PIECES += (
    "set_etalis_flag(out_of_order,on)",
    "assertz(",
    ":- op(700,xfx,",
    "retract(",
    "findall(X,",
    ":- timer(a(X),every(1)). ",
    "timer(c,after(2))",
    ":- state(h(X),from(a(X)),until(b(_))). ",
    "holds(h(X),T)",
    "0'",
    "->",
    ";",
)
SIDES = (*PAIRS, "or", "cnot", "fnot", "without")
GOALS: Tuple[str, ...] = (
    "where X > 1",
    "where (Y = X, foo(Y))",
    "within 3",
    "check t1(S)",
    "do write(X)",
    "star_times",
    "ntimes 2",
)
GOALS += (
    "event_multiply member(Z, [X,1])",
    "where \\+ foo(X)",
    "where X is Y + 1",
    "timestamp (t2(E), E > 0)",
    "ntimes X",
    "do timer(c, after(X))",
    "where holds(h(X))",
    "do state(h(X, Y), from(a(X)), until(b(Y)))",
)
KINDS = (
    "list(f(X,Y))",
    "quantile(0.9,X)",
    "fold(foo,foo,foo,X)",
    *VALUELESS_AGGREGATES,
    *(f"{name}(X)" for name in AGGREGATES if name not in (*VALUELESS_AGGREGATES, *AGGREGATES_WITH_SETTINGS)),
)
STREAMS = (
    "aggregate(count, {0}, S, last(2))",
    "aggregate([median(X), list(X)], {0}, S, last(3, events))",
    "aggregate(avg(X), {0}, S, every(2))",
    "aggregate(rate, {0}, S, last(4, every(2)))",
    "aggregate(fold(foo, foo, foo, X), {0}, S, running(every(2, first)))",
    "aggregate(list(X), {0}, S, session(2))",
    "aggregate(count, {0}, S, session(1, max(3)))",
    "aggregate([avg(X), duration(X > 1)], {0}, S, held(every(2)))",
    "aggregate([min(X), last(X)], {0}, S, held(last(2), max(1)))",
    "({0} seq absent(b(X), 2))",
    "({0} seq absent(b(X), Y))",
    "({0} with not_preceded(b(X), 2))",
    "({0} with throttle(2, X))",
    "({0} with debounce(1))",
    "({0} with burst(1))",
    "({0} with change(X))",
    "({0} with change_after_first(X))",
    "at_end({0})",
    "at_start({0})",
)
EVENTS = ("a(1)", "b(2)", "c", "a(b(3))")


class Inputs(Kind):
    block_size = 8
    may_read_files = True  # a program that is loaded may name any file

    def reset(self) -> None:
        self.engine = create_silent_engine()
        self.time = 0

    def generate(self, rng: Any) -> bytes:
        if rng.random() < 0.1:
            return to_bytes(random_tokens(rng, PIECES))
        if rng.random() < 0.4:
            return to_bytes("".join(self.rule(rng) for _ in range(rng.choice((1, 1, 2, 3)))))
        return to_bytes(mutate_text(rng, rng.choice(self.texts), self.texts, PIECES))

    def rule(self, rng: Any) -> str:
        """Return a rule that reads well, more often than not."""
        head = rng.choice(("h(X)", "h(X, Y)", "h", "a(X)", "h do foo(X)", "h do assertz(seen(X))", "'H'(Y)"))
        label = rng.choice(("", "", "", "l : ", "l([property(event_rule_window, 5)]) : "))
        return f"{label}{head} <- {self.pattern(rng, rng.choice((1, 2, 2, 3)))}.\n"

    def pattern(self, rng: Any, depth: int) -> Any:
        if not depth or rng.random() < 0.1:
            return rng.choice(("a(X)", "b(Y)", "a(_)", "b(X)", "c", f"a({rng.choice(ARGUMENTS)})"))
        left = self.pattern(rng, depth - 1)
        draw = rng.random()
        if draw < 0.65:
            return f"({left} {rng.choice(SIDES)} {self.pattern(rng, depth - 1)})"
        if draw < 0.9:
            return f"({left} {rng.choice(GOALS)})"
        if draw < 0.95:
            return f"({left} seq aggregate({rng.choice(KINDS)}, {self.pattern(rng, 0)}, S))"
        return rng.choice(STREAMS).format(left)

    def run(self, data: Any) -> None:
        self.attempt(self.engine.load_rules, to_text(data))
        for event in EVENTS:
            self.time += 1
            self.attempt(self.engine.event, event, self.time)
        LOGGED.check()
