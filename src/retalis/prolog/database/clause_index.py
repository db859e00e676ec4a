"""Clauses and their indexes: selection of the clauses that a call may match.

A call is compared with clause heads by first-level keys (`key_of`): the constant or functor of an argument. A
predicate with many clauses gets hash indexes on single arguments, built when a call first has that argument bound
(just-in-time indexing as in SWI-Prolog and YAP). Clauses with a variable in the indexed argument match under any key.
They are stored once and merged with the clauses of a key when that key is looked up, so the cost of adding a clause
does not depend on the number of keys.

Retracted clauses stay in indexes and lists. Each records the generation that retracted it, and a call sees the
clauses that were alive when it began (the logical update view).
"""

from typing import TYPE_CHECKING, Any, Callable, Dict, Iterable, List, Optional, Sequence, Tuple

from ...foundation.codegen import MAX_TERM_ARGUMENTS
from ...foundation.source_places import Place
from ..compiler.predicate_code import key_of
from ..terms.term_traversal import copy, is_ground, is_larger
from ..terms.types import TRUE, Atom, Frame, Step, Term, Trail, Var
from ..terms.unification import unify

if TYPE_CHECKING:
    from .predicate import Predicate

NEVER_RETRACTED = 1 << 62
"""Generation of clauses that have not been retracted."""


class Clause:
    """Clause of a predicate.

    Attributes:
        predicate: the predicate that it belongs to.
        head, body: the terms; their variables belong to the clause alone and are never bound.
        retracted_at: the generation that retracted it; `NEVER_RETRACTED` if it has not been retracted.
        keys: first-level key of each argument, None for variables.
        is_ground_fact: whether it is a fact without variables.
        is_fact: whether its body is ``true``.
        code: its compiled code, or None.
        call_count: number of interpreted calls, which decides when it is compiled.
        place: source position, or None.
    """

    __slots__ = (
        "head",
        "body",
        "retracted_at",
        "keys",
        "is_ground_fact",
        "is_fact",
        "code",
        "call_count",
        "place",
        "predicate",
    )

    def __init__(self, predicate: "Predicate", head: Term, body: Term, place: Optional[Place]):
        self.predicate = predicate
        self.head = head
        self.body = body
        self.retracted_at = NEVER_RETRACTED
        self.place = place
        self.keys = tuple([key_of(arg) for arg in head[1:]]) if head.__class__ is tuple else ()
        self.is_fact = body is TRUE
        self.is_ground_fact = self.is_fact and is_ground(head)
        self.code: Optional[Step] = None
        self.call_count = 0

    @property
    def is_large(self) -> bool:
        """True if the clause is too large to be compiled; see `MAX_TERM_ARGUMENTS`."""
        return is_larger((None, self.head, self.body), MAX_TERM_ARGUMENTS)

    def discard_code(self) -> None:
        """Discard the compiled code, because a predicate that it refers to has been redefined."""
        self.code = None


class CountedClause(Clause):
    """Clause that counts the calls that unify with its head, for the coverage of a program by tests.

    Its code, which counts and then interprets the body, is set from the beginning. The predicate is therefore not
    compiled, and the clause is not searched as a fact: both would pass this code by.

    Attributes:
        use_count: number of calls that have unified with its head.
    """

    __slots__ = ("use_count",)

    def __init__(self, predicate: "Predicate", head: Term, body: Term, place: Optional[Place]):
        super().__init__(predicate, head, body, place)
        self.is_fact = self.is_ground_fact = False
        self.use_count = 0
        self.code = self._run

    @property
    def is_large(self) -> bool:
        """True, so that its predicate is not compiled."""
        return True

    def discard_code(self) -> None:
        """Keep the code, which refers to no predicate."""

    def _run(self, frame: Frame) -> Optional[Frame]:
        """Run a call, given its frame with the height of the choice point stack appended."""
        database = self.predicate.database
        fresh: Dict[Var, Term] = {}
        if not match_head(frame[:-1], self, fresh, database.machine.trail):
            return None
        self.use_count += 1
        return database.control.solve(copy(self.body, fresh), frame[-1], frame[-2])


def may_match(keys: Sequence[object], head_keys: Tuple[object, ...]) -> bool:
    """Return whether the first-level keys of a call and of a clause's head agree; None agrees with any key."""
    for key, head_key in zip(keys, head_keys):
        if key is not head_key and key is not None and head_key is not None and key != head_key:
            return False
    return True


def keys_of(frame: Frame, position: Optional[int]) -> Optional[List[object]]:
    """Return the keys of a call's arguments, or None if no argument but the indexed one has a key.

    Args:
        frame: the call.
        position: position of the argument that an index has compared, or None.
    """
    for index in range(1, len(frame) - 1):
        if index - 1 != position and key_of(frame[index]) is not None:
            return [key_of(arg) for arg in frame[1:-1]]
    return None


def match_head(frame: Frame, clause: Clause, fresh: Dict[Var, Term], trail: Trail) -> bool:
    """Unify a call with a clause's head, and return whether that succeeds.

    The first occurrence of a clause variable becomes a name for the argument, as in compiled clauses. No variable is
    created, and the caller's variable stays unbound.

    Args:
        frame: the call.
        clause: the clause.
        fresh: receives the values of the clause's variables.
        trail: receives the variables that are bound.
    """
    head: Any = clause.head
    for index in range(1, len(frame) - 1):
        pattern: Term = head[index]
        if pattern.__class__ is Var:
            value = fresh.get(pattern)
            if value is None:
                fresh[pattern] = frame[index]
                continue
            pattern = value
        elif pattern.__class__ is tuple and not clause.is_ground_fact:
            pattern = copy(pattern, fresh)
        if not unify(pattern, frame[index], trail):
            return False
    return True


_MIN_INDEXED_CLAUSES = 8
"""Clauses from which on a predicate is indexed; a scan of fewer is faster."""

_MAX_INDEXED_ARGUMENTS = 4
"""Number of leading arguments that may be indexed."""

_MAX_MERGED_COPIES = 1_000_000
"""Limit for copies of clauses with a variable in all merged lists; past it the merged lists are dropped."""


class Index:
    """Index of a predicate's clauses by the key of one argument.

    A clause with a variable in that argument matches under any key. It is stored once, and merged with the clauses of
    a key when that key is looked up, so the cost follows the look-ups and not the number of keys.

    Attributes:
        clauses_by_key: the clauses with a constant or compound in the argument, by its key.
        unkeyed_clauses: the clauses with a variable in the argument.
    """

    __slots__ = ("clauses_by_key", "unkeyed_clauses", "_unkeyed_before", "_merged", "_copied_count")

    def __init__(self) -> None:
        self.clauses_by_key: Dict[object, List[Clause]] = {}
        self.unkeyed_clauses: List[Clause] = []
        self._unkeyed_before: Dict[object, List[int]] = {}
        self._merged: Dict[object, Tuple[List[Clause], int, int]] = {}
        self._copied_count = 0

    def add(self, key: object, clause: Clause) -> None:
        """Append a clause; the key is None if the argument is a variable."""
        if key is None:
            self.unkeyed_clauses.append(clause)
            return
        key_clauses = self.clauses_by_key.setdefault(key, [])
        # For each clause with a key, the number of preceding clauses with a variable is stored, which suffices to
        # merge both lists in the order of the program. Nothing is stored as long as there are no such clauses.
        if self.unkeyed_clauses:
            counts_before = self._unkeyed_before.get(key)
            if counts_before is None:
                counts_before = self._unkeyed_before[key] = [0] * len(key_clauses)
            counts_before.append(len(self.unkeyed_clauses))
        key_clauses.append(clause)

    def merged_clauses(self, key: object) -> List[Clause]:
        """Return all clauses that may match a key, in order. Call it only if there are `unkeyed_clauses`.

        The list is never shortened, so a choice point may refer to a position in it.
        """
        key_clauses, others = self.clauses_by_key.get(key), self.unkeyed_clauses
        if key_clauses is None:
            return others
        clauses, own_count, others_count = self._merged.get(key) or ([], 0, 0)
        if own_count == len(key_clauses) and others_count == len(others):
            return clauses
        # The merged list is extended by the clauses that were added since the last look-up.
        counts_before = self._unkeyed_before.get(key, ())
        self._copied_count += len(others) - others_count
        for position in range(own_count, len(key_clauses)):
            others_before = counts_before[position] if position < len(counts_before) else 0
            if others_before > others_count:
                clauses += others[others_count:others_before]
                others_count = others_before
            clauses.append(key_clauses[position])
        clauses += others[others_count:]
        # The lists are dropped and not shortened, because running calls hold them.
        if self._copied_count > _MAX_MERGED_COPIES:
            self._merged.clear()
            self._copied_count = len(others)
        self._merged[key] = clauses, len(key_clauses), len(others)
        return clauses

    def __len__(self) -> int:
        """Return the number of stored references to clauses, including those of merged lists."""
        copies = sum(len(clauses) for clauses, _, _ in self._merged.values())
        return sum(map(len, self.clauses_by_key.values())) + len(self.unkeyed_clauses) + copies


class Indexes:
    """Indexes of a predicate, built when a call has a bound argument that distinguishes its clauses.

    If an argument does not distinguish them, the number of clauses is recorded, and building the index is tried again
    only when that number has doubled.
    """

    __slots__ = ("_positions", "_by_position", "_unselective")

    def __init__(self, arity: int) -> None:
        self._positions = range(min(arity, _MAX_INDEXED_ARGUMENTS))
        self._by_position: Dict[int, Index] = {}
        self._unselective: Dict[int, int] = {}

    def select(self, clauses: List[Clause], frame: Frame) -> Tuple[List[Clause], Optional[int]]:
        """Return a list with all clauses that a call may match, and the position of the index used (None for none).

        Args:
            clauses: all clauses of the predicate, including retracted ones.
            frame: the call.
        """
        size = len(clauses)
        if size < _MIN_INDEXED_CLAUSES:
            return clauses, None
        best, best_position = clauses, None
        for position in self._positions:
            arg = frame[position + 1]
            key = arg if arg.__class__ is Atom else key_of(arg)
            if key is None:
                continue
            index = self._by_position.get(position)
            if index is None:
                if self._unselective.get(position, 0) * 2 > size:
                    continue
                index = self._build(position, clauses)
                if index is None:
                    continue
            others = index.unkeyed_clauses
            candidates = index.merged_clauses(key) if others else index.clauses_by_key.get(key, others)
            if len(candidates) < len(best):
                best, best_position = candidates, position
                # A better index would not save more than the search for it costs.
                if len(best) <= 2:
                    break
        return best, best_position

    def _build(self, position: int, clauses: Iterable[Clause]) -> Optional[Index]:
        """Build and store the index of an argument; return None if it would not be selective."""
        # An index is not selective if most clauses match any key, or if there is only one key.
        index = Index()
        clauses = [clause for clause in clauses if clause.retracted_at == NEVER_RETRACTED]
        keys = [clause.keys[position] for clause in clauses]
        variable_count = keys.count(None)
        if variable_count * 2 <= len(clauses):
            for clause in clauses:
                index.add(clause.keys[position], clause)
        if len(index.clauses_by_key) < 2:
            self._unselective[position] = len(clauses)
            return None
        self._by_position[position] = index
        return index

    def add(self, clause: Clause) -> None:
        """Append a clause."""
        for position, index in self._by_position.items():
            index.add(clause.keys[position], clause)

    def clear(self) -> None:
        """Drop all indexes, after clauses were removed or added in front."""
        self._by_position.clear()

    def rebuild(self, clauses: Iterable[Clause]) -> None:
        """Rebuild the existing indexes from the given clauses."""
        positions = list(self._by_position)
        self._by_position.clear()
        for position in positions:
            self._build(position, clauses)

    def without_variables(self) -> List[Tuple[int, Index]]:
        """Return the positions and indexes of arguments in which no clause has a variable, in order."""
        return [
            (position, index)
            for position, index in sorted(self._by_position.items())
            if not index.unkeyed_clauses
        ]

    def __len__(self) -> int:
        """Return the number of stored references to clauses."""
        return sum(map(len, self._by_position.values()))


def indexed_step(
    position: int,
    clauses_by_key: Dict[object, List[Clause]],
    choices: List[Frame],
    search: Callable[..., Optional[Frame]],
    otherwise: Step,
) -> Step:
    """Return a step that runs a call through an index, valid as long as the predicate does not change.

    In most tables of facts or rules, one argument is bound in most calls and selects a single clause. The step
    executes that clause without selecting candidates and without a choice point.

    Args:
        position: position of the indexed argument, from 0; no clause has a variable there.
        clauses_by_key: the clauses by the key of that argument.
        choices: the choice point stack of the machine.
        search: finds a ground fact; see `fact_search`.
        otherwise: step for calls that leave several clauses, or one that has not been compiled yet.
    """
    item_index = position + 1

    # Dereferencing and the key are written inline: the step is the hot path of every call of the predicate.
    def run(frame: Frame) -> Optional[Frame]:
        arg: Any = frame[item_index]
        arg_class = arg.__class__
        while arg_class is Var:
            ref = arg.ref
            if ref is None:
                return otherwise(frame)
            arg = ref
            arg_class = ref.__class__
        candidates = clauses_by_key.get(
            arg if arg_class is Atom or arg_class is int else arg[0] if arg_class is tuple else key_of(arg)
        )
        if candidates is None:
            return None
        if len(candidates) == 1:
            clause = candidates[0]
            if clause.is_ground_fact:
                return search(frame, candidates, 0, 1, 0, None)
            if clause.code is not None:
                return clause.code((*frame, len(choices)))
        return otherwise(frame)

    return run
