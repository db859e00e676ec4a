"""Rules that join, measure and repeat, with many partners under all policies, and events that make them work."""

from time import process_time
from typing import Any, List

from events.operator_table import PAIRS

from retalis import Limits, Settings

from ..mutate import mutate_text, to_bytes, to_text
from ..side_effects import FindingError
from .base import LOGGED, Kind, create_silent_engine

MARK = "\n%%\n"
"""Separates the program of an input from its events: lines of a time and an event."""

MAX_EVENTS = 25
MAX_EVENT_SECONDS = 1.0
"""Maximum CPU time of one event in seconds, 20 times its limit."""

SETTINGS = Settings(
    limits=Limits(seconds=0.05, inferences=10_000, megabytes=30), max_depth=20, queue=100, folders=()
)

POLICIES = ("recent", "recent_2", "chronological", "chronological_2", *("unrestricted",) * 4)
JOINS = (*PAIRS, "seq", "and", "or", "cnot", "fnot")
AFTER_MATCH = ("skip_past_last", "skip_to_next", "skip_to_first", "skip_to_last", "no_skip")
MEASURES = (
    "count",
    "sum({0})",
    "min({0})",
    "max({0})",
    "avg({0})",
    "list(f({0},Y))",
    "[first({0}), last({0})]",
)
WINDOWS = ("last(3)", "last(3, events)", "every(2)", "every(3, events)", "running", "last(4, every(2))")
STEPS = (
    "steps([up where {0} > 0, dn(2) where {0} < 0])",
    "steps([up(1, many) where {0} > prev({0}), later(dn) where {0} < 0])",
    "steps([x(0, many, until({0} > 2)) where {0} > 0, later(y(1, 2, reluctant)) where {0} < 2])",
    "steps([up(0, 1, reluctant), dn(1, 2) where {0} =:= 1])",
)
FLAGS = (
    "set_etalis_flag(out_of_order, on)",
    "set_etalis_flag(revision_flag, on)",
    "set_etalis_flag(etalis_justification, on)",
    "set_etalis_flag(garbage_control, off)",
)
CHAIN = tuple(zip("cdefgijk", "acdefgij"))
"""Heads and events of a chain of rules: each rule processes the events of the previous one."""
ALIVE = "\nalive_(X) <- ping_(X).\n"
"""Added to each program: whatever its events have used up, the next event works."""
VALUES = ("0", "1", "1", "2", "-1", "2.5", "x", "_", "f(Z, Z)", "nan", "[1, 2]", "'\"t\"'")


class Inputs(Kind):
    block_size = 1
    seconds = 5.0  # of all events together
    may_read_files = True  # a program that is loaded may name any file

    def setup(self) -> None:
        self.large = "[" + ",".join(f"p({number},[{number}.5,a])" for number in range(300)) + "]"

    def reset(self) -> None:
        self.engine = create_silent_engine(SETTINGS)

    def generate(self, rng: Any) -> bytes:
        if self.texts and rng.random() < 0.1:
            return to_bytes(mutate_text(rng, rng.choice(self.texts), self.texts, VALUES + JOINS))
        policy = rng.choice(POLICIES)
        lines = [f":- set_etalis_flag(event_consumption_policy, {policy})."]
        lines += [f":- {flag}." for flag in FLAGS if rng.random() < 0.15]
        lines += [self.rule(rng) for _ in range(rng.choice((1, 1, 2, 3)))]
        if rng.random() < 0.1:  # as many events as limits allow
            lines += [
                f"{head}(X) <- {operand}(X) {rng.choice(('and', 'seq'))} {operand}(_)."
                for head, operand in CHAIN
            ]
        return to_bytes("\n".join(lines) + MARK + "\n".join(self.events(rng)))

    def rule(self, rng: Any) -> str:
        """Return a rule; some heads are events of other rules, or of the rule itself."""
        head = rng.choice(("h(X)", "h(X, Y)", "h(X, Y)", "a(X)", "b(f(X))"))
        properties: List[Any] = []
        if rng.random() < 0.2:
            properties.append(f"property(policy, {rng.choice(POLICIES)})")
        if rng.random() < 0.2:
            properties.append(f"property(after_match, {rng.choice(AFTER_MATCH)})")
        if rng.random() < 0.2:
            properties.append("property(event_rule_window, 5)")
        label = f"l{rng.randrange(99)}([{', '.join(properties)}]) : " if properties else ""
        pattern = self.pattern(rng, rng.choice((1, 2, 2, 3)))
        return f"{label}{head} <- {pattern}."

    def pattern(self, rng: Any, depth: Any) -> str:
        if not depth:
            return f"{rng.choice('aabc')}({rng.choice('XXYYZ_')})"
        draw = rng.random()
        if draw < 0.6:
            left, right = (self.pattern(rng, depth - 1 - rng.randrange(depth)) for _ in range(2))
            return f"({left} {rng.choice(JOINS)} {right})"
        inner = self.pattern(rng, depth - 1)
        if draw < 0.68:
            return f"({inner} within {rng.choice((1, 3, 60))})"
        if draw < 0.76:
            return f"({inner} where {rng.choice(('X = Y', 'X > 0', 'number(X)', chr(92) + '+ X = 1'))})"
        if draw < 0.82:
            return f"({inner} {rng.choice(('star_times', 'ntimes 2', 'ntimes 5'))})"
        if draw < 0.92:
            window = rng.choice((*WINDOWS, *STEPS)).format("X")
            measure = rng.choice(MEASURES).format("X")
            return f"aggregate({measure}, {rng.choice(('a(X)', 'a(X, Y)', 'b(X)', inner))}, S, {window})"
        stream = ("({0} seq absent(b(X), 2))", "({0} with throttle(2, X))", "({0} with change(X))")
        return rng.choice(stream).format(inner)

    def events(self, rng: Any) -> Any:
        """Return lines of events: values repeat, so that many are partners of each other."""
        now = 1.0
        is_repeating = rng.random() < 0.5  # the same event again and again: all pairs join
        lines: List[Any] = []
        sent: List[Any] = []
        for _ in range(rng.randint(5, MAX_EVENTS)):
            now += rng.choice((0, 0, 0.5, 1, 1, 10))
            draw = rng.random()
            if sent and draw < 0.08:
                lines.append(f"{now} rev({rng.choice(sent)})")
                continue
            value = "1" if is_repeating else self.large if draw > 0.97 else rng.choice(VALUES)
            more = f", {rng.choice(VALUES)}" if rng.random() < 0.1 else ""
            event = f"{rng.choice('aabc')}({value}{more})"
            sent.append(event)
            late = now - rng.choice((0.5, 3, 100)) if rng.random() < 0.1 else now
            lines.append(f"{max(0.0, late)} {event}")
        return lines

    def subject(self, data: Any) -> str:
        return "unrestricted" if b"unrestricted" in data else "other policies"

    def run(self, data: Any) -> None:
        program, _, events = to_text(data).partition(MARK)
        self.attempt(self.engine.load, program + ALIVE)
        seen: List[Any] = []
        self.engine.on_event(lambda term, start, end: seen.append(term))
        is_loaded = any("alive_" in rule.text for rule in self.engine.status().rules)
        for line in events.splitlines()[:MAX_EVENTS]:
            time, _, event = line.partition(" ")
            try:
                instant = float(time)
            except ValueError:
                continue
            before = process_time()
            self.attempt(self.engine.event, event, instant)
            duration = process_time() - before
            if duration > MAX_EVENT_SECONDS:
                raise FindingError("time", f"{duration:.1f} s for {event[:80]}", "one event")
        del seen[:]
        self.attempt(self.engine.event, "ping_(1)", 1000.0)
        if is_loaded and self.engine.query("X = alive_(1)")[0]["X"] not in seen:
            raise FindingError("difference", "the event after the others fires no rule", "next event")
        self.attempt(self.engine.query, "memory_size(_, _)")
        LOGGED.check()
