"""Index of records by argument, and look-ups by pattern: the newest or next record that unifies with a term.

``prev/5`` and ``next_inf/5`` return the record nearest to an instant, whatever it contains. The ``*_matching``
predicates continue to the first record that unifies with a pattern. If an argument of the pattern is an atom or
integer, an index of the records by that argument is used. It is created at the first such look-up and updated at
later ones, so recording does not become slower (just-in-time indexing, as in SWI-Prolog).
"""

from bisect import bisect_left
from typing import Any, Dict, List, Sequence, Tuple, Union

from ...foundation.cancellation import check_limits
from ...prolog.builtins.time_predicates import instant_of
from ...prolog.machine.machine import Machine
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms import timestamps
from ...prolog.terms.term_traversal import copy
from ...prolog.terms.types import Atom, Term, deref
from .memory import Memory, MemoryInstance
from .memory_registry import MemoryInstances

RECORDS_PER_CHECK = 1024
"""Records after which cancellation and limits of the goal are checked."""


class RecordIndex:
    """Positions of the records of a memory by one of their arguments.

    Each look-up first adds the records since the last one. The index belongs to the lists of the memory; when the
    memory replaces its lists, once in a quarter of its size, the index is dropped.

    Args:
        memory: the memory.
        position: position of the argument.
    """

    __slots__ = ("_argument_position", "_records", "_indexed_count", "_positions", "_others")

    def __init__(self, memory: Memory, position: int):
        self._argument_position = position
        self._records = memory.records
        self._indexed_count = 0
        self._positions: Dict[Any, List[int]] = {}
        self._others: List[int] = []

    def positions_of(self, value: Any) -> List[int]:
        """Return the positions of all records that may have this atom or integer as the argument, in order."""
        argument_position, records = self._argument_position, self._records
        for index in range(self._indexed_count, len(records)):
            term: Any = deref(records[index][0])
            argument = (
                deref(term[argument_position])
                if term.__class__ is tuple and argument_position < len(term)
                else None
            )
            if argument.__class__ is Atom or argument.__class__ is int:
                self._positions.setdefault(argument, []).append(index)
            elif argument is not None:
                self._others.append(index)
            # Updated for each record: `check_limits` may raise, and a record must not be added twice.
            self._indexed_count = index + 1
            if not index % RECORDS_PER_CHECK:
                check_limits(RECORDS_PER_CHECK)
        positions = self._positions.get(value, _NO_POSITIONS)
        return sorted(positions + self._others) if self._others else positions


_NO_POSITIONS: List[int] = []


def candidate_positions(memory: Memory, record: Term) -> Union[List[int], range]:
    """Return the positions of the records that may unify with a term, in order.

    Positions beyond the memory's size are included.
    """
    record = deref(record)
    positions: Union[List[int], range] = range(len(memory.records))
    if record.__class__ is tuple:
        for position, argument in enumerate(record[1:], 1):
            value = deref(argument)
            if value.__class__ is Atom or value.__class__ is int:
                index = memory.indices.get(position)
                if index is None:
                    index = memory.indices[position] = RecordIndex(memory, position)
                # Of several indexed arguments, the one with the fewest records is used.
                indexed_positions = index.positions_of(value)
                if len(indexed_positions) < len(positions):
                    positions = indexed_positions
    return positions


def define_matching(logic: PrologSystem, memories: MemoryInstances) -> None:
    """Define the deterministic predicates that search for a record by pattern."""

    def unify_newest(machine: Machine, name: Term, record: Term, start: Term, end: Term) -> bool:
        instance = memories.find(name)
        if instance is None:
            return False
        memory = instance.memory
        return _unify_first(
            machine, instance, (record, start, end), memory.first_position, len(memory.ends), -1
        )

    def unify_prev(machine: Machine, name: Term, record: Term, start: Term, end: Term, time: Term) -> bool:
        instant, instance = instant_of(time), memories.find(name)
        if instance is None:
            return False
        memory = instance.memory
        return _unify_first(
            machine, instance, (record, start, end), memory.first_position, memory.position_after(instant), -1
        )

    def unify_next_inf(
        machine: Machine, name: Term, record: Term, start: Term, end: Term, time: Term
    ) -> bool:
        instant, instance = instant_of(time), memories.find(name)
        if instance is None:
            return False
        memory = instance.memory
        return _unify_first(
            machine, instance, (record, start, end), memory.position_reaching(instant), len(memory.ends), 1
        )

    def unify_next(
        machine: Machine, name: Term, record: Term, start: Term, end: Term, low: Term, high: Term
    ) -> bool:
        first_instant, last_instant, instance = instant_of(low), instant_of(high), memories.find(name)
        if instance is None:
            return False
        memory = instance.memory
        return _unify_first(
            machine,
            instance,
            (record, start, end),
            memory.position_reaching(first_instant),
            memory.position_after(last_instant),
            1,
        )

    logic.define("newest_matching", 4, unify_newest)
    logic.define("prev_matching", 5, unify_prev)
    logic.define("next_inf_matching", 5, unify_next_inf)
    logic.define("next_matching", 6, unify_next)


def _unify_first(
    machine: Machine,
    instance: MemoryInstance,
    target: Tuple[Term, Term, Term],
    start_position: int,
    end_position: int,
    step: int,
) -> bool:
    """Unify with the first matching record between two positions.

    Args:
        machine: the machine.
        instance: the memory.
        target: record, start and end to unify with.
        start_position: first position.
        end_position: position after the last one.
        step: 1 to search forwards, -1 to search backwards.
    """
    memory, (record, start, end) = instance.memory, target
    positions: Sequence[int] = candidate_positions(memory, record)
    low, high = bisect_left(positions, start_position), bisect_left(positions, end_position)
    order = range(low, high) if step > 0 else range(high - 1, low - 1, -1)
    for count, index in enumerate(order, 1):
        if not count % RECORDS_PER_CHECK:
            check_limits(RECORDS_PER_CHECK)
        term, start_instant, end_instant = memory.records[positions[index]]
        # Variables in a stored record belong to the memory; the reader gets new ones.
        record_term = copy(term) if instance.has_variables else term
        to_time_term = timestamps.shown
        if machine.unify_all(
            (record, record_term), (start, to_time_term(start_instant)), (end, to_time_term(end_instant))
        ):
            return True
    return False
