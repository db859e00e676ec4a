"""Modes of tables: of the answers that agree in the other arguments one is kept, in which these are the best.

What tabling keeps: the answers to a variant of a call, and the calls that wait for more of them.

Tabling: answers of a predicate are kept for each variant of a call, so that left recursion ends.

A call that is new is evaluated, on a copy of it, until no more answers come. A call of a table that is being
evaluated meanwhile follows its answers: it is given each as it is found, and when there are no more for now, what
is bound since the evaluation began is kept aside with what it goes on with, until an answer comes. Tables that
depend on each other are complete together, when the oldest of them has no follower left that has not seen all.
Within negation, ``findall/3``, ``catch/3`` and the like a call cannot go on later; where it has missed answers, the
evaluation of the oldest table is repeated. Everything runs as frames of the machine.

An incremental table also records what it reads of dynamic predicates, memories and states, with the version that
each has at the first read; of a complete incremental table that it calls it takes over the reads. Tables that are
complete together share theirs. A later call compares the versions and evaluates the table anew where one differs:
nothing is done when something changes, and nothing for tables that are not incremental.

An answer is what the call's unbound variables stand for, in the order in which they are met. A call that finds
them gives its variables these values, which cannot fail: nothing is unified.
"""

from typing import Any, Callable, Dict, Hashable, List, NamedTuple, Optional, Protocol, Sequence, Set, Tuple

from ..compiler.clause_nodes import ARROW, SEMICOLON
from ..database.predicate import Predicate
from ..machine.errors import domain_error, instantiation_error, type_error, uninstantiation_error
from ..machine.machine import Code, Guard
from ..terms.list_terms import conjunction
from ..terms.term_traversal import PLAIN, copy, is_plain, term_key, variables
from ..terms.types import SLASH, Atom, CompoundTerm, Frame, Functor, Term, Values, Var, atom, deref, functor
from ..terms.unification import compare, unify
from .argument_checks import natural
from .builtin_registry import Machine

_EQUAL = functor("=", 2)
_LATTICE, _ORDER = functor("lattice", 1), functor("po", 1)

Pick = Callable[[Term, Term], Term]
_PICKS: Dict[str, Pick] = {
    "first": lambda old, new: old,
    "-": lambda old, new: old,
    "last": lambda old, new: new,
    "min": lambda old, new: old if compare(old, new) <= 0 else new,
    "max": lambda old, new: old if compare(old, new) >= 0 else new,
}


class Mode(NamedTuple):
    """What happens to an argument as answers come.

    Attributes:
        pick: returns the one of two values that is kept; None where a predicate of the program decides.
        goal: returns the goal that makes a value of two others.
        grows: whether a change may lead to other answers; the last one found says nothing of the kind.
    """

    pick: Optional[Pick] = None
    goal: Optional[Callable[[Term, Term, Term], Term]] = None
    grows: bool = True


def modes_of(spec: CompoundTerm) -> Tuple[Functor, Dict[int, Mode]]:
    """Return the functor that a declaration such as ``path(_, _, min)`` names, and modes by position.

    Raises:
        PrologError: a domain error where there is no such mode.
    """
    modes = {}
    for at, given in enumerate(spec[1:], 1):
        given = deref(given)
        if given.__class__ is Var or (given.__class__ is Atom and given.name in ("index", "+")):
            continue
        modes[at] = _mode(given)
    return spec[0], modes


def _mode(given: Term) -> Mode:
    if given.__class__ is Atom and given.name in _PICKS:
        return Mode(_PICKS[given.name], grows=given.name != "last")
    if given.__class__ is not tuple or given[0] not in (_LATTICE, _ORDER):
        raise domain_error("tabled_mode", given)
    arity = 3 if given[0] is _LATTICE else 2
    key = functor(_name(given[1], arity), arity)
    if arity == 3:
        return Mode(goal=lambda old, new, kept: (key, old, new, kept))
    return Mode(
        goal=lambda old, new, kept: (
            SEMICOLON,
            (ARROW, (key, old, new), (_EQUAL, kept, old)),
            (_EQUAL, kept, new),
        )
    )


def _name(given: Term, arity: int) -> str:
    """Return the name of a predicate given by name, by indicator or by head."""
    given = deref(given)
    if given.__class__ is tuple and given[0].name == ":" and len(given) == 3:
        given = deref(given[2])
    size = arity
    if given.__class__ is tuple:
        given, size = (given[1], natural(given[2])) if given[0] is SLASH else (given[0], given[0].arity)
        given = deref(given)
    if size != arity:
        raise domain_error("lattice_arity" if arity == 3 else "po_arity", size)
    if given.__class__ is Var:
        raise instantiation_error()
    if given.__class__ not in (Atom, Functor):
        raise type_error("atom", given)
    return str(given.name)


class VersionedSource(Protocol):
    """Data outside of tables that an incremental table may read: a predicate, the memories or the states."""

    def version(self, part: Hashable, /) -> object:
        """Return a value that is another one after each change of a part of the data."""


Reads = Dict[Tuple[VersionedSource, Hashable], object]
"""The parts of sources that an evaluation has read, with their versions when it first did."""

_CHANGED = object()
"""The version of what has changed between two reads of an evaluation: equal to no other."""


class Follower(NamedTuple):
    """A call that has been given the first ``at`` answers of a table and waits for more.

    Attributes:
        bound: variables bound since its evaluation began, with their values; None where it cannot go on later.
        height: of the stack of choice points, which cuts in what follows count on.
    """

    at: int
    free: List[Var]
    after: Frame
    bound: Optional[List[Tuple[Any, Term]]]
    height: int


class Table:
    """Answers to one variant of a call.

    Attributes:
        answers: values of the call's variables, in the order found; None in the place of one that there is a
            better one for.
        known: the answers' keys, with their positions.
        ground: whether no answer has a variable.
        reads: of an incremental table what its answers were made of; None for another one.
        state: "new", "active", "waiting" (for the oldest table that it depends on), "complete", or of an incremental
            table "checked": complete, as long as nothing that it has read changes.
        index: position on the stack of active tables.
        low: position there of the oldest table that it is known to depend on.
        parent: of a waiting table the one below it on that stack, which depends on it.
        mark: length of the trail when what runs for it now began.
        height: of the stack of choice points then.
        first: how many tables waited, and how many followers were ready, when it became active.
        followers: calls that have seen all answers so far.
    """

    index: int
    low: int
    mark: int
    height: int
    first: Tuple[int, int]

    __slots__ = (
        "answers",
        "known",
        "ground",
        "reads",
        "state",
        "index",
        "low",
        "parent",
        "mark",
        "height",
        "first",
        "followers",
    )

    def __init__(self, incremental: bool = False) -> None:
        self.state = "new"
        self.reads: Optional[Reads] = {} if incremental else None
        self.parent: Optional[Table] = None
        self.empty()

    def empty(self) -> None:
        """Forget the answers."""
        self.answers: List[Any] = []
        self.known: Dict[Hashable, int] = {}
        self.ground = True
        self.followers: List[Follower] = []

    def renew(self) -> None:
        """Be a table that has not been evaluated."""
        self.state = "new"
        self.empty()
        if self.reads is not None:
            self.reads = {}  # not cleared: tables that were completed together share one

    def complete(self) -> None:
        """Note that there will be no other answers."""
        self.state = "complete" if self.reads is None else "checked"
        if len(self.known) < len(self.answers):
            self.answers = [answer for answer in self.answers if answer is not None]
        self.known.clear()
        self.followers.clear()

    @property
    def is_outdated(self) -> bool:
        """True if something has changed that an incremental table has read."""
        reads = self.reads or {}
        return any(source.version(part) != version for (source, part), version in reads.items())

    def depend(self, reads: Reads) -> None:
        """Note that an incremental table depends on what another one has read."""
        own = self.reads
        if own is not None and own is not reads:
            for read, version in reads.items():
                if own.setdefault(read, version) != version:
                    own[read] = _CHANGED


_ANSWER = functor("answer", 0)
AS, INCREMENTAL = functor("as", 2), atom("incremental")
"""Kinds of terms that are their own keys."""

_SPARE = 1000
"""Tables from which on, and then at twice as many, those that are out of date are dropped."""

TabledCall = Callable[[Frame], Optional[Frame]]


class Tables:
    """All tables of a program, and the ones being evaluated."""

    def __init__(self, machine: Machine):
        self.machine = machine
        self.by_call: Dict[Hashable, Table] = {}
        self.declared: Dict[Functor, Term] = {}
        """Indicators or heads with modes of the predicates that have tables."""
        self.active: List[Table] = []
        """Those that are being evaluated, the oldest first; always the same list, for what is read to look at it."""
        self.waiting: List[Table] = []
        self.ready: List[Tuple[Table, Follower]] = []
        self._repeated: Dict[Table, Set[Table]] = {}
        """By the oldest of some tables those evaluated with it in rounds before this one: they may not be again."""
        self._many = _SPARE
        self._guard = Guard("table", self._abandon)
        self._round = Code("table", self._end_of_round)
        self._next = Code("table", lambda entry: self._enumerate(*entry[1:6]))
        self._more = Code("table", lambda entry: self._follow(*entry[1:5]))
        self._padding = Code("table", self._leave_padding)
        self._guard.closes = False
        self._answer = Code("answer", self._add)
        self._better = Code("answer", self._improve)
        self._kept = Code("answer", self._keep)
        self._moded = Code("table", lambda frame: frame[3] if machine.unify_all(*zip(*frame[1:3])) else None)

    def clear(self) -> None:
        """Forget all answers; nothing is done while a table is evaluated."""
        if not self.active:
            self.by_call.clear()
            self._many = _SPARE

    def note(self, source: VersionedSource, part: Hashable) -> None:
        """Record that part of a source is about to be read; to be called where `active` has tables."""
        reads = self.active[-1].reads
        if reads is not None and (source, part) not in reads:
            reads[source, part] = source.version(part)

    def observe(self, predicate: Predicate) -> None:
        """Have incremental tables depend on the clauses of a predicate."""
        if not predicate.incremental:
            predicate.observe(self.note_predicate)
            self.clear()  # those that have read it do not know that

    def note_predicate(self, predicate: Predicate) -> None:
        """Record that the clauses of a predicate are about to be read."""
        if self.active:
            self.note(predicate, None)

    def declarations(self) -> List[Term]:
        """Return how the predicates were declared that have tables."""
        predicate = self.machine.logic.database.predicate
        return [
            (AS, item, INCREMENTAL) if predicate(key).incremental else item
            for key, item in self.declared.items()
        ]

    def mend(self) -> None:
        """Forget all evaluations that are not over: nothing is evaluated."""
        self.active.clear()
        self.waiting.clear()
        self.ready.clear()
        self._repeated.clear()
        for table in self.by_call.values():
            if table.state != "complete":
                table.renew()

    def kept(self) -> List[Tuple[Hashable, List[Values], bool]]:
        """Return the calls whose answers are known, with those, but for incremental tables; see `restore`."""
        complete = [(key, table) for key, table in self.by_call.items() if table.state == "complete"]
        return [(key, table.answers, table.ground) for key, table in complete]

    def restore(self, kept: List[Tuple[Hashable, List[Values], bool]]) -> None:
        """Know the answers that another one knew."""
        for key, answers, ground in kept:
            table = self.by_call[key] = Table()
            table.answers, table.ground = answers, ground
            table.complete()

    def moded_caller(self, predicate: Predicate, modes: Dict[int, Mode]) -> TabledCall:
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

    def caller(  # noqa: C901  (what it returns runs at each call of a tabled predicate: one function)
        self, predicate: Predicate, modes: Sequence[Mode] = ()
    ) -> Callable[..., Optional[Frame]]:
        """Return the function that does calls of a predicate, given the variables of arguments with modes."""
        key_of_call = predicate.functor
        find = self.by_call.get
        bound = self.machine.trail.append

        def call(frame: Frame, moded: Sequence[Var] = ()) -> Optional[Frame]:  # noqa: C901
            key: Any = [key_of_call]
            free: List[Var] = []
            walked = False
            for arg in frame[1:-1]:
                while arg.__class__ is Var and arg.ref is not None:
                    arg = arg.ref
                if arg.__class__ in PLAIN:
                    key.append(arg)
                elif arg.__class__ is Var and arg not in free:
                    free.append(arg)
                    key.append(None)
                else:  # a key that takes a walk
                    goal = (key_of_call, *frame[1:-1])
                    key = term_key(goal)
                    free = variables(goal)
                    walked = True
                    break
            else:
                key = tuple(key)
            after: Frame = frame[-1]
            table = find(key)
            if table is None:
                table = self.by_call[key] = Table(predicate.incremental)
            elif table.state == "complete":
                if len(table.answers) != 1 or not table.ground:
                    return self._enumerate(table.answers, table.ground, 0, free, after)
                for var, value in zip(free, table.answers[0]):
                    var.ref = value
                    bound(var)
                return after
            elif table.state == "checked" and table.reads is not None:
                if not table.is_outdated:
                    self._depend(table.reads)
                    return self._enumerate(table.answers, table.ground, 0, free, after)
                table.renew()  # goals that are going through its answers have a list of their own
            if table.state == "new":
                collect = self._collector(table, free, moded, modes)
                own = collect[2]
                args = copy(goal, dict(zip(free, own)))[1:] if walked else _renamed(key, own)
                return self._evaluate((predicate.tabled, *args, collect), table, free, after)
            return self._consult(table, free, after)

        return call

    def _collector(self, table: Table, free: List[Var], moded: Sequence[Var], modes: Sequence[Mode]) -> Frame:
        """Return the frame that takes answers, with new variables for what they say."""
        own = [Var() for _ in free]
        if not modes:
            return (self._answer, table, own)
        return (self._better, table, own, list(map(free.index, moded)), modes)

    def _consult(self, table: Table, free: List[Var], after: Frame) -> Optional[Frame]:
        """Give the answers of a table that is not complete: what is evaluated now depends on it."""
        while table.state == "waiting" and table.parent is not None and table.parent.state == "waiting":
            table.parent = table.parent.parent
        found = table.parent if table.state == "waiting" else table
        newest = self.active[-1]
        newest.low = min(newest.low, found.index)  # type: ignore[union-attr]
        return self._follow(table, 0, free, after)

    def _follow(self, table: Table, at: int, free: List[Var], after: Frame) -> Optional[Frame]:
        """Give the answers of a table that is not complete from ``at`` on; then wait for more."""
        answers = table.answers
        while at < len(answers) and answers[at] is None:
            at += 1
        if at < len(answers):
            self.machine.choices.append((self._more, table, at + 1, free, after, len(self.machine.trail)))
            return self.give(answers[at], table.ground, free, after)
        choices, trail = self.machine.choices, self.machine.trail
        newest = self.active[-1]
        if any(getattr(entry[0], "closes", False) for entry in choices[newest.height :]):
            follower = Follower(at, free, after, None, 0)
        else:
            bound = [(entry, entry.ref) for entry in trail[newest.mark :]]
            follower = Follower(at, free, after, bound, len(choices))
        table.followers.append(follower)
        return None

    def _evaluate(self, clauses: Frame, table: Table, free: List[Var], after: Frame) -> Frame:
        """Evaluate the clauses once; all bindings are undone in the end."""
        if table.reads is not None and len(self.by_call) >= self._many:
            self._drop_outdated()
        machine = self.machine
        index = len(self.active)
        table.index = table.low = index
        table.first = len(self.waiting), len(self.ready)
        machine.choices.append((self._guard, index, table, len(machine.trail)))
        self.active.append(table)
        table.state = "active"
        self._begin(table, clauses, free, after)
        return clauses

    def _drop_outdated(self) -> None:
        """Drop the tables that are out of date: those of calls that never come again would stay for ever."""
        for key, table in list(self.by_call.items()):
            if table.state == "checked" and table.is_outdated:
                del self.by_call[key]
        self._many = 2 * len(self.by_call) + _SPARE

    def _depend(self, reads: Reads) -> None:
        """Note that the table that is being evaluated, if any, depends on what a complete one has read."""
        if self.active:
            self.active[-1].depend(reads)

    def _begin(self, table: Table, clauses: Frame, free: List[Var], after: Frame) -> None:
        """Have the end of what is evaluated from here on be noticed."""
        table.mark = len(self.machine.trail)
        self.machine.choices.append((self._round, table, clauses, free, after, table.mark))
        table.height = len(self.machine.choices)

    def _found(self, table: Table, key: Hashable, answer: Values) -> None:
        """Note an answer; whoever waits for one can go on."""
        table.known[key] = len(table.answers)
        table.answers.append(answer)
        if table.followers:
            self.ready += [(table, follower) for follower in table.followers]
            table.followers.clear()

    def _add(self, frame: Frame) -> None:
        """Note an answer, and look for the next one."""
        table: Table
        free: List[Var]
        _, table, free = frame
        answer: Any = []
        for var in free:
            value: Any = var.ref
            while value.__class__ is Var and value.ref is not None:
                value = value.ref
            if value.__class__ not in PLAIN:
                whole = copy((_ANSWER, *free))
                key = term_key(whole)
                answer = whole[1:]
                break
            answer.append(value)
        else:
            key = answer = tuple(answer)
        if key not in table.known:
            self._found(table, key, answer)
            if key is not answer and table.ground:
                table.ground = all(map(is_plain, answer))

    def _improve(self, frame: Frame) -> Optional[Frame]:
        """Note an answer of a table with modes, or what is better of it and the one that is there."""
        table: Table
        modes: Sequence[Mode]
        _, table, free, places, modes = frame
        answer = copy((_ANSWER, *free))[1:]
        key = term_key((_ANSWER, *[value for at, value in enumerate(answer) if at not in places]))
        at = table.known.get(key)
        if at is None:
            self._found(table, key, answer)
            table.ground = table.ground and all(map(is_plain, answer))
            return None
        kept = list(answer)
        goals = []
        for place, mode in zip(places, modes):
            old, new = table.answers[at][place], answer[place]
            if mode.pick is not None:
                kept[place] = mode.pick(old, new)
            elif mode.goal is not None:
                kept[place] = Var()
                goals.append(mode.goal(old, new, kept[place]))
        grows = any(mode.grows for mode in modes)
        after = (self._kept, table, key, kept, grows)
        return self.machine.logic.control.once(conjunction(goals), after) if goals else after

    def _keep(self, frame: Frame) -> None:
        """Put an answer in the place of another."""
        table: Table
        _, table, key, kept, grows = frame
        answer = copy((_ANSWER, *kept))
        at = table.known[key]
        if term_key(answer) != term_key((_ANSWER, *table.answers[at])):
            table.ground = table.ground and is_plain(answer)
            if grows:
                table.answers[at] = None
                self._found(table, key, answer[1:])
            else:
                table.answers[at] = answer[1:]

    def _end_of_round(self, entry: Frame) -> Optional[Frame]:
        """Let followers go on, evaluate the clauses again, or be done."""
        table: Table
        clauses: Frame
        _, table, clauses, free, after, _ = entry
        if table.low < table.index:
            return self._hand_on(table, free, after)
        waiting, ready = table.first
        again = False
        while len(self.ready) > ready:
            followed, follower = self.ready.pop()
            if follower.bound is not None:
                return self._go_on(entry, followed, follower)
            again = True
            del self.ready[ready:]
        members = [table]
        if len(self.waiting) > waiting:
            members += self.waiting[waiting:]
            del self.waiting[waiting:]
        if again:
            for member in members:
                member.followers.clear()
                member.state = "active" if member is table else "new"
            self._repeated.setdefault(table, set()).update(members[1:])
            self._begin(table, clauses, free, after)
            return clauses
        if len(members) > 1 or self._repeated:
            self._share_reads(members)
            self._forget_repeated(members)
        for member in members:
            member.complete()
        self.active.pop()
        self.machine.choices.pop()  # the guard
        if table.reads is not None:
            self._depend(table.reads)
        return self._enumerate(table.answers, table.ground, 0, free, after)

    def _forget_repeated(self, members: List[Table]) -> None:
        """Empty the tables of earlier rounds that the last one has not called: what they have read may change."""
        for member in members:
            for table in self._repeated.pop(member, ()):
                if table.state == "new":
                    table.renew()

    @staticmethod
    def _share_reads(members: List[Table]) -> None:
        """Have the incremental ones of tables that depend on each other depend on what any of them has read."""
        incremental = [member for member in members if member.reads is not None]
        for other in incremental[1:]:
            incremental[0].depend(other.reads or {})
        for other in incremental[1:]:
            other.reads = incremental[0].reads

    def _go_on(self, entry: Frame, followed: Table, follower: Follower) -> Optional[Frame]:
        """Bring back what was bound when a call had seen all answers, and give it those that came since."""
        choices, trail = self.machine.choices, self.machine.trail
        table: Table = entry[1]
        self._begin(*entry[1:5])
        # Cuts count on as many choice points as there were.
        below = len(choices)
        choices += [(self._padding, below, len(trail))] * (follower.height - below)
        table.height = len(choices)
        for var, value in follower.bound or ():
            var.ref = value
            trail.append(var)
        return self._follow(followed, follower.at, follower.free, follower.after)

    def _leave_padding(self, entry: Frame) -> None:
        del self.machine.choices[entry[1] :]

    def _hand_on(self, table: Table, free: List[Var], after: Frame) -> Optional[Frame]:
        """Leave a table that depends on an older one, which decides when both are complete."""
        self.active.pop()
        self.machine.choices.pop()  # the guard
        parent = self.active[-1]
        parent.low = min(parent.low, table.low)
        table.parent = parent
        table.state = "waiting"
        self.waiting.append(table)
        return self._follow(table, 0, free, after)

    def _enumerate(
        self, answers: List[Tuple[Term, ...]], ground: bool, at: int, free: List[Var], after: Frame
    ) -> Optional[Frame]:
        """Give variables the values of an answer; the next ones on backtracking."""
        count = len(answers)
        if at == count:
            return None
        if at + 1 < count:
            mark = len(self.machine.trail)
            self.machine.choices.append((self._next, answers, ground, at + 1, free, after, mark))
        return self.give(answers[at], ground, free, after)

    def give(self, answer: Tuple[Term, ...], ground: bool, free: List[Var], after: Frame) -> Frame:
        """Give variables the values of an answer."""
        trail = self.machine.trail
        if ground:
            for var, value in zip(free, answer):
                var.ref = value
                trail.append(var)
        else:
            for var, value in zip(free, copy((_ANSWER, *answer))[1:]):
                unify(value, var, trail)  # cannot fail; of two variables the caller's stays
        return after

    def _abandon(self, entry: Frame) -> None:
        """Forget evaluations that an error has ended, and what they found."""
        table: Table
        _, index, table, _ = entry
        waiting, ready = table.first
        members = [*self.active[index:], *self.waiting[waiting:]]
        self._forget_repeated(members)
        for member in members:
            member.renew()
        del self.active[index:]
        del self.waiting[waiting:]
        del self.ready[ready:]


def _renamed(key: Sequence[Optional[Term]], own: List[Var]) -> List[Term]:
    """Return the arguments of a call whose key has None in the place of each variable, with new ones."""
    fresh = iter(own)
    return [next(fresh) if known is None else known for known in key[1:]]


def tables_of(machine: Machine) -> Tables:
    """Return the tables of a machine's program."""
    found: Optional[Tables] = machine.logic.state.get("tables")
    if found is None:
        found = machine.logic.state["tables"] = Tables(machine)
    return found
