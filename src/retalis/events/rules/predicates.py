"""The goals of the event language: rules, flags, files, streams, stored events."""

from typing import Any, Callable, Dict, Hashable, Iterator, List, Optional, Sequence, Tuple

from ...foundation import Errors, ProgramErrors, SyntaxFault, UsageError
from ...prolog.builtins import callable_of
from ...prolog.logic import Logic
from ...prolog.machine import (
    Frame,
    Machine,
    PrologError,
    domain_error,
    existence_error,
    instantiation_error,
    type_error,
)
from ...prolog.syntax import read_program
from ...prolog.terms import (
    CONS,
    Atom,
    String,
    Term,
    Values,
    Var,
    atom,
    copy,
    deref,
    freeze,
    from_any,
    functor,
    interval_term,
    list_items,
    make_list,
    resolve,
    shown,
    undo,
)
from ..history import solutions
from .flags import FLAGS

_EVENT1 = functor("event", 1)
_EVENT2 = functor("event", 2)


def define_predicates(rules: Any) -> None:
    """Define all goals of the event language for a program's rules."""
    logic = rules.logic
    _RuleGoals(rules).define(logic)
    _FlagGoals(rules).define(logic)
    _FiringGoals(rules).define(logic)
    _ListingGoals(rules).define(logic)


def _path(term: Term) -> str:
    term = deref(term)
    if term.__class__ is Var:
        raise instantiation_error()
    if term.__class__ not in (Atom, String):
        raise type_error("atom", term)
    return str(term.name if term.__class__ is Atom else term.text)


def _items(term: Term) -> List[Term]:
    items = list_items(term)
    if items is None:
        raise type_error("list", term)
    return items


def _interval(term: Term) -> Tuple[int, int]:
    """Return the interval of ``[T1,T2]``.

    Raises:
        PrologError: where it is none, or reversed.
    """
    stamps = list_items(term)
    if stamps is None or len(stamps) != 2:
        raise type_error("interval", term)
    try:
        start, end = from_any(stamps[0]), from_any(stamps[1])
    except UsageError:
        raise type_error("datime", term) from None
    if end < start:
        raise domain_error("interval", term)
    return start, end


def _each(machine: Machine, terms: Sequence[Term], found: Iterator[Tuple[Term, ...]]) -> Iterator[bool]:
    """Unify terms with one solution after the other."""
    for solution in list(found):
        mark = len(machine.trail)
        if all(machine.unify(term, value) for term, value in zip(terms, solution)):
            yield True
        undo(machine.trail, mark)


class _RuleGoals:
    """Goals that add and delete rules."""

    def __init__(self, rules: Any):
        self.rules = rules

    def define(self, logic: Logic) -> None:
        logic.define("ins_event_rule", 1, self.insert)
        logic.define("del_event_rule", 1, self.delete)
        logic.define("del_all_event_rules", 1, self.delete_by_head)
        for name in ("compile_event_file", "compile_events"):
            logic.define(name, 1, self.load_file)
        logic.define("consult", 1, self.consult)
        logic.define("[|]", 2, lambda machine, name, more: self.consult(machine, (CONS, name, more)))
        logic.define("use_module", 1, self.use)
        logic.define("use_module", 2, lambda machine, name, imports: self.use(machine, name))
        logic.define("ensure_loaded", 1, self.ensure_loaded)
        logic.define("compile_event_rules", 1, self.load_terms)
        logic.define("compile_event_rules", 2, lambda machine, module, terms: self.load_terms(machine, terms))
        logic.define("reset_db", 0, self.reset_db)
        logic.define("call_gc", 0, self.reset_db)
        logic.define("reset_etalis_state", 0, self.reset_state)
        logic.define("reset_etalis", 0, self.reset)

    def insert(self, machine: Machine, rule: Term) -> bool:
        return bool(self.rules.insert(callable_of(rule)))

    def delete(self, machine: Machine, rule: Term) -> bool:
        self.rules.delete(callable_of(rule))
        return True

    def delete_by_head(self, machine: Machine, head: Term) -> bool:
        self.rules.delete_by_head(callable_of(head))
        return True

    def load_file(self, machine: Machine, path: Term) -> bool:
        self.rules.loader.load_file(_path(path))
        return True

    def consult(self, machine: Machine, names: Term) -> bool:
        found = list_items(names)
        for name in [names] if found is None else found:
            self.rules.loader.use(name, once=False)
        return True

    def use(self, machine: Machine, name: Term) -> bool:
        self.rules.loader.use(name, once=False)
        return True

    def ensure_loaded(self, machine: Machine, name: Term) -> bool:
        self.rules.loader.use(name, once=True)
        return True

    def load_terms(self, machine: Machine, terms: Term) -> bool:
        self.rules.load_terms([(term, None) for term in _items(terms)])
        return True

    def reset_db(self, machine: Machine) -> bool:
        for rule in self.rules.rules:
            rule.clear_matches()
        return True

    def reset_state(self, machine: Machine) -> bool:
        for rule in self.rules.rules:
            rule.clear()
        self.rules.store.clear()
        self.rules.tracker.clear()
        return True

    def reset(self, machine: Machine) -> bool:
        self.rules.reset()
        return True


class _FlagGoals:
    """Goals that set and read flags and counters."""

    def __init__(self, rules: Any):
        self.rules = rules
        self.counters: Dict[Hashable, int] = {}
        self.values: Dict[Hashable, Term] = {}

    def define(self, logic: Logic) -> None:
        logic.define("set_etalis_flag", 2, self.set_flag)
        logic.define_nondeterministic("get_etalis_flag", 2, self.get_flag)
        logic.define("incCounter", 1, self.increase)
        logic.define("counter", 2, self.count)
        logic.define("resetCounter", 1, self.reset_counter)
        logic.define("set_flag", 2, self.set_value)
        logic.define("get_flag", 2, self.get_value)

    def set_flag(self, machine: Machine, name: Term, value: Term) -> bool:
        name, value = callable_of(name), deref(value)
        if value.__class__ is Var:
            raise instantiation_error()
        if name.__class__ is not Atom:
            raise domain_error("etalis_flag", name)
        try:
            self.rules.flags.set(name.name, value)
        except UsageError as error:
            if self.rules.flags.get(name.name) is None:
                raise domain_error("etalis_flag", name, error.message) from None
            raise domain_error("etalis_flag_value", (functor("+", 2), name, value), error.message) from None
        return True

    def get_flag(self, machine: Machine, name: Term, value: Term) -> Iterator[bool]:
        name = deref(name)
        names = list(FLAGS) if name.__class__ is Var else [name.name if name.__class__ is Atom else ""]
        for one in names:
            found = self.rules.flags.get(one)
            if found is None:
                raise existence_error("etalis_flag", name)
            mark = len(machine.trail)
            if machine.unify(name, atom(one)) and machine.unify(value, found):
                yield True
            undo(machine.trail, mark)

    def increase(self, machine: Machine, name: Term) -> bool:
        key = _key(name)
        self.counters[key] = self.counters.get(key, 0) + 1
        return True

    def count(self, machine: Machine, name: Term, value: Term) -> bool:
        return bool(machine.unify(value, self.counters.get(_key(name), 0)))

    def reset_counter(self, machine: Machine, name: Term) -> bool:
        self.counters.pop(_key(name), None)
        return True

    def set_value(self, machine: Machine, name: Term, value: Term) -> bool:
        key, value = _key(name), copy(value)
        if value is _NO_VALUE:
            self.values.pop(key, None)
        else:
            self.values[key] = value
        return True

    def get_value(self, machine: Machine, name: Term, value: Term) -> bool:
        return bool(machine.unify(value, copy(self.values.get(_key(name), _NO_VALUE))))


_NO_VALUE = atom("nil")


def _key(term: Term) -> Hashable:
    try:
        return freeze(deref(term))
    except ValueError:
        raise instantiation_error() from None


class _FiringGoals:
    """Goals that fire events: one, a list, a file."""

    def __init__(self, rules: Any):
        self.rules = rules

    def define(self, logic: Logic) -> None:
        logic.define_control("event", 1, self.event, at_once=True)
        logic.define_control("event", 2, self.event, at_once=True)
        logic.define_control("fire_event_list", 1, self.fire_list)
        logic.define_control("fire_event_list_return_external_events", 2, self.fire_and_return)
        logic.define_control("execute_event_stream_file", 1, self.execute_file)
        logic.define("exists_file", 1, self.exists)

    def event(self, machine: Machine, arguments: Sequence[Term], after: Frame) -> Optional[Frame]:
        """Dispatch an event, with the interval given or stamped by the clock."""
        term = callable_of(arguments[0])
        interval: Optional[Term] = arguments[1] if len(arguments) == 2 else None
        if interval is None and term.__class__ is tuple and term[0] is _EVENT2:
            interval = term[2]
            term = callable_of(term[1])
        if interval is None:
            start = end = self.rules.clock.stamp()
        else:
            start, end = _interval(interval)
        found: Frame = self.rules.dispatcher.dispatch(term, start, end, after, own=False)
        return found

    def fire_list(self, machine: Machine, arguments: Sequence[Term], after: Frame) -> Optional[Frame]:
        goals = list_items(arguments[0])
        if goals is None:
            self.rules.on_warning(
                UsageError("fire_event_list takes a list; what it was given is fired as a single event")
            )
            goals = [callable_of(arguments[0])]
        return self._each([copy(goal) for goal in goals], after)

    def fire_and_return(self, machine: Machine, arguments: Sequence[Term], after: Frame) -> Optional[Frame]:
        goals = [(_EVENT1, copy(item)) for item in _items(arguments[0])]
        if not machine.unify(arguments[1], make_list([])):
            return None
        return self._each(goals, after)

    def exists(self, machine: Machine, name: Term) -> bool:
        files = self.rules.files
        return bool(files.is_file(files.resolve(_path(name))))

    def execute_file(self, machine: Machine, arguments: Sequence[Term], after: Frame) -> Optional[Frame]:
        files = self.rules.files
        path = files.resolve(_path(arguments[0]))
        text = files.text(path)
        goals: List[Term] = []
        errors = Errors()
        for read in read_program(text, self.rules.logic.operators, str(path)):
            if isinstance(read, SyntaxFault):
                errors.append(read)
            else:
                goals.append(read.term)
        if errors:
            raise ProgramErrors(errors)
        return self._each(goals, after)

    def _each(self, goals: Sequence[Term], after: Frame) -> Optional[Frame]:
        """Return the frame that calls the goals in order; what fails or raises is reported, and the rest goes on."""
        stream = _Stream(self.rules, goals)
        return stream.run((stream, after))


class _Stream:
    """Code of a frame that calls the goals that are left."""

    def __init__(self, rules: Any, goals: Sequence[Term]):
        self.rules = rules
        self.goals = iter(goals)
        self.machine: Machine = rules.logic.machine
        query = Var()
        self.call = rules.logic.compile_goal((functor("call", 1), query), [query], [])

    def run(self, frame: Frame) -> Optional[Frame]:
        for goal in self.goals:
            found: Optional[Frame] = self.machine.attempt(
                self.call, (goal,), self._done(frame), (_FAILED, self, goal, frame), self._raised(goal)
            )
            return found
        last: Frame = frame[1]
        return last

    def _done(self, frame: Frame) -> Callable[[Values], Frame]:
        return lambda outputs: frame

    def _raised(self, goal: Term) -> Callable[[PrologError], None]:
        def report(error: PrologError) -> None:
            self.goals = iter([_RAISED, *self.goals])
            text = self.rules.logic.show(goal)
            self.rules.on_error(UsageError(f"{text} in an event stream: {error.message}"))

        return report


_RAISED: Any = object()


class _Failed:
    """Code of the frame for a goal of a stream that failed (or raised, which is reported already)."""

    @staticmethod
    def run(frame: Frame) -> Frame:
        after: Frame
        _, stream, goal, after = frame
        left = list(stream.goals)
        if left and left[0] is _RAISED:
            stream.goals = iter(left[1:])
        else:
            stream.goals = iter(left)
            text = stream.rules.logic.show(goal)
            stream.rules.on_error(UsageError(f"{text} in an event stream fails"))
        return after


_FAILED = _Failed()


class _ListingGoals:
    """Goals that look at what is there."""

    def __init__(self, rules: Any):
        self.rules = rules

    def define(self, logic: Logic) -> None:
        logic.define("t1", 1, lambda machine, instant: self.checked(machine, instant, 0))
        logic.define("t2", 1, lambda machine, instant: self.checked(machine, instant, 1))
        logic.define_nondeterministic("fired_event", 2, self.fired)
        logic.define_nondeterministic("stored_event", 1, self.stored)
        self.rules.store.define()
        logic.define("see_db", 0, self.see)
        logic.define_nondeterministic("justify_event", 3, self.justify)
        logic.define_nondeterministic("justification_edge", 2, self.edges)
        logic.database.predicate(functor("event_rule_property", 3)).dynamic = True

    def checked(self, machine: Machine, instant: Term, at: int) -> bool:
        interval = self.rules.under_way.checked
        return interval is not None and bool(machine.unify(instant, shown(interval[at])))

    def fired(self, machine: Machine, event: Term, interval: Term) -> Iterator[bool]:
        return solutions(self.rules.store.stored(), machine, event, interval)

    def stored(self, machine: Machine, event: Term) -> Iterator[bool]:
        found = self.rules.store.stored()
        stored = [((_EVENT2, term, interval_term(start, end)),) for term, start, end in found]
        return _each(machine, (event,), iter(stored))

    def justify(self, machine: Machine, event: Term, interval: Term, why: Term) -> Iterator[bool]:
        found = self.rules.justifier.explanations(resolve(event), resolve(interval))
        return _each(machine, (event, interval, why), found)

    def edges(self, machine: Machine, head: Term, body: Term) -> Iterator[bool]:
        return _each(machine, (head, body), self.rules.justifier.edges())

    def see(self, machine: Machine) -> bool:
        logic = self.rules.logic
        for rule in self.rules.rules:
            logic.output(f"{rule.name}: {rule.waiting} partial matches\n")
        return True
