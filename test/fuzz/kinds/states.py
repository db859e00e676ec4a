"""States with changed values, references, and lengths and right checksums, changed bytes, and pieces left out."""

from time import process_time
from typing import Any, List

from retalis import Engine, Functor, RetalisError, String, UsageError, Var, atom, functor
from retalis.prolog.terms.timestamps import FloatSeconds
from retalis.serialization.codec import Ref, from_bytes, to_bytes
from retalis.serialization.state_file_format import pack_sections, unpack_sections

from ..mutate import NUMBERS, mutate_bytes
from ..side_effects import FindingError
from .base import LOGGED, SETTINGS, Kind, create_silent_engine

PROGRAMS = (
    (
        """
ab(X, Y) <- a(X) seq b(Y).
both(X) <- (a(X) and c(X)) within 60.
many(S) <- a(_) seq aggregate(sum(X), b(X), S).
lot([property(policy, unrestricted)]) : unless(X) <- (a(X) seq c(_)) cnot b(X).
""",
        "memorize(a(X), [], X, as, 10)\nsubscribe(ab(_,_), [], _, t, s)\nmemorize(c(X), [number(X)], got(X), cs, 3)",
    ),
    (
        """
:- dynamic f/1. :- table r/2 as incremental. :- dynamic e/2 as incremental. :- op(700, xfx, near).
f(1). f("text"). f(2.5) :- \\+ f(3). e(1, 2). r(X, Y) :- e(X, Y). r(X, Z) :- r(X, Y), e(Y, Z).
n(N) <- aggregate(count, a(X), N, last(3, events)).
up(N) <- aggregate(list(X), a(X), N, steps([up where X > 0, later(dn) where X < 0])).
s(X) <- a(X) seq absent(b(_), 2).
d(X) <- (a(X) with throttle(2, X)).
:- state(h(X), from(a(X)), until(b(_))).
""",
        "set_etalis_flag(out_of_order, on)\nnb_setval(k, f(_, [1, 2]))\ntimer(c(1), after(30))",
    ),
    (
        """
p(X, Y) <- a(X) seq b(Y).
q(X) <- p(X, _) seq c(_).
m(L) <- a(_) seq (b(_) star_times).
pose(X) <- prev(as, X, _, _, [1, 0]) where true.
""",
        "set_etalis_flag(revision_flag, on)\nset_etalis_flag(event_consumption_policy, chronological)\n"
        "memorize(a(X), [], X, as, 5)\nsubscribe(q(_), [], _, t, s)",
    ),
    (
        """
w(N, S) <- aggregate([count, sum(X)], a(X) where number(X), [N, S], last(30)).
e(X, N) <- aggregate(count, a(X), N, every(4)).
g(N) <- aggregate(max(X), a(X) where number(X), N, every(6, first)).
h(N) <- aggregate(median(X), a(X) where number(X), N, last(6, every(2))).
held(A, D) <- aggregate([avg(X), duration(X > 1)], a(X) where number(X), [A, D], held(last(6, every(2)), max(9))).
last(A) <- aggregate(min(X), a(X) where number(X), A, held(last(6))).
z(X) <- (a(X) with debounce(3, X)).
k(X, Y) <- (a(X) with change(X)) seq b(Y).
l(X, Y) <- (b(X) seq c(Y)) fnot a(X).
r(X) <- (a(X) ntimes 3) within 30.
o(X) <- a(X) or b(X).
ask(X) <- c(X) seq b(_).
syncronized(found(X, Y), prev(as, Y, _, _, 99), [[as, 99]]) <- c(X).
x(L) <- c(_) seq aggregate(list(X), b(X), L).
""",
        "memorize(a(X), [], X, as, 5)\nsubscribe((a(X) with throttle(5, X)), [], _, t, s)\n"
        "subscribe((b(X) with debounce(5)), [], _, t, u)",
    ),
    (
        """
w(N, S) <- aggregate([count, sum(X)], a(X) where number(X), [N, S], last(30)).
r(X) <- a(X) ntimes 3.
x(L) <- c(_) seq aggregate(list(X), b(X), L).
z(X) <- (a(X) with debounce(3, X)).
t(N) <- aggregate(count, a(X), N, steps([up where X > 0, later(dn) where X < 0])).
n(X, Y) <- (c(X) seq b(Y)) cnot a(X).
alarm(X) <- a(X) seq absent(b(X), 4).
""",
        "set_etalis_flag(revision_flag, on)\nmemorize(a(X), [], X, as, 5)\nmemorize(tf(_, _), [], _, tfs, 100)",
    ),
)
EVENTS = ("a(1)", "b(2)", "a(-1)", "c(1)", "a(f(Z, Z))", "b(1)", "a(2)")
LATER_EVENTS = ("b(7)", "c(2)", "a(1)", "rev(b(7))", "b(2)", "a(f(_))", "a(3)", "rev(a(2))", "c(1)", "a(-2)")
MAX_LATER_EVENTS = 100
"""Number of events that a restored engine processes."""

MAX_EVENTS_SECONDS, MAX_DERIVED_EVENTS = 0.5, 1000
"""CPU time in seconds, and number of derived events, after which it gets no further events."""

PATIENT_SETTINGS = SETTINGS._replace(limits=SETTINGS.limits._replace(seconds=10.0))
"""Settings for a snapshot of the package itself, which on a busy machine may take longer than an input may."""

QUERIES = (
    "memory_size(M, N)",
    "r(X, Y)",
    "f(X)",
    "holds(h(X))",
    "nb_getval(k, X)",
    "e(X, Y), assertz(e(Y, 5))",
)


def nested_lists(number: int) -> Any:
    """Return a list that is nested to a depth."""
    nested: List[Any] = []
    for _ in range(number):
        nested = [nested]
    return nested


class Inputs(Kind):
    """An input is the state itself."""

    block_size = 40
    may_warm_up = False

    def setup(self) -> None:
        self.states = []
        for rules, goals in PROGRAMS:
            engine = create_silent_engine()
            engine.load(rules, goals)
            for now, event in enumerate(EVENTS, 1):
                engine.event(event, now)
            for number in range(60 if "tfs" in goals else 0):  # enough records to be stored by columns
                engine.event(f"tf(a{number % 3}, v({number}.5, {number}))", 8 + number / 100)
            self.states.append(unpack_sections(engine.snapshot()).sections)
        LOGGED.logged_error = None
        self.whole = [pack_sections(state) for state in self.states]
        self.sections = [(state, name) for state in self.states for name in state]
        self.values: List[Any] = [
            1,
            -1,
            1 << 70,
            0.5,
            float("nan"),
            None,
            True,
            "",
            "text",
            b"",
            [],
            (),
            {},
            atom("a"),
        ]
        self.values += [(functor("f", 1), 1), (functor("f", 2), 1), [1], (1, 2, 3), *NUMBERS]
        self.values += [Var(), String("s"), functor("f", 1), FloatSeconds(5), float("inf"), -1e300, 10**400]
        self.values += [
            Ref(0),
            Ref(1),
            Ref(1 << 20),
            1 << 63,
            -(1 << 63),
            1 << 80,
            [[]] * 50,
            nested_lists(100),
            "\0",
        ]
        self.shared = {(name, arity): functor(name, arity) for name in "abcf" for arity in range(3)}

    def generate(self, rng: Any) -> Any:
        draw = rng.random()
        if draw < 0.05:
            whole = rng.choice(self.whole)
            return whole[: rng.randrange(len(whole))]
        state, name = rng.choice(self.sections)
        if draw < 0.15:
            return mutate_bytes(rng, pack_sections(state), self.whole)
        if draw < 0.3:
            changed = mutate_bytes(rng, state[name], [state[name]])
            return pack_sections(dict(state, **{name: changed}))
        if draw < 0.35:
            other = rng.choice(self.states)
            return pack_sections(dict(state, **{name: other.get(name, b"")}))
        data = from_bytes(state[name])
        for _ in range(rng.choice((1, 1, 1, 2))):
            data = self.changed(rng, data, self.places(data))
        return pack_sections(dict(state, **{name: to_bytes(data)}))

    def places(self, data: Any, path: Any = (), paths: Any = None) -> Any:
        """Return the paths to all values."""
        paths = [] if paths is None else paths
        paths.append(path)
        if isinstance(data, (list, tuple)):
            for position, item in enumerate(data):
                self.places(item, (*path, position), paths)
        elif isinstance(data, dict):
            for key, item in data.items():
                self.places(item, (*path, key), paths)
        return paths

    def changed(self, rng: Any, data: Any, places: Any) -> Any:
        """Return data in which one value is replaced."""
        path = rng.choice(places[1:] or places)
        return self.put(data, path, lambda old: self.other(rng, old))

    def other(self, rng: Any, old: Any) -> Any:
        """Return a value for another: of the same type, or of any."""
        draw = rng.random()
        if old.__class__ is int and draw < 0.5:
            return old + rng.choice((-1, 1, 1000, -old - 1))
        if old.__class__ is Ref and draw < 0.7:
            return Ref(max(0, old.number + rng.choice((-2, -1, 1, 2, -old.number, 5))))
        if old.__class__ is Functor and draw < 0.5:
            return rng.choice((functor(old.name, old.arity + 1), functor("f", 1), functor("a", 1)))
        if old.__class__ is str and draw < 0.5:
            return rng.choice((old + "x", old[1:], "no_such", "'"))
        if isinstance(old, (list, dict)) and old and draw < 0.5:
            if isinstance(old, list):
                return rng.choice((old[1:], old[:-1], old + old[:1], old + old, old[::-1], old[:1] * 1000))
            return dict(list(old.items())[1:])
        return rng.choice(self.values)

    def put(self, data: Any, path: Any, change: Any) -> Any:
        if not path:
            return change(data)
        head, tail = path[0], path[1:]
        if isinstance(data, dict):
            return {**data, head: self.put(data[head], tail, change)} if head in data else data
        if not isinstance(data, (list, tuple)) or head.__class__ is not int or head >= len(data):
            return data
        items = list(data)
        items[head] = self.put(items[head], tail, change)
        if isinstance(data, list):
            return items
        try:
            return data.__class__(*items) if hasattr(data, "_fields") else tuple(items)
        except Exception:  # a named tuple that checks its values
            return data

    def run(self, data: Any) -> None:
        try:
            engine = self.restored(data)
        except UsageError as error:
            str(error)
            self.refused_count += 1
            self.check_shared()
            LOGGED.logged_error = None
            return
        if engine is None:
            return
        engine.logic.output = engine.logic.error_output = lambda text: None
        self.check_shared()
        before = process_time()
        derived: List[Any] = []
        engine.on_event(lambda *event: derived.append(None))
        for now in range(MAX_LATER_EVENTS):
            # A rule that derives its own events is a valid program: each event then uses its whole limit.
            if process_time() - before > MAX_EVENTS_SECONDS or len(derived) > MAX_DERIVED_EVENTS:
                break
            self.attempt(engine.event, LATER_EVENTS[now % len(LATER_EVENTS)], 10 + now / 4)
        for query in QUERIES:
            self.attempt(engine.query, query, 5)
        engine.status()
        LOGGED.check()
        try:
            snapshot = engine.snapshot()
            Engine.restore(snapshot, settings=PATIENT_SETTINGS)
        except RetalisError as error:
            raise FindingError(
                "difference", f"the state of the restored engine: {error}"[:300], "states"
            ) from error
        LOGGED.check()

    def restored(self, data: Any) -> Engine:
        """Return an engine that is restored from an input, or None if the input has no state."""
        return Engine.restore(data, settings=SETTINGS)

    def check_shared(self) -> None:
        """Check that the process is as before: all engines share functors."""
        for (name, arity), kind in self.shared.items():
            if (kind.name, kind.arity) != (name, arity) or kind is not functor(name, arity):
                kind.name, kind.arity = name, arity
                raise FindingError("difference", f"the functor {name}/{arity} is another one", "states")
