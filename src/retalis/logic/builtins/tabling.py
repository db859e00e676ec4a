"""Tabling: answers of a predicate are kept for each variant of a call, so that left recursion ends.

A call that is new is evaluated until no more answers come: calls of itself meanwhile see the answers found so
far, and where they have been looked at, the evaluation is repeated as long as it finds new ones (all calls
that depend on each other together). Everything runs as frames of the machine.
"""

from typing import Any, Dict, List, Optional

from ...terms import Functor, Term, copy, deref, functor, is_plain
from ...terms.keys import term_key
from ..machine import Code, Frame, Guard
from ..predicate import Predicate
from .clauses import _each
from .registry import control, deterministic

_ANSWER = functor("answer", 0)


class Table:
    """Answers to one variant of a call.

    Attributes:
        answers: instances of the call, in the order found.
        state: "new", "active", "waiting" (evaluated in this round of an older table, which decides whether
            there is another one) or "complete".
        low: position on the stack of active tables of the oldest one that it depends on.
        members: tables that can be complete only together with this one.
    """

    def __init__(self) -> None:
        self.answers: List[Term] = []
        self.known: Dict[Any, None] = {}
        self.state = "new"
        self.index = self.low = 0
        self.members: List[Table] = []
        self.consulted = False


class Tables:
    """All tables of a program, and the ones being evaluated."""

    def __init__(self, machine: Any):
        self.machine = machine
        self.by_call: Dict[Any, Table] = {}
        self.active: List[Table] = []
        self.added = 0
        self._guard = Guard("table", self._abandon)
        self._next = Code("table", lambda entry: self._enumerate(*entry[1:5]))

    def clear(self) -> None:
        """Forget all answers."""
        self.by_call.clear()
        self.active.clear()

    def call(self, predicate: Predicate, frame: Frame) -> Optional[Frame]:
        """Return the frame that gives the answers to a call."""
        goal = (predicate.functor, *map(deref, frame[1:-1]))
        after = frame[-1]
        key = term_key(goal)
        table = self.by_call.get(key)
        if table is None:
            table = self.by_call[key] = Table()
        if table.state == "complete":
            return self._enumerate(goal, table.answers, 0, after)
        if table.state != "new":
            at = table.index if table.state == "active" else table.low
            self.active[at].consulted = True
            for other in self.active[at:]:
                other.low = min(other.low, at)
            return self._enumerate(goal, list(table.answers), 0, after)
        return self._evaluate(predicate, goal, table, after)

    def _evaluate(self, predicate: Predicate, goal: Term, table: Table, after: Frame) -> Optional[Frame]:
        table.state = "active"
        table.index = table.low = len(self.active)
        table.members = []
        self.active.append(table)
        general = copy(goal)
        machine = self.machine
        machine.choices.append((self._guard, table.index, len(machine.trail)))
        return self._round(predicate, general, table, goal, after)

    def _round(
        self, predicate: Predicate, general: Term, table: Table, goal: Term, after: Frame
    ) -> Optional[Frame]:
        """Evaluate the clauses once; then again, or done."""
        before = self.added
        plain = predicate.tabled.functor
        template = general if len(general) > 1 else plain

        def then(found: List[Term]) -> Optional[Frame]:
            for answer in found:
                self._add(table, answer)
            del self.active[table.index + 1 :]
            if table.low < table.index:
                return self._hand_on(table, goal, after)
            if self.added > before and table.consulted:
                for member in table.members:
                    member.state = "new"
                table.members = []
                return self._round(predicate, general, table, goal, after)
            for member in (table, *table.members):
                member.state = "complete"
            return self._leave(table, goal, table.answers, after)

        call = (plain, *general[1:])
        return self.machine.logic.control.collect(call, (_ANSWER, *template[1:]), then)  # type: ignore[no-any-return]

    def _add(self, table: Table, answer: Term) -> None:
        key = term_key(answer)
        if key not in table.known:
            table.known[key] = None
            table.answers.append(answer)
            self.added += 1

    def _hand_on(self, table: Table, goal: Term, after: Frame) -> Optional[Frame]:
        """Leave a table that depends on an older one: that decides when both are complete."""
        parent = self.active[table.index - 1]
        parent.low = min(parent.low, table.low)
        for member in (table, *table.members):
            member.state = "waiting"
            member.low = table.low
            parent.members.append(member)
        return self._leave(table, goal, list(table.answers), after)

    def _leave(self, table: Table, goal: Term, answers: List[Term], after: Frame) -> Optional[Frame]:
        del self.active[table.index :]
        self.machine.choices.pop()  # the guard
        return self._enumerate(goal, answers, 0, after)

    def _enumerate(self, goal: Term, answers: List[Term], at: int, after: Frame) -> Optional[Frame]:
        machine = self.machine
        while at < len(answers):
            mark = len(machine.trail)
            answer = answers[at]
            if not is_plain(answer):
                answer = copy(answer)
            at += 1
            if machine.unify_all(*zip(goal[1:], answer[1:])):
                if at < len(answers):
                    machine.choices.append((self._next, goal, answers, at, after, mark))
                return after
        return None

    def _abandon(self, entry: Frame) -> None:
        """Forget evaluations that an error has ended."""
        for table in self.active[entry[1] :]:
            for member in (table, *table.members):
                member.state = "new"
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
    for key in _each(which):
        declare(machine, key)
    return True


def declare(machine: Any, key: Functor) -> None:
    """Make a predicate tabled: its clauses go to a hidden predicate that the tables call."""
    database = machine.logic.database
    predicate = database.writable(key, "modify")
    if predicate.tabled is not None:
        return
    hidden = database.predicate(functor(f"{key.name} tabled", key.arity))
    for clause in list(predicate.live()):
        hidden.add(clause)
    tables = tables_of(machine)
    predicate.table(hidden, lambda frame: tables.call(predicate, frame))
    database.forget()


@control("abolish_all_tables/0")
def abolish_all_tables(machine: Any, args: Any, after: Frame) -> Optional[Frame]:
    """Forget the answers of all tabled predicates."""
    tables = tables_of(machine)
    if not tables.active:
        tables.clear()
    return after
