"""Clauses as predicates keep them, and what tells whether a call matches one.

Indexes of clauses: by the key of one argument, those that a call may match, in their order.

Calls of a predicate with many clauses: straight to the only clause that the key of an argument leaves.

Of most tables of facts and rules one argument is known in most calls, and leaves one clause.

Predicates that are functions of some of their arguments.
"""

from typing import Any, Callable, Dict, Iterable, List, NamedTuple, Optional, Sequence, Tuple

from ...foundation.codegen import MAX_TERM_ARGUMENTS
from ...foundation.errors import Place
from ..compiler.clause_nodes import Joins, KnownPredicate
from ..compiler.predicate_code import key_of
from ..machine.machine import Machine
from ..terms.term_traversal import copy, is_ground, is_larger
from ..terms.types import TRUE, Atom, Frame, Step, Term, Trail, Var
from ..terms.unification import unify

NEVER = 1 << 62
"""A generation that does not come."""


class Clause:
    """A clause of a predicate.

    Attributes:
        head, body: its term; the variables are its own and never bound.
        died: the generation that retracted it.
        keys: first-level key of each argument, None for variables.
        place: where it was read.
    """

    __slots__ = ("head", "body", "died", "keys", "ground", "fact", "code", "uses", "place", "predicate")

    def __init__(self, predicate: KnownPredicate, head: Term, body: Term, place: Optional[Place]):
        self.predicate = predicate
        self.head = head
        self.body = body
        self.died = NEVER
        self.place = place
        self.keys = tuple([key_of(arg) for arg in head[1:]]) if head.__class__ is tuple else ()
        self.fact = body is TRUE
        self.ground = self.fact and is_ground(head)
        self.code: Optional[Step] = None
        self.uses = 0

    @property
    def is_large(self) -> bool:
        """Whether it is so large that it is interpreted always; see `codegen.LARGEST`."""
        return is_larger((None, self.head, self.body), MAX_TERM_ARGUMENTS)


def may_match(keys: Sequence[object], others: Tuple[object, ...]) -> bool:
    """Tell whether the first-level keys of a call and of a clause's head agree."""
    for key, other in zip(keys, others):
        if key is not other and key is not None and other is not None and key != other:
            return False
    return True


def keys_of(frame: Frame, position: Optional[int]) -> Optional[List[object]]:
    """Return the keys of a call's arguments; None where only that at ``position`` has one."""
    for at in range(1, len(frame) - 1):
        if at - 1 != position and key_of(frame[at]) is not None:
            return [key_of(arg) for arg in frame[1:-1]]
    return None


def match_head(frame: Frame, clause: Clause, fresh: Dict[Var, Term], trail: Trail) -> bool:
    """Unify a call with a clause's head; ``fresh`` gets what the clause's variables stand for.

    A variable of the clause becomes a name for the argument, as in compiled clauses: the caller's variable
    is bound to nothing, and stays the older one.
    """
    head: Any = clause.head
    for at in range(1, len(frame) - 1):
        pattern: Term = head[at]
        if pattern.__class__ is Var:
            known = fresh.get(pattern)
            if known is None:
                fresh[pattern] = frame[at]
                continue
            pattern = known
        elif pattern.__class__ is tuple and not clause.ground:
            pattern = copy(pattern, fresh)
        if not unify(pattern, frame[at], trail):
            return False
    return True


_FROM = 8
"""Clauses from which on an index is made."""

_ARGUMENTS = 4
"""How many arguments, the first ones, may be indexed by."""

_MAX_COPIES = 1_000_000
"""Entries of clauses with a variable, under all keys that were asked for, from which on they are made anew."""


class Index:
    """The clauses of a predicate by the key of one argument; those with a variable there match under any key.

    What has a variable is entered once, and joined with the clauses of a key only when that is asked for: the
    time to add clauses and ask for them grows with what is asked for, not with the number of keys.

    Attributes:
        own: by key, the clauses with that key.
        others: the clauses with a variable.
    """

    __slots__ = ("own", "others", "_before", "_joined", "_copies")

    def __init__(self) -> None:
        self.own: Dict[object, List[Clause]] = {}
        self.others: List[Clause] = []
        self._before: Dict[object, List[int]] = {}
        self._joined: Dict[object, Tuple[List[Clause], int, int]] = {}
        self._copies = 0

    def add(self, key: object, clause: Clause) -> None:
        """Add the last clause; the key is None where it has a variable."""
        if key is None:
            self.others.append(clause)
            return
        own = self.own.setdefault(key, [])
        if self.others:
            before = self._before.get(key)
            if before is None:
                before = self._before[key] = [0] * len(own)
            before.append(len(self.others))
        own.append(clause)

    def joined(self, key: object) -> List[Clause]:
        """Return all clauses that may match under a key, in their order; to be called where there are `others`.

        The list is only added to from then on.
        """
        own, others = self.own.get(key), self.others
        if own is None:
            return others
        found, of_own, of_others = self._joined.get(key) or ([], 0, 0)
        if of_own == len(own) and of_others == len(others):
            return found
        before = self._before.get(key, ())
        self._copies += len(others) - of_others
        for at in range(of_own, len(own)):
            least = before[at] if at < len(before) else 0
            if least > of_others:
                found += others[of_others:least]
                of_others = least
            found.append(own[at])
        found += others[of_others:]
        if self._copies > _MAX_COPIES:
            self._joined.clear()
            self._copies = len(others)
        self._joined[key] = found, len(own), len(others)
        return found

    def __len__(self) -> int:
        """Return how many entries of clauses are held, those of joined lists included."""
        joined = sum(len(found) for found, _, _ in self._joined.values())
        return sum(map(len, self.own.values())) + len(self.others) + joined


class Indexes:
    """The indexes of a predicate, made as calls come with arguments that tell its clauses apart.

    How many clauses there were when an argument did not is kept, so that it is not tried for each call.
    """

    __slots__ = ("_positions", "_made", "_poor")

    def __init__(self, arity: int) -> None:
        self._positions = range(min(arity, _ARGUMENTS))
        self._made: Dict[int, Index] = {}
        self._poor: Dict[int, int] = {}

    def select(self, clauses: List[Clause], frame: Frame) -> Tuple[List[Clause], Optional[int]]:
        """Return a list that holds all clauses that a call may match, and the argument that it is indexed by.

        Args:
            clauses: all of the predicate, those included that were removed.
            frame: the call.
        """
        size = len(clauses)
        if size < _FROM:
            return clauses, None
        best, by = clauses, None
        for position in self._positions:
            arg = frame[position + 1]
            key = arg if arg.__class__ is Atom else key_of(arg)
            if key is None:
                continue
            found = self._made.get(position)
            if found is None:
                if self._poor.get(position, 0) * 2 > size:
                    continue
                found = self._make(position, clauses)
                if found is None:
                    continue
            others = found.others
            candidates = found.joined(key) if others else found.own.get(key, others)
            if len(candidates) < len(best):
                best, by = candidates, position
                if len(best) <= 2:
                    break
        return best, by

    def _make(self, position: int, clauses: Iterable[Clause]) -> Optional[Index]:
        index = Index()
        clauses = [clause for clause in clauses if clause.died == NEVER]
        keys = [clause.keys[position] for clause in clauses]
        variables = keys.count(None)
        if variables * 2 <= len(clauses):
            for clause in clauses:
                index.add(clause.keys[position], clause)
        if len(index.own) < 2:
            self._poor[position] = len(clauses)
            return None
        self._made[position] = index
        return index

    def add(self, clause: Clause) -> None:
        """Add the last clause."""
        for position, index in self._made.items():
            index.add(clause.keys[position], clause)

    def clear(self) -> None:
        """Forget all: clauses have gone, or not come as the last."""
        self._made.clear()

    def make_anew(self, clauses: Iterable[Clause]) -> None:
        """Make those that there are anew, of nothing but these clauses."""
        positions = list(self._made)
        self._made.clear()
        for position in positions:
            self._make(position, clauses)

    def complete(self) -> List[Tuple[int, Index]]:
        """Return the positions and indexes of arguments that no clause has a variable for, in order."""
        return [(position, index) for position, index in sorted(self._made.items()) if not index.others]

    def __len__(self) -> int:
        """Return how many entries of clauses are held."""
        return sum(map(len, self._made.values()))


def by_key(
    position: int,
    own: Dict[object, List[Clause]],
    choices: List[Frame],
    search: Callable[..., Optional[Frame]],
    otherwise: Step,
) -> Step:
    """Return a function that does a call while the predicate does not change.

    Args:
        position: of the argument, from 0; no clause has a variable there.
        own: the clauses by the key of that argument.
        choices: those of the machine.
        search: finds a ground fact, see `fact_search`.
        otherwise: does a call where several clauses are left, or one that has not been compiled yet.
    """
    at = position + 1

    def run(frame: Frame) -> Optional[Frame]:
        arg: Any = frame[at]
        kind = arg.__class__
        while kind is Var:
            ref = arg.ref
            if ref is None:
                return otherwise(frame)
            arg = ref
            kind = ref.__class__
        found = own.get(arg if kind is Atom or kind is int else arg[0] if kind is tuple else key_of(arg))
        if found is None:
            return None
        if len(found) == 1:
            clause = found[0]
            if clause.ground:
                return search(frame, found, 0, 1, 0, None)
            if clause.code is not None:
                return clause.code((*frame, len(choices)))
        return otherwise(frame)

    return run


class FunctionalModes(NamedTuple):
    """A deterministic predicate given by a function from input arguments to the other, output arguments.

    Compiled clauses unify the outputs in line: what no goal looks at is never made, and a variable that
    is new there becomes a name for the value, without a binding.

    Attributes:
        function: takes the inputs; returns the only output, or a tuple of all, or None where it fails.
        inputs: positions of the inputs among the arguments.
        outputs: positions of the outputs.
        shows: what makes the term of each output from what the function returned, None where it is the term.
        single: whether there is one output, which is returned as such.
        joins: what tells which goals after one of it go together with it, see `compiler.joining`.
    """

    function: Callable[..., Any]
    inputs: Tuple[int, ...]
    outputs: Tuple[int, ...]
    shows: Tuple[Optional[Callable[..., Term]], ...]
    single: bool
    joins: Optional[Joins] = None

    def predicate(self) -> Callable[..., bool]:
        """Return the predicate as `Logic.define` takes it."""
        function, inputs, single = self.function, self.inputs, self.single
        outputs = tuple(zip(self.outputs, self.shows))

        def call(machine: Machine, *args: Term) -> bool:
            found = function(*[args[at] for at in inputs])
            if found is None:
                return False
            for value, (at, show) in zip((found,) if single else found, outputs):
                if not unify(args[at], value if show is None else show(value), machine.trail):
                    return False
            return True

        return call


def functional(
    function: Callable[..., Any],
    arity: int,
    outputs: Tuple[int, ...] = (),
    shows: Tuple[Optional[Callable[..., Term]], ...] = (),
) -> FunctionalModes:
    """Return the description of a function; without ``outputs`` the last argument is the only one."""
    single = not outputs
    outputs = outputs or (arity - 1,)
    inputs = tuple(at for at in range(arity) if at not in outputs)
    return FunctionalModes(function, inputs, outputs, shows or (None,) * len(outputs), single)
