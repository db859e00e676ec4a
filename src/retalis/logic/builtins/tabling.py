"""Tabling: answers of a predicate are kept for each variant of a call, so that left recursion ends.

A call that is new is evaluated until no more answers come: calls of itself meanwhile see the answers found so
far, and where they have been looked at, the evaluation is repeated as long as it finds new ones (all calls
that depend on each other together). Everything runs as frames of the machine.

An answer is what the call's unbound variables stand for, in the order in which they are met. A call that finds
them gives its variables these values, which cannot fail: nothing is unified.
"""

from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

from ...terms import (
    SLASH,
    Atom,
    Functor,
    String,
    Term,
    Var,
    conjunction,
    copy,
    deref,
    functor,
    is_plain,
    unify,
    variables,
)
from ...terms.keys import term_key
from ..codes import Code, Frame, Guard
from ..faults import uninstantiation_error
from ..predicate import Predicate
from .arguments import indicator_of
from .clauses import declared
from .modes import Mode, modes_of
from .registry import control, deterministic

_ANSWER = functor("answer", 0)
_PLAIN = frozenset((Atom, int, String))
"""Kinds of terms that are their own keys."""

Call = Callable[[Frame], Optional[Frame]]


class Table:
    """Answers to one variant of a call.

    Attributes:
        answers: values of the call's variables, in the order found.
        known: the answers' keys, with their positions.
        ground: whether no answer has a variable.
        state: "new", "active", "waiting" (evaluated in this round of an older table, which decides whether
            there is another one) or "complete".
        low: position on the stack of active tables of the oldest one that it depends on.
        members: tables that can be complete only together with this one.
        consulted: whether a call has been given answers of this table while it was active.
    """

    __slots__ = ("answers", "known", "ground", "state", "index", "low", "members", "consulted")

    def __init__(self) -> None:
        self.state = "new"
        self.index = self.low = 0
        self.members: Sequence[Table] = ()
        self.consulted = False
        self.empty()

    def empty(self) -> None:
        """Forget the answers."""
        self.answers: List[Tuple[Term, ...]] = []
        self.known: Dict[Any, int] = {}
        self.ground = True


class Tables:
    """All tables of a program, and the ones being evaluated."""

    def __init__(self, machine: Any):
        self.machine = machine
        self.by_call: Dict[Any, Table] = {}
        self.active: List[Table] = []
        self.added = 0
        self._guard = Guard("table", self._abandon)
        self._round = Code("table", self._end_of_round)
        self._next = Code("table", lambda entry: self._enumerate(*entry[1:6]))
        self._answer = Code("answer", self._add)
        self._better = Code("answer", self._improve)
        self._kept = Code("answer", self._keep)
        self._moded = Code("table", lambda frame: frame[3] if machine.unify_all(*zip(*frame[1:3])) else None)

    def clear(self) -> None:
        """Forget all answers."""
        self.by_call.clear()
        self.active.clear()

    def mend(self) -> None:
        """Forget all evaluations that are not over: nothing is evaluated."""
        self.active.clear()
        for table in self.by_call.values():
            if table.state != "complete":
                table.state = "new"
                table.empty()

    def moded_caller(self, predicate: Predicate, modes: Dict[int, Mode]) -> Call:
        """Return the function that does calls of a predicate some of whose arguments have modes."""
        plain = self.caller(predicate, list(modes.values()))

        def call(frame: Frame) -> Optional[Frame]:
            inner = list(frame)
            for at in modes:
                value = deref(frame[at])
                if value.__class__ is not Var:
                    raise uninstantiation_error(value)
                inner[at] = Var()
            given, fresh = [frame[at] for at in modes], [inner[at] for at in modes]
            inner[-1] = (self._moded, given, fresh, frame[-1])
            return plain(tuple(inner), fresh)

        return call

    def caller(self, predicate: Predicate, modes: Sequence[Mode] = ()) -> Any:
        """Return the function that does calls of a predicate, given the variables of arguments with modes."""
        key_of_call = predicate.functor
        find = self.by_call.get
        bound = self.machine.trail.append

        def call(frame: Frame, moded: Sequence[Var] = ()) -> Optional[Frame]:
            key: Any = [key_of_call]
            free: List[Var] = []
            for arg in frame[1:-1]:
                while arg.__class__ is Var and arg.ref is not None:
                    arg = arg.ref
                if arg.__class__ in _PLAIN:
                    key.append(arg)
                elif arg.__class__ is Var and arg not in free:
                    free.append(arg)
                    key.append(None)
                else:  # a key that takes a walk
                    goal = (key_of_call, *frame[1:-1])
                    key = term_key(goal)
                    free = variables(goal)
                    break
            else:
                key = tuple(key)
            table = find(key)
            if table is None:
                table = self.by_call[key] = Table()
            elif table.state == "complete":
                if len(table.answers) != 1 or not table.ground:
                    return self._enumerate(table.answers, table.ground, 0, free, frame[-1])
                for var, value in zip(free, table.answers[0]):
                    var.ref = value
                    bound(var)
                return frame[-1]  # type: ignore[no-any-return]
            if table.state == "new":
                collect: Frame = (self._answer, table, free)
                if modes:
                    collect = (self._better, table, free, list(map(free.index, moded)), modes)
                return self._evaluate((predicate.tabled, *frame[1:-1], collect), table, free, frame[-1])
            return self._consult(table, free, frame[-1])

        return call

    def _consult(self, table: Table, free: List[Var], after: Frame) -> Optional[Frame]:
        """Give the answers of a table that is not complete: all on the stack from there on depend on it."""
        at = table.index if table.state == "active" else table.low
        self.active[at].consulted = True
        for other in self.active[at:]:
            other.low = min(other.low, at)
        return self._enumerate(list(table.answers), table.ground, 0, free, after)

    def _evaluate(self, clauses: Frame, table: Table, free: List[Var], after: Frame) -> Frame:
        """Evaluate the clauses once, with the caller's variables: all bindings are undone in the end."""
        machine = self.machine
        active = self.active
        index = len(active)
        mark = len(machine.trail)
        machine.choices.append((self._guard, index, self.added, mark))
        table.index = table.low = index
        table.members = ()
        table.consulted = False
        active.append(table)
        table.state = "active"
        machine.choices.append((self._round, table, clauses, free, after, self.added, mark))
        return clauses

    def _add(self, frame: Frame) -> None:
        """Note an answer, and look for the next one."""
        _, table, free = frame
        answer: Any = []
        for var in free:
            value = var.ref
            while value.__class__ is Var and value.ref is not None:
                value = value.ref
            if value.__class__ not in _PLAIN:
                whole = copy((_ANSWER, *free))
                key = term_key(whole)
                answer = whole[1:]
                break
            answer.append(value)
        else:
            key = answer = tuple(answer)
        if key not in table.known:
            table.known[key] = len(table.answers)
            table.answers.append(answer)
            self.added += 1
            if key is not answer and table.ground:
                table.ground = all(map(is_plain, answer))

    def _improve(self, frame: Frame) -> Optional[Frame]:
        """Note an answer of a table with modes, or what is better of it and the one that is there."""
        _, table, free, places, modes = frame
        answer = copy((_ANSWER, *free))[1:]
        key = term_key((_ANSWER, *[value for at, value in enumerate(answer) if at not in places]))
        at = table.known.get(key)
        if at is None:
            table.known[key] = len(table.answers)
            table.answers.append(answer)
            self.added += 1
            table.ground = table.ground and all(map(is_plain, answer))
            return None
        kept = list(answer)
        goals = []
        for place, mode in zip(places, modes):
            old, new = table.answers[at][place], answer[place]
            if mode.pick is not None:
                kept[place] = mode.pick(old, new)
            else:
                kept[place] = Var()
                goals.append(mode.goal(old, new, kept[place]))
        grows = any(mode.grows for mode in modes)
        after = (self._kept, table, at, kept, grows)
        return self.machine.logic.control.once(conjunction(goals), after) if goals else after

    def _keep(self, frame: Frame) -> None:
        """Put an answer in the place of another."""
        _, table, at, kept, grows = frame
        answer = copy((_ANSWER, *kept))
        if term_key(answer) != term_key((_ANSWER, *table.answers[at])):
            table.answers[at] = answer[1:]
            table.ground = table.ground and is_plain(answer)
            self.added += grows

    def _end_of_round(self, entry: Frame) -> Optional[Frame]:
        """Evaluate the clauses again, or be done."""
        _, table, clauses, free, after, before, mark = entry
        if table.low < table.index:
            self._hand_on(table)
        elif table.consulted and self.added > before:
            for member in table.members:
                member.state = "new"
            table.members = ()
            self.machine.choices.append((self._round, table, clauses, free, after, self.added, mark))
            return clauses  # type: ignore[no-any-return]
        else:
            for member in (table, *table.members):
                member.state = "complete"
                member.known.clear()
        del self.active[table.index :]
        self.machine.choices.pop()  # the guard
        answers = table.answers if table.state == "complete" else list(table.answers)
        return self._enumerate(answers, table.ground, 0, free, after)

    def _hand_on(self, table: Table) -> None:
        """Leave a table that depends on an older one: that decides when both are complete."""
        parent = self.active[table.index - 1]
        parent.low = min(parent.low, table.low)
        members = [table, *table.members]
        for member in members:
            member.state = "waiting"
            member.low = table.low
        parent.members = [*parent.members, *members]

    def _enumerate(
        self, answers: List[Tuple[Term, ...]], ground: bool, at: int, free: List[Var], after: Frame
    ) -> Optional[Frame]:
        """Give variables the values of an answer; the next ones on backtracking."""
        count = len(answers)
        if at == count:
            return None
        trail = self.machine.trail
        answer = answers[at]
        if at + 1 < count:
            self.machine.choices.append((self._next, answers, ground, at + 1, free, after, len(trail)))
        if not ground:
            for var, value in zip(free, copy((_ANSWER, *answer))[1:]):
                unify(value, var, trail)  # cannot fail; of two variables the caller's stays
            return after
        for var, value in zip(free, answer):
            var.ref = value
            trail.append(var)
        return after

    def _abandon(self, entry: Frame) -> None:
        """Forget evaluations that an error has ended, and that they found anything."""
        self.added = entry[2]
        for table in self.active[entry[1] :]:
            for member in (table, *table.members):
                member.state = "new"
                member.empty()
        del self.active[entry[1] :]


def tables_of(machine: Any) -> Tables:
    """Return the tables of a machine's program."""
    found: Optional[Tables] = machine.logic.state.get("tables")
    if found is None:
        found = machine.logic.state["tables"] = Tables(machine)
    return found


@deterministic("table/1")
def table_declaration(machine: Any, which: Term) -> bool:
    """Declare predicates tabled."""
    for item in declared(which):
        if item.__class__ is tuple and item[0].name == ":" and len(item) == 3:
            item = deref(item[2])
        if item.__class__ is tuple and item[0] is not SLASH:
            declare(machine, *modes_of(item))
        else:
            declare(machine, indicator_of(item), {})
    return True


def declare(machine: Any, key: Functor, modes: Dict[int, Mode]) -> None:
    """Make a predicate tabled: its clauses go to a hidden predicate that the tables call."""
    database = machine.logic.database
    predicate = database.writable(key, "modify")
    if predicate.tabled is not None:
        return
    hidden = database.predicate(functor(f"{key.name} tabled", key.arity))
    for clause in list(predicate.live()):
        hidden.add(clause)
    tables = tables_of(machine)
    predicate.table(hidden, tables.moded_caller(predicate, modes) if modes else tables.caller(predicate))
    database.forget()


@control("abolish_all_tables/0")
def abolish_all_tables(machine: Any, args: Any, after: Frame) -> Optional[Frame]:
    """Forget the answers of all tabled predicates."""
    tables = tables_of(machine)
    if not tables.active:
        tables.clear()
    return after
