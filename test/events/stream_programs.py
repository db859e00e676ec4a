"""Helper that runs programs over short streams; ``a@1 b(2)@3-5`` denotes a stream, and the derived events."""

from retalis import Engine, Settings, StreamClock, functor
from retalis.prolog.syntax.term_writer import write_term
from retalis.prolog.terms.term_traversal import copy, variables
from retalis.prolog.terms.timestamps import SECOND

FUTURE = 1_000_000 * SECOND


def text_of(term):
    term = copy(term)
    for number, var in enumerate(variables(term)):
        var.ref = (functor("$VAR", 1), number)
    return write_term(term, None, quoted=True, ignore_ops=True, numbervars=True)


def seconds(text):
    return float(text) if "." in text else int(text)


class Program:
    """A program; ``feed`` gives what followed from a stream, without the stream itself."""

    def __init__(self, rules="", flags=(), policy=None, clock=None, folder=None):
        settings = Settings() if folder is None else Settings(folders=[folder])
        self.engine = Engine(clock or StreamClock(FUTURE), settings)
        self.errors, self.warnings, self.seen = [], [], []
        self.engine.rules.on_error = lambda error: self.errors.append(error)
        self.engine.rules.on_warning = lambda error: self.warnings.append(error)
        self.engine.on_event(lambda *event: self.seen.append(event))
        if policy:
            self.set("event_consumption_policy", policy)
        for flag in flags:
            self.set(*flag) if isinstance(flag, tuple) else self.set(flag, "on")
        if rules:
            self.engine.load(rules=rules)

    def set(self, flag, value):
        assert self.engine.call(f"set_etalis_flag({flag},{value})")

    def feed(self, stream):
        found = []
        for item in stream.split():
            term, stamp = item.rsplit("@", 1)
            start, _, end = stamp.partition("-")
            del self.seen[:]
            self.engine.event(term, seconds(start), seconds(end or start))
            found += self.seen[1:]
        return show(found)


def show(events):
    return " ".join(
        f"{text_of(term)}@{start / SECOND:.12g}-{end / SECOND:.12g}" for term, start, end in events
    )


def fired(rules, stream, policy=None, flags=()):
    """Return what a program fires over a stream."""
    return Program(rules, flags, policy).feed(stream)
