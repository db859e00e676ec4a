"""Tabling (SLG resolution): storage of the answers of a predicate for each call variant.

Left-recursive predicates terminate with it. The first call of a variant, the *generator*, evaluates the clauses on a
copy of the call, and stores each new answer in a table. A call of a table that is still being evaluated is a
*consumer*: it returns the stored answers, and is then suspended. A suspended consumer is stored as its continuation
frame and the bindings made since the evaluation began, as in copying implementations of SLG (CAT), and is resumed
when an answer is added.

Tables that depend on each other form a strongly connected component (SCC). As in Tarjan's algorithm, each table has
an index on the stack of active tables and the lowest index that it depends on. The tables of an SCC are completed
together, by its oldest table (the leader), when all consumers have returned all answers.

Inside negation, ``findall/3``, ``catch/3`` and similar constructs a consumer cannot be suspended, because its
continuation ends inside the construct. If such a consumer has missed answers, the leader repeats the evaluation of
the whole SCC until no answer is added (iterated fixpoint). All evaluation runs as frames of the machine, without
recursion.

*Incremental tables* record the dynamic predicates, memories and states that they read, with the version at the first
read. A table inherits the reads of complete incremental tables that it calls, and the tables of an SCC share their
reads. A later call compares the versions and evaluates the table again if one differs. So a change costs nothing, and
neither do tables that are not incremental.

*Moded tables* (answer subsumption) keep one answer for each combination of the other arguments: the one that is best
in the arguments with modes, such as ``min`` or ``lattice(PI)``.

An answer holds the values of the call's unbound variables in the order of their first occurrence. Returning it binds
these variables, which cannot fail, so no unification is needed.
"""

from typing import Any, Callable, Dict, Hashable, List, NamedTuple, Optional, Sequence, Set, Tuple

from ..compiler.clause_nodes import ARROW, SEMICOLON
from ..database.predicate import Predicate
from ..machine.errors import (
    domain_error,
    instantiation_or_type_error,
    uninstantiation_error,
)
from ..machine.machine import Code, Guard
from ..terms.list_terms import conjunction
from ..terms.term_traversal import SELF_KEYED, copy, has_no_variables, term_key, variables
from ..terms.types import SLASH, Atom, CompoundTerm, Frame, Functor, Term, Values, Var, atom, deref, functor
from ..terms.unification import compare, unify
from .argument_checks import natural
from .builtin_registry import ProgramMachine

_EQUAL = functor("=", 2)
_LATTICE, _ORDER = functor("lattice", 1), functor("po", 1)

ChooseValue = Callable[[Term, Term], Term]
_STANDARD_MODES: Dict[str, ChooseValue] = {
    "first": lambda old, new: old,
    "-": lambda old, new: old,
    "last": lambda old, new: new,
    "min": lambda old, new: old if compare(old, new) <= 0 else new,
    "max": lambda old, new: old if compare(old, new) >= 0 else new,
}


class Mode(NamedTuple):
    """Mode of an argument of a moded table: how the values of two answers are combined.

    Attributes:
        choose_value: returns the old or the new value; None if a predicate of the program decides.
        make_goal: returns the goal that computes the third value from the first two; None with ``choose_value``.
        notifies_consumers: whether a changed value is returned to consumers, because it may lead to further answers.
            It is False for mode ``last``: its value may change with every answer, so the evaluation might not end.
    """

    choose_value: Optional[ChooseValue] = None
    make_goal: Optional[Callable[[Term, Term, Term], Term]] = None
    notifies_consumers: bool = True


def parse_moded_head(spec: CompoundTerm) -> Tuple[Functor, Dict[int, Mode]]:
    """Return the functor of a declaration such as ``path(_, _, min)``, and its modes by argument position.

    Raises:
        PrologError: a domain error for an unknown mode.
    """
    modes = {}
    for position, mode in enumerate(spec[1:], 1):
        mode = deref(mode)
        if mode.__class__ is Var or (mode.__class__ is Atom and mode.name in ("index", "+")):
            continue
        modes[position] = _parse_mode(mode)
    return spec[0], modes


def _parse_mode(mode: Term) -> Mode:
    if mode.__class__ is Atom and mode.name in _STANDARD_MODES:
        return Mode(_STANDARD_MODES[mode.name], notifies_consumers=mode.name != "last")
    if mode.__class__ is not tuple or mode[0] not in (_LATTICE, _ORDER):
        raise domain_error("tabled_mode", mode)
    arity = 3 if mode[0] is _LATTICE else 2
    key = functor(_parse_predicate_name(mode[1], arity), arity)
    if arity == 3:
        return Mode(make_goal=lambda old, new, combined: (key, old, new, combined))
    return Mode(
        make_goal=lambda old, new, combined: (
            SEMICOLON,
            (ARROW, (key, old, new), (_EQUAL, combined, old)),
            (_EQUAL, combined, new),
        )
    )


def _parse_predicate_name(predicate: Term, arity: int) -> str:
    """Return the name of the predicate of ``lattice(PI)`` or ``po(PI)``: PI is a name, an indicator or a head."""
    name: Any = deref(predicate)
    if name.__class__ is tuple and name[0].name == ":" and len(name) == 3:
        name = deref(name[2])
    declared_arity = arity
    if name.__class__ is tuple and name[0] is SLASH:
        name, declared_arity = deref(name[1]), natural(name[2])
    elif name.__class__ is tuple:
        name, declared_arity = name[0], name[0].arity
    # `lattice(PI)` needs a predicate of arity 3, `po(PI)` one of arity 2.
    if declared_arity != arity:
        raise domain_error("lattice_arity" if arity == 3 else "po_arity", declared_arity)
    if name.__class__ not in (Atom, Functor):
        raise instantiation_or_type_error("atom", name)
    return str(name.name)


VersionOf = Callable[[Hashable], object]
"""Returns a value that differs after each change of a part of a source: a predicate, the memories or the states."""

Reads = Dict[Tuple[VersionOf, Hashable], object]
"""Parts of sources that an evaluation has read, with their versions at the first read."""

_CHANGED = object()
"""Version of a part that has changed between two reads of an evaluation; it is equal to no other version."""


class Consumer(NamedTuple):
    """A suspended call of an incomplete table.

    Attributes:
        position: number of answers that it has returned.
        free_vars: unbound variables of the call.
        bindings: variables bound since the evaluation of the active table began, with their values; None if the call
            cannot be suspended.
        height: size of the stack of choice points at the suspension; cuts in the continuation depend on it.
    """

    position: int
    free_vars: List[Var]
    continuation: Frame
    bindings: Optional[List[Tuple[Any, Term]]]
    height: int


class Table:
    """The answers to one call variant, and the state of their evaluation.

    Attributes:
        answers: values of the call's variables, in the order in which they were found; None for an answer that has
            been replaced by a better one.
        positions_by_key: positions of the answers by their keys.
        has_ground_answers: whether all answers are ground.
        read_versions: versions of the data that the answers of an incremental table depend on; None for other tables.
        state: "new", "active", "waiting" (evaluated, but part of the SCC of an older table), "complete", or for an
            incremental table "checked": complete as long as nothing that it has read changes.
        index: position on the stack of active tables.
        low_link: the lowest index of a table that it is known to depend on.
        parent: for a waiting table, the table below it on the stack, which depends on it.
        trail_mark: length of the trail at the beginning of the current round of its evaluation.
        height: size of the stack of choice points when the current round began.
        start_counts: numbers of waiting tables and of ready consumers when it became active. Later ones belong to its
            own SCC.
        consumers: suspended calls that have returned all answers so far.
    """

    index: int
    low_link: int
    trail_mark: int
    height: int
    start_counts: Tuple[int, int]

    __slots__ = (
        "answers",
        "positions_by_key",
        "has_ground_answers",
        "read_versions",
        "state",
        "index",
        "low_link",
        "parent",
        "trail_mark",
        "height",
        "start_counts",
        "consumers",
    )

    def __init__(self, incremental: bool = False) -> None:
        self.state = "new"
        self.read_versions: Optional[Reads] = {} if incremental else None
        self.parent: Optional[Table] = None
        self.remove_answers()

    def remove_answers(self) -> None:
        """Remove all answers and consumers."""
        self.answers: List[Any] = []
        self.positions_by_key: Dict[Hashable, int] = {}
        self.has_ground_answers = True
        self.consumers: List[Consumer] = []

    def reset(self) -> None:
        """Reset the table to one that has not been evaluated."""
        # The key of the table stays in `Tables.by_call`: calls that are suspended hold the object.
        self.state = "new"
        self.remove_answers()
        if self.read_versions is not None:
            # Replaced, not cleared: the tables of an SCC share one dictionary.
            self.read_versions = {}

    def complete(self) -> None:
        """Mark the table as complete, and free the data that is only needed by the evaluation."""
        self.state = "complete" if self.read_versions is None else "checked"
        if len(self.positions_by_key) < len(self.answers):
            self.answers = [answer for answer in self.answers if answer is not None]
        self.positions_by_key.clear()
        self.consumers.clear()

    @property
    def is_outdated(self) -> bool:
        """True if data that an incremental table has read has changed since."""
        reads = self.read_versions or {}
        return any(version_of(key) != version for (version_of, key), version in reads.items())

    def add_reads(self, reads: Reads) -> None:
        """Add the reads of another table to those of an incremental table."""
        own_reads = self.read_versions
        if own_reads is not None and own_reads is not reads:
            for read, version in reads.items():
                if own_reads.setdefault(read, version) != version:
                    own_reads[read] = _CHANGED


_ANSWER = functor("answer", 0)
"""Functor that makes a term of the values of an answer, for functions on terms. Its arity is not used."""

AS, INCREMENTAL = functor("as", 2), atom("incremental")
"""Functor and option of ``table ... as incremental``."""

_MIN_TABLES_BEFORE_DROP = 1000
"""Number of tables at which outdated ones are first dropped."""

TabledCall = Callable[[Frame], Optional[Frame]]


class StoredTable(NamedTuple):
    """Complete table in a snapshot.

    Attributes:
        key: key of the call.
        answers: values of the free variables of the call, by answer.
        has_ground_answers: whether no answer contains variables.
    """

    key: Hashable
    answers: List[Values]
    has_ground_answers: bool


class Tables:
    """All tables of a program, with the stack of those that are being evaluated."""

    def __init__(self, machine: ProgramMachine):
        self.machine = machine
        self.by_call: Dict[Hashable, Table] = {}
        self.declarations_by_functor: Dict[Functor, Term] = {}
        """Declarations of the tabled predicates: indicators, or heads with modes."""
        self.active: List[Table] = []
        """Tables under evaluation, the oldest first. The list is never replaced: others hold a reference to it."""
        self.waiting_tables: List[Table] = []
        """Evaluated tables that older active ones will complete, in the order of their evaluation."""
        self.ready_consumers: List[Tuple[Table, Consumer]] = []
        """Suspended calls that have not returned all answers, with the tables that they call."""
        self._earlier_members: Dict[Table, Set[Table]] = {}
        """Tables evaluated in earlier rounds of an SCC, by its leader; a later round need not call them again."""
        self._drop_threshold = _MIN_TABLES_BEFORE_DROP
        self._guard_code = Guard("table", self._discard_evaluations)
        self._round_end_code = Code("table", self._end_round)
        self._next_answer_code = Code("table", lambda entry: self._enumerate_answers(*entry[1:-1]))
        self._more_answers_code = Code("table", lambda entry: self._consume(*entry[1:-1]))
        self._padding_code = Code("table", self._drop_padding)
        self._guard_code.closes_goal = False
        self._add_answer_code = Code("answer", self._add_answer)
        self._combine_answer_code = Code("answer", self._combine_answer)
        self._replace_answer_code = Code("answer", self._replace_answer)
        self._unify_modes_code = Code("table", self._unify_modes)

    def clear(self) -> None:
        """Remove all tables, unless one is being evaluated."""
        # Tables under evaluation are referenced by frames of the machine.
        if not self.active:
            self.by_call.clear()
            self._drop_threshold = _MIN_TABLES_BEFORE_DROP

    def record_read(self, version_of: VersionOf, key: Hashable) -> None:
        """Record that part of a source is about to be read. Must be called only while a table is active."""
        reads = self.active[-1].read_versions
        if reads is not None and (version_of, key) not in reads:
            reads[version_of, key] = version_of(key)

    def observe(self, predicate: Predicate) -> None:
        """Record reads of a predicate's clauses in incremental tables from now on."""
        if not predicate.is_incremental:
            predicate.observe(self.record_predicate_read)
            # Existing tables have read the predicate without recording it.
            self.clear()

    def record_predicate_read(self, predicate: Predicate) -> None:
        """Record that the clauses of a predicate are about to be read, if a table is active."""
        if self.active:
            self.record_read(predicate.version, None)

    def declarations(self) -> List[Term]:
        """Return the declarations of all tabled predicates, as terms."""
        predicate = self.machine.logic.database.predicate
        return [
            (AS, item, INCREMENTAL) if predicate(key).is_incremental else item
            for key, item in self.declarations_by_functor.items()
        ]

    def snapshot(self) -> List[StoredTable]:
        """Return the complete tables, without incremental ones; see `restore`."""
        complete = [(key, table) for key, table in self.by_call.items() if table.state == "complete"]
        return [StoredTable(key, table.answers, table.has_ground_answers) for key, table in complete]

    def restore(self, saved_tables: List[StoredTable]) -> None:
        """Add the complete tables that `snapshot` has returned."""
        for key, answers, ground in saved_tables:
            table = self.by_call[key] = Table()
            table.answers, table.has_ground_answers = answers, ground
            table.complete()

    def moded_caller(self, predicate: Predicate, modes: Dict[int, Mode]) -> TabledCall:
        """Return the function that executes calls of a predicate with moded arguments."""
        # A bound moded argument is an error. An unbound one is replaced by a new variable and unified afterwards: a
        # variable that occurs in another argument too must not restrict the answers that are compared.
        call_without_modes = self.caller(predicate, list(modes.values()))

        def call(frame: Frame) -> Optional[Frame]:
            inner_frame = list(frame)
            for position in modes:
                value = deref(frame[position])
                if value.__class__ is not Var:
                    raise uninstantiation_error(value)
                inner_frame[position] = Var()
            moded_arguments = [frame[position] for position in modes]
            new_vars = [inner_frame[position] for position in modes]
            inner_frame[-1] = (self._unify_modes_code, moded_arguments, new_vars, frame[-1])
            return call_without_modes(tuple(inner_frame), new_vars)

        return call

    def _unify_modes(self, frame: Frame) -> Optional[Frame]:
        """Unify the moded arguments of a call with those of its answer."""
        arguments: Values
        continuation: Frame
        _, arguments, answer_arguments, continuation = frame
        return continuation if self.machine.unify_all(*zip(arguments, answer_arguments)) else None

    def caller(  # noqa: C901  (what it returns runs at each call of a tabled predicate: one function)
        self, predicate: Predicate, modes: Sequence[Mode] = ()
    ) -> Callable[..., Optional[Frame]]:
        """Return the function that executes calls of a predicate; it is passed the variables of moded arguments."""
        key_of_call = predicate.functor
        find_table = self.by_call.get
        record_binding = self.machine.trail.append

        def call(frame: Frame, moded_vars: Sequence[Var] = ()) -> Optional[Frame]:  # noqa: C901
            key: Any = [key_of_call]
            free_vars: List[Var] = []
            goal: Any = None
            # The key of a call with only constants and distinct variables is built here: `term_key` walks over the
            # whole term, which costs more than the rest of a call of a complete table.
            for arg in frame[1:-1]:
                while arg.__class__ is Var and arg.ref is not None:
                    arg = arg.ref
                if arg.__class__ in SELF_KEYED:
                    key.append(arg)
                elif arg.__class__ is Var and arg not in free_vars:
                    free_vars.append(arg)
                    key.append(None)
                else:
                    goal = (key_of_call, *frame[1:-1])
                    key = term_key(goal)
                    free_vars = variables(goal)
                    break
            else:
                key = tuple(key)
            continuation: Frame = frame[-1]
            table = find_table(key)
            if table is None:
                table = self.by_call[key] = Table(predicate.is_incremental)
            elif table.state == "complete":
                # A single ground answer, the most common case, is bound without a further call.
                if len(table.answers) != 1 or not table.has_ground_answers:
                    return self._enumerate_answers(
                        table.answers, table.has_ground_answers, 0, free_vars, continuation
                    )
                for var, value in zip(free_vars, table.answers[0]):
                    var.ref = value
                    record_binding(var)
                return continuation
            elif table.state == "checked" and table.read_versions is not None:
                if not table.is_outdated:
                    self._add_dependencies(table.read_versions)
                    return self._enumerate_answers(
                        table.answers, table.has_ground_answers, 0, free_vars, continuation
                    )
                # Goals that are still enumerating its answers keep the old list, which `reset` does not change.
                table.reset()
            if table.state == "new":
                collect = self._collector(table, free_vars, moded_vars, modes)
                new_vars = collect[2]
                if goal is None:
                    args = _renamed_arguments(key, new_vars)
                else:
                    args = copy(goal, dict(zip(free_vars, new_vars)))[1:]
                return self._evaluate(
                    (predicate.hidden_predicate, *args, collect), table, free_vars, continuation
                )
            return self._call_incomplete(table, free_vars, continuation)

        return call

    def _collector(
        self, table: Table, free_vars: List[Var], moded_vars: Sequence[Var], modes: Sequence[Mode]
    ) -> Frame:
        """Return the frame that stores an answer, with new variables for its values."""
        answer_vars = [Var() for _ in free_vars]
        if not modes:
            return (self._add_answer_code, table, answer_vars)
        return (
            self._combine_answer_code,
            table,
            answer_vars,
            list(map(free_vars.index, moded_vars)),
            modes,
        )

    def _call_incomplete(self, table: Table, free_vars: List[Var], continuation: Frame) -> Optional[Frame]:
        """Return the answers of an incomplete table, and record that the active table depends on it."""
        # A waiting table has left the stack. Its dependency is that of its nearest ancestor that is still active; the
        # path to it is compressed as in a union-find structure.
        while table.state == "waiting" and table.parent is not None and table.parent.state == "waiting":
            table.parent = table.parent.parent
        ancestor = table.parent if table.state == "waiting" else table
        newest = self.active[-1]
        newest.low_link = min(newest.low_link, ancestor.index)  # type: ignore[union-attr]
        return self._consume(table, 0, free_vars, continuation)

    def _consume(
        self, table: Table, position: int, free_vars: List[Var], continuation: Frame
    ) -> Optional[Frame]:
        """Return the answers of an incomplete table from ``position`` on, then suspend the call."""
        answers = table.answers
        while position < len(answers) and answers[position] is None:
            position += 1
        if position < len(answers):
            self.machine.choices.append(
                (
                    self._more_answers_code,
                    table,
                    position + 1,
                    free_vars,
                    continuation,
                    len(self.machine.trail),
                )
            )
            return self.bind_answer(answers[position], table.has_ground_answers, free_vars, continuation)
        choices, trail = self.machine.choices, self.machine.trail
        newest = self.active[-1]
        # A choice point that closes, such as that of a negation, ends before the continuation could be resumed. The
        # call is only recorded then, and an answer that it misses makes the leader repeat the evaluation.
        if any(getattr(entry[0], "closes_goal", False) for entry in choices[newest.height :]):
            consumer = Consumer(position, free_vars, continuation, None, 0)
        else:
            bound = [(entry, entry.ref) for entry in trail[newest.trail_mark :]]
            consumer = Consumer(position, free_vars, continuation, bound, len(choices))
        table.consumers.append(consumer)
        return None

    def _evaluate(self, clauses: Frame, table: Table, free_vars: List[Var], continuation: Frame) -> Frame:
        """Start the evaluation of a table; its bindings are undone on completion."""
        if table.read_versions is not None and len(self.by_call) >= self._drop_threshold:
            self._drop_outdated()
        machine = self.machine
        index = len(self.active)
        table.index = table.low_link = index
        table.start_counts = len(self.waiting_tables), len(self.ready_consumers)
        machine.choices.append((self._guard_code, index, table, len(machine.trail)))
        self.active.append(table)
        table.state = "active"
        self._begin_round(table, clauses, free_vars, continuation)
        return clauses

    def _drop_outdated(self) -> None:
        """Drop outdated tables, which would otherwise stay forever if their calls are not repeated."""
        for key, table in list(self.by_call.items()):
            if table.state == "checked" and table.is_outdated:
                del self.by_call[key]
        # The limit doubles with the tables that remain, so the cost of this scan is constant per new table.
        self._drop_threshold = 2 * len(self.by_call) + _MIN_TABLES_BEFORE_DROP

    def _add_dependencies(self, reads: Reads) -> None:
        """Add the reads of a complete table to those of the active table, if any."""
        if self.active:
            self.active[-1].add_reads(reads)

    def _begin_round(self, table: Table, clauses: Frame, free_vars: List[Var], continuation: Frame) -> None:
        """Push the choice point that ends a round: it is reached when the clauses have no more solutions."""
        table.trail_mark = len(self.machine.trail)
        self.machine.choices.append(
            (self._round_end_code, table, clauses, free_vars, continuation, table.trail_mark)
        )
        table.height = len(self.machine.choices)

    def _store_answer(self, table: Table, key: Hashable, answer: Values) -> None:
        """Store a new answer, and make the consumers of the table ready."""
        table.positions_by_key[key] = len(table.answers)
        table.answers.append(answer)
        if table.consumers:
            self.ready_consumers += [(table, consumer) for consumer in table.consumers]
            table.consumers.clear()

    def _add_answer(self, frame: Frame) -> None:
        """Store an answer if it is new, then fail to find the next one."""
        table: Table
        free_vars: List[Var]
        _, table, free_vars = frame
        answer: Any = []
        for var in free_vars:
            value: Any = var.ref
            while value.__class__ is Var and value.ref is not None:
                value = value.ref
            if value.__class__ not in SELF_KEYED:
                answer_term = copy((_ANSWER, *free_vars))
                key = term_key(answer_term)
                answer = answer_term[1:]
                break
            answer.append(value)
        else:
            key = answer = tuple(answer)
        if key not in table.positions_by_key:
            self._store_answer(table, key, answer)
            if key is not answer and table.has_ground_answers:
                table.has_ground_answers = all(map(has_no_variables, answer))

    def _combine_answer(self, frame: Frame) -> Optional[Frame]:
        """Store an answer of a moded table, or combine it with the answer that is equal in the other arguments."""
        table: Table
        modes: Sequence[Mode]
        _, table, free_vars, moded_positions, modes = frame
        answer = copy((_ANSWER, *free_vars))[1:]
        unmoded = [value for position, value in enumerate(answer) if position not in moded_positions]
        key = term_key((_ANSWER, *unmoded))
        answer_position = table.positions_by_key.get(key)
        if answer_position is None:
            self._store_answer(table, key, answer)
            table.has_ground_answers = table.has_ground_answers and all(map(has_no_variables, answer))
            return None
        merged = list(answer)
        goals = []
        for position, mode in zip(moded_positions, modes):
            old, new = table.answers[answer_position][position], answer[position]
            if mode.choose_value is not None:
                merged[position] = mode.choose_value(old, new)
            elif mode.make_goal is not None:
                merged[position] = Var()
                goals.append(mode.make_goal(old, new, merged[position]))
        notifies_consumers = any(mode.notifies_consumers for mode in modes)
        continuation = (self._replace_answer_code, table, key, merged, notifies_consumers)
        return self.machine.logic.control.once(conjunction(goals), continuation) if goals else continuation

    def _replace_answer(self, frame: Frame) -> None:
        """Replace an answer of a moded table if the combined one differs from it."""
        table: Table
        _, table, key, merged, notifies_consumers = frame
        answer = copy((_ANSWER, *merged))
        answer_position = table.positions_by_key[key]
        if term_key(answer) != term_key((_ANSWER, *table.answers[answer_position])):
            table.has_ground_answers = table.has_ground_answers and has_no_variables(answer)
            if notifies_consumers:
                table.answers[answer_position] = None
                self._store_answer(table, key, answer[1:])
            else:
                table.answers[answer_position] = answer[1:]

    def _end_round(self, entry: Frame) -> Optional[Frame]:
        """Resume a consumer, start another round, or complete the SCC, when a round has no more solutions."""
        table: Table
        clauses: Frame
        _, table, clauses, free_vars, continuation, _ = entry
        # Not the leader of its SCC: an older table decides when both are complete.
        if table.low_link < table.index:
            return self._defer_completion(table, free_vars, continuation)
        waiting_count, ready_count = table.start_counts
        has_new_answers = False
        # Consumers that were ready before this table became active belong to older tables.
        while len(self.ready_consumers) > ready_count:
            followed, consumer = self.ready_consumers.pop()
            if consumer.bindings is not None:
                self._begin_round(table, clauses, free_vars, continuation)
                return self._resume(table, followed, consumer)
            # This consumer missed answers and cannot be resumed, so the round is repeated, which serves all others
            # too.
            has_new_answers = True
            del self.ready_consumers[ready_count:]
        members = [table]
        if len(self.waiting_tables) > waiting_count:
            members += self.waiting_tables[waiting_count:]
            del self.waiting_tables[waiting_count:]
        if has_new_answers:
            # The answers stay, so each round adds some or is the last one.
            for member in members:
                member.consumers.clear()
                member.state = "active" if member is table else "new"
            self._earlier_members.setdefault(table, set()).update(members[1:])
            self._begin_round(table, clauses, free_vars, continuation)
            return clauses
        if len(members) > 1 or self._earlier_members:
            self._merge_reads(members)
            self._reset_uncalled(members)
        for member in members:
            member.complete()
        self.active.pop()
        self.machine.choices.pop()  # the guard
        if table.read_versions is not None:
            self._add_dependencies(table.read_versions)
        return self._enumerate_answers(table.answers, table.has_ground_answers, 0, free_vars, continuation)

    def _reset_uncalled(self, members: List[Table]) -> None:
        """Reset tables that the last round has not called: their reads are not among those of the SCC."""
        for member in members:
            for table in self._earlier_members.pop(member, ()):
                if table.state == "new":
                    table.reset()

    @staticmethod
    def _merge_reads(members: List[Table]) -> None:
        """Give all incremental tables of an SCC one dictionary with the reads of all of them."""
        incremental = [member for member in members if member.read_versions is not None]
        for member in incremental[1:]:
            incremental[0].add_reads(member.read_versions or {})
        for member in incremental[1:]:
            member.read_versions = incremental[0].read_versions

    def _resume(self, table: Table, followed: Table, consumer: Consumer) -> Optional[Frame]:
        """Resume a suspended call: restore its bindings, and return the answers that were added since."""
        choices, trail = self.machine.choices, self.machine.trail
        # Cuts in the continuation remove choice points down to the heights at the suspension, so the stack is padded
        # to the same height.
        below = len(choices)
        choices += [(self._padding_code, below, len(trail))] * (consumer.height - below)
        table.height = len(choices)
        for var, value in consumer.bindings or ():
            var.ref = value
            trail.append(var)
        return self._consume(followed, consumer.position, consumer.free_vars, consumer.continuation)

    def _drop_padding(self, entry: Frame) -> None:
        del self.machine.choices[entry[1] :]

    def _defer_completion(self, table: Table, free_vars: List[Var], continuation: Frame) -> Optional[Frame]:
        """Leave a table that depends on an older one, which completes both."""
        self.active.pop()
        self.machine.choices.pop()  # the guard
        parent = self.active[-1]
        parent.low_link = min(parent.low_link, table.low_link)
        table.parent = parent
        table.state = "waiting"
        self.waiting_tables.append(table)
        return self._consume(table, 0, free_vars, continuation)

    def _enumerate_answers(
        self,
        answers: List[Tuple[Term, ...]],
        are_ground: bool,
        position: int,
        free_vars: List[Var],
        continuation: Frame,
    ) -> Optional[Frame]:
        """Return the answers from ``position`` on, one at each solution."""
        count = len(answers)
        if position == count:
            return None
        if position + 1 < count:
            mark = len(self.machine.trail)
            self.machine.choices.append(
                (
                    self._next_answer_code,
                    answers,
                    are_ground,
                    position + 1,
                    free_vars,
                    continuation,
                    mark,
                )
            )
        return self.bind_answer(answers[position], are_ground, free_vars, continuation)

    def bind_answer(
        self, answer: Tuple[Term, ...], is_ground: bool, free_vars: List[Var], continuation: Frame
    ) -> Frame:
        """Bind the free variables of a call to the values of an answer."""
        trail = self.machine.trail
        if is_ground:
            for var, value in zip(free_vars, answer):
                var.ref = value
                trail.append(var)
        else:
            for var, value in zip(free_vars, copy((_ANSWER, *answer))[1:]):
                # Cannot fail, as the call's variables are unbound. The order of arguments keeps the caller's
                # variable.
                unify(value, var, trail)
        return continuation

    def _discard_evaluations(self, entry: Frame) -> None:
        """Discard the evaluations above an exception, with their answers, which may be incomplete."""
        table: Table
        _, index, table, _ = entry
        waiting_count, ready_count = table.start_counts
        members = [*self.active[index:], *self.waiting_tables[waiting_count:]]
        self._reset_uncalled(members)
        for member in members:
            member.reset()
        del self.active[index:]
        del self.waiting_tables[waiting_count:]
        del self.ready_consumers[ready_count:]


def _renamed_arguments(key: Sequence[Optional[Term]], variables: List[Var]) -> List[Term]:
    """Return the arguments of a call from its key, which has None for each variable, with new variables."""
    unused_vars = iter(variables)
    return [next(unused_vars) if term is None else term for term in key[1:]]


def tables_of(machine: ProgramMachine) -> Tables:
    """Return the tables of a machine's program."""
    tables: Optional[Tables] = machine.logic.state.get("tables")
    if tables is None:
        tables = machine.logic.state["tables"] = Tables(machine)
    return tables
