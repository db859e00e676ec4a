"""Transfer functions of goals: how a goal that succeeds changes the kinds of its variables.

The analysis is context-insensitive: the kinds of an argument are those of all clauses of its predicate, whatever the
arguments of the call are. Built-in predicates have the kinds of `_RESULTS`, or bind variables to unknown values.
"""

from typing import Any, Callable, Dict

from ...prolog.terms.types import COMMA, Atom, CompoundTerm, String, Var, deref, functor
from ..language.rule_heads import makes_event
from ..language.state_parser import HOLDS
from .abstract_environment import AbstractValue, Environment
from .abstract_store import AbstractStore, clause_head, raised_event
from .condition_checks import IS, NUMERIC_COMPARISONS
from .created_event_values import CreatedEvents
from .memory_and_state_checks import RECORD_READS
from .predicate_checks import ASSERTING_PREDICATES
from .program_model import ProgramModel
from .value_conflict_reports import ConflictReporter, place_in
from .value_kinds import (
    COMPOUND,
    LIST,
    NUMBER,
    STRING,
    TEXT,
    Kinds,
    ValueOrigin,
    are_disjoint,
    join,
    numeric_kinds,
)

MAX_NESTING = 100
"""Maximum depth of nested patterns and goals that are followed; deeper ones are not evaluated."""

_UNIFICATIONS = frozenset((functor("=", 2), functor("==", 2)))
_INEQUALITIES = frozenset((functor("\\=", 2), functor("\\==", 2)))
_OR, _NOT = functor(";", 2), functor("\\+", 1)
_CONDITIONALS = frozenset((functor("->", 2), functor("*->", 2)))
_ATOM = functor("atom", 1)
_TRANSPARENT = frozenset((functor("call", 1), functor("once", 1)))
_LOCAL_GOALS = {
    _NOT: (1,),
    functor("ignore", 1): (1,),
    functor("forall", 2): (1, 2),
    functor("findall", 3): (2,),
    functor("findall", 4): (2,),
    functor("aggregate_all", 3): (2,),
    functor("catch", 3): (1,),
}
"""Goals whose arguments are goals with solutions that bind no variable, or not for certain; with their positions."""

_RESULTS = {
    functor("findall", 3): {3: LIST},
    functor("atom_number", 2): {2: NUMBER},
    functor("atom_length", 2): {2: NUMBER},
    functor("string_length", 2): {2: NUMBER},
    functor("length", 2): {2: NUMBER},
    functor("number_string", 2): {1: NUMBER},
    functor("between", 3): {3: NUMBER},
    functor("atom_string", 2): {2: STRING},
    functor("string_concat", 3): {3: STRING},
}
"""Built-in predicates with the kinds of their results, by position."""


class GoalTransfer:
    """Transfer functions of goals.

    Args:
        store: kinds of predicates, states and records that goals read and add to.
        created_events: receives the events that goals raise.
        conflicts: receives comparisons, calls and reads of values that are never equal.
    """

    def __init__(
        self,
        program: ProgramModel,
        store: AbstractStore,
        created_events: CreatedEvents,
        conflicts: ConflictReporter,
    ):
        self._program = program
        self._store = store
        self._created_events = created_events
        self._conflicts = conflicts
        self._calls: Dict[Any, Callable[[CompoundTerm, Environment], None]] = {
            **dict.fromkeys((*_UNIFICATIONS, *_INEQUALITIES), self._compare),
            **dict.fromkeys(NUMERIC_COMPARISONS, self._compare_numbers),
            IS: self._evaluate_number,
            **dict.fromkeys(RECORD_READS, self._read_record),
            **dict.fromkeys(HOLDS, self._query_state),
            **dict.fromkeys(ASSERTING_PREDICATES, self._assert_clause),
            functor("retract", 1): self._retract_fact,
            functor("format", 3): self._format_atom,
        }

    def run(self, parent: CompoundTerm, position: int, environment: Environment, depth: int = 0) -> None:
        """Bind the variables of a goal that succeeds, in the order of its calls.

        Args:
            parent: term with the goal as an argument, whose place is known.
            position: the position of the goal.
            environment: kinds of variables; changed.
            depth: number of goals and patterns around it.
        """
        if depth > MAX_NESTING:
            return
        pending = [(parent, position)]
        while pending:
            parent, position = pending.pop()
            goal: Any = deref(parent[position])
            if goal.__class__ is not tuple:
                continue
            key = goal[0]
            if key is COMMA:
                pending += [(goal, 2), (goal, 1)]
            elif key in _TRANSPARENT:
                pending.append((goal, 1))
            elif key is _OR or key in _CONDITIONALS:
                self._run_alternatives(goal, environment, depth)
            elif key in _LOCAL_GOALS:
                for goal_position in _LOCAL_GOALS[key]:
                    self.run(goal, goal_position, environment.copy(), depth + 1)
                self._bind_results(goal, environment)
            else:
                self._run_call(goal, environment)

    def _run_alternatives(self, goal: CompoundTerm, environment: Environment, depth: int) -> None:
        """Evaluate the branches of a disjunction or conditional, whose bindings are not known afterwards."""
        branches = [goal]
        while branches:
            branch = branches.pop()
            if branch[0] is _OR:
                for position in (1, 2):
                    inner: Any = deref(branch[position])
                    if inner.__class__ is tuple and (inner[0] is _OR or inner[0] in _CONDITIONALS):
                        branches.append(inner)
                    else:
                        self.run(branch, position, environment.copy(), depth + 1)
            else:
                # The second goal of a conditional continues with the bindings of the first one.
                branch_environment = environment.copy()
                self.run(branch, 1, branch_environment, depth + 1)
                self.run(branch, 2, branch_environment, depth + 1)

    def _run_call(self, goal: CompoundTerm, environment: Environment) -> None:
        run = self._calls.get(goal[0])
        if self._store.has_predicate(goal[0]):
            self._call_predicate(goal, environment)
        elif run is not None:
            run(goal, environment)
        elif makes_event(goal):
            self._created_events.add(raised_event(goal), environment)
        else:
            self._bind_results(goal, environment)

    # Predicates

    def _call_predicate(self, goal: CompoundTerm, environment: Environment) -> None:
        key = goal[0]
        for position, kinds in enumerate(self._store.read_predicate(key), 1):
            environment.bind_argument(goal, position, kinds, f"argument {position} of {key}")

    def _assert_clause(self, goal: CompoundTerm, environment: Environment) -> None:
        head: Any = clause_head(goal[1])
        if head.__class__ is tuple and self._store.has_predicate(head[0]):
            self._store.add_clause(head, environment)

    def _retract_fact(self, goal: CompoundTerm, environment: Environment) -> None:
        fact: Any = deref(goal[1])
        if fact.__class__ is tuple and self._store.has_predicate(fact[0]):
            self._call_predicate(fact, environment)

    def _bind_results(self, goal: CompoundTerm, environment: Environment) -> None:
        key = goal[0]
        if key in _RESULTS and self._program.logic.is_system_predicate(key):
            for position, kind in _RESULTS[key].items():
                kinds: Kinds = {kind: ValueOrigin(f"result of {key}")}
                environment.bind_argument(goal, position, kinds, f"the result of {key}")

    def _format_atom(self, goal: CompoundTerm, environment: Environment) -> None:
        """Bind the variable of ``format(atom(Text), Format, Values)`` if the format has the quotes of a text."""
        target: Any = deref(goal[1])
        text_format: Any = deref(goal[2])
        content = text_format.text if text_format.__class__ is String else getattr(text_format, "name", "")
        is_quoted = len(content) > 1 and content[0] == content[-1] == '"'
        if is_quoted and target.__class__ is tuple and target[0] is _ATOM:
            origin = ValueOrigin("", text_format, place_in(environment.part, goal, 2))
            environment.bind_argument(target, 1, {TEXT: origin}, "the result of format/3")

    # States and memories

    def _query_state(self, goal: CompoundTerm, environment: Environment) -> None:
        state: Any = deref(goal[1])
        if state.__class__ is tuple and self._store.has_event(state[0]):
            for position, kinds in enumerate(self._store.read_event(state[0]), 1):
                environment.bind_argument(state, position, kinds, f"argument {position} of {state[0]}")

    def _read_record(self, goal: CompoundTerm, environment: Environment) -> None:
        """Bind the variables of a record that a goal reads from a memory."""
        name: Any = deref(goal[1])
        record: Any = deref(goal[2])
        records = self._store.read_records(name.name) if isinstance(name, Atom) else None
        if records is None:
            return
        subject = f"the record of memory {name.name}"
        if record.__class__ is tuple and None not in records:
            # A record that has not been computed yet has no values: with unknown ones, the result would stay unknown.
            values = records.get(record[0], [{} for _ in record[1:]])
            for position, kinds in enumerate(values, 1):
                environment.bind_argument(record, position, kinds, f"argument {position} of {subject}")
        elif record.__class__ is Var or set(records) == {None}:
            # Constants and terms of another form are reported by `find_record_mismatches`.
            record_kinds: Kinds = {}
            for key, values in records.items():
                compound: Kinds = {COMPOUND: ValueOrigin(subject)}
                record_kinds = join(record_kinds, values[0] if key is None else compound)
            environment.bind_argument(goal, 2, record_kinds, subject)

    # Comparisons and arithmetic

    def _compare(self, goal: CompoundTerm, environment: Environment) -> None:
        """Bind or check the two sides of ``=`` or ``==``, or check those of their negations."""
        left: Any
        right: Any
        left, right = deref(goal[1]), deref(goal[2])
        for other_position, var, other in ((2, left, right), (1, right, left)):
            if var.__class__ is not Var:
                continue
            kinds = environment.kinds_of(goal, other_position)
            if self._is_reported_conflict(var, other, kinds, environment):
                self._report_comparison(goal, other_position, var, kinds, environment)
                # The other side would report the same conflict.
                return
            if goal[0] in _UNIFICATIONS and kinds is not None:
                environment.constrain(var, kinds)

    def _is_reported_conflict(self, var: Var, other: Any, kinds: Kinds, environment: Environment) -> bool:
        """Return whether a variable is never equal to the other side of a comparison, and that is reported here."""
        known = environment.value_of(var)
        if not self._conflicts.is_enabled or known is None or not are_disjoint(known.kinds, kinds):
            return False
        # `find_type_conflicts` reports slots of messages in one rule.
        other_known = environment.value_of(other) or known
        return not (known.is_direct and (other.__class__ is not Var or other_known.is_direct))

    def _report_comparison(
        self, goal: CompoundTerm, other_position: int, var: Var, other_kinds: Kinds, environment: Environment
    ) -> None:
        part = environment.part
        known = environment.value_of(var) or AbstractValue(None, False)
        other: Any = deref(goal[other_position])
        place = place_in(part, goal, other_position)
        if other.__class__ is Var:
            other_name = self._conflicts.name_of(part, other)
            self._conflicts.report_clash(part, var, known.kinds, other_kinds, other_name, place)
        else:
            self._conflicts.report_compared_constant(part, var, other, known.kinds, place)

    def _compare_numbers(self, goal: CompoundTerm, environment: Environment) -> None:
        for position in (1, 2):
            self._check_expression(goal, position, environment)

    def _evaluate_number(self, goal: CompoundTerm, environment: Environment) -> None:
        self._check_expression(goal, 2, environment)
        # A constant as the result is a mistake of one goal, no flow.
        if deref(goal[1]).__class__ is Var:
            environment.bind_argument(goal, 1, {NUMBER: ValueOrigin("result of is")}, "the result of is")

    def _check_expression(self, goal: CompoundTerm, position: int, environment: Environment) -> None:
        """Check the variables of an arithmetic expression; those that are compared are numbers afterwards."""
        operands = [(goal, position)]
        while operands:
            parent, operand_position = operands.pop()
            term: Any = deref(parent[operand_position])
            if term.__class__ is tuple and term[0].name not in ("[|]", "."):
                operands += [(term, argument_position) for argument_position in range(len(term) - 1, 0, -1)]
            elif term.__class__ is Var:
                self._check_operand(term, parent, operand_position, environment)

    def _check_operand(self, var: Var, parent: CompoundTerm, position: int, environment: Environment) -> None:
        known = environment.value_of(var)
        if known is None or known.kinds is None:
            environment.set_value(var, AbstractValue(numeric_kinds(), False))
        elif are_disjoint(known.kinds, numeric_kinds()):
            if self._conflicts.is_enabled and not known.is_direct:
                part = environment.part
                self._conflicts.report_operand(part, var, known.kinds, place_in(part, parent, position))
            # One finding for each variable is enough.
            environment.set_value(var, AbstractValue(None, known.is_direct))
