"""Predicates: clauses, calls, and the transition from interpretation to compiled code.

A predicate starts interpreted: clauses are selected through indexes and unified by the general routine. That needs no
preparation and suits facts and predicates that change often. After `COMPILE_AFTER` calls without a change the
predicate is compiled to one function, or, if it has many clauses, calls go through its indexes and clauses are
compiled one by one. A change returns it to interpretation and doubles the number of calls before the next attempt, so
a predicate that alternates between calls and changes is not compiled over and over.

Changes follow the logical update view: a call sees the clauses that existed when it began. Retracted clauses are
marked with the generation of their removal and dropped later. Lists that running calls may hold are never shortened.
"""

from itertools import islice
from typing import TYPE_CHECKING, Any, Callable, Dict, Hashable, Iterator, List, Optional, Tuple

from ...foundation.limit_checks import check_limits
from ..compiler.clause_nodes import FunctionalModes, PredicateResolver
from ..compiler.predicate_code import ClauseParts, PredicateGenerator, fact_search
from ..machine.errors import PrologError
from ..machine.machine import Code, Machine
from ..terms.term_traversal import copy
from ..terms.types import Frame, Functor, Step, Term, Trail, Values, Var
from ..terms.unification import undo, unify
from .clause_index import (
    NEVER_RETRACTED,
    Clause,
    Indexes,
    indexed_step,
    keys_of,
    match_head,
    may_match,
)

if TYPE_CHECKING:
    from ..compiler.semidet_functions import FunctionCode
    from .predicate_database import Database

NEVER_COMPILE = 1 << 62
"""Number of calls that no predicate reaches: a predicate with this limit is only interpreted."""

COMPILE_AFTER = 12
"""Calls without a change of the predicate after which it is compiled."""

_MAX_COMPILED_CLAUSES = 24
"""Maximum number of clauses of a predicate that is compiled as a whole.

Larger predicates are called through their indexes, and their clauses are compiled one by one."""

_MAX_COMPILED_FACTS = 8
"""Maximum number of clauses of a predicate that consists of facts and is compiled as a whole."""

_SLOW_SEARCH_CLAUSES = 1000
"""Number of candidates above which the search checks the limits, because it takes as long as many inferences."""


class Predicate:
    """Predicate, the code of frames ``(predicate, argument..., next)``.

    Attributes:
        database: the database that it belongs to.
        functor: name and arity.
        run: step that runs a call; replaced when the predicate changes.
        keeps_choice_points: whether that step leaves the choice point stack unchanged; see
            `Code.keeps_choice_points`.
        kind: "user", "builtin" (deterministic Python), "control" (other Python), or "undefined".
        function: Python function that compiled clauses call inline, for a built-in.
        function_code: function form of the predicate, if it is called as a function.
        make_pushdown_filter: returns the pushdown filter of calls; see `PredicateTable.define_control`.
        functional_modes: inputs and outputs, if it is a function of some of its arguments.
        bound_argument_builtin: functor of the deterministic built-in for calls with a bound first argument, or None.
        dynamic: whether the program may assert and retract clauses.
        is_dynamic_by_goal: whether it is dynamic only because a goal has asserted or retracted clauses.
        discontiguous: whether its clauses may be separated by those of other predicates.
        multifile: whether its clauses may be in several files.
        is_locked: whether programs may not redefine it, if it is a library predicate.
        is_library_predicate: whether it belongs to the system.
        is_protected: whether goals may neither read its clauses nor add clauses, if it is a library predicate.
        has_warned_undefined: whether a warning about calls of the undefined predicate has been issued.
        is_compiled: whether `run` is compiled code.
        hidden_predicate: predicate that owns the clauses, if calls are answered by tables.
        is_incremental: whether tables that depend on it are reevaluated after a change of its clauses (see `observe`)
            or, if it is tabled itself, of its answers.
        has_only_ground_facts: whether all clauses are ground facts.
        clauses: clauses in order, including retracted ones.
        retracted_count: number of retracted clauses in `clauses`.
        call_count: calls since the last change, attempt to compile, or discarding of compiled code.
        compile_after: number of calls after which compilation is tried.
        indexes: indexes of the clauses.
    """

    def __init__(self, database: "Database", functor: Functor):
        self.database = database
        self.functor = functor
        self.kind = "undefined"
        self.function: Optional[Callable[..., Any]] = None
        self.make_pushdown_filter: Optional[Callable[[Functor, Tuple[int, ...]], object]] = None
        self.functional_modes: Optional[FunctionalModes] = None
        self.bound_argument_builtin: Optional[Functor] = None
        self.dynamic = False
        self.is_dynamic_by_goal = False
        self.discontiguous = False
        self.multifile = False
        self.is_locked = False
        self.is_protected = False
        self.is_library_predicate = False
        self.has_warned_undefined = False
        self.is_compiled = False
        self.hidden_predicate: Optional[Predicate] = None
        self.is_incremental = False
        self._on_read: Optional[Callable[[Predicate], None]] = None
        self._revision = 0
        self.function_code: Optional[FunctionCode] = None
        self.has_only_ground_facts = False
        self._search_by_position: Dict[Optional[int], Callable[..., Optional[Frame]]] = {}
        self.clauses: List[Clause] = []
        self.retracted_count = 0
        self.call_count = 0
        self.compile_after = database.compile_after
        self.indexes = Indexes(functor.arity)
        self.run: Step = self._run_interpreted
        self.keeps_choice_points = False
        self._retry = Code(str(functor), self._retry_call)
        self._retry.functor = functor

    def __repr__(self) -> str:
        return f"<{self.functor}>"

    @property
    def is_defined(self) -> bool:
        """True if a call raises no existence error."""
        return self.kind != "undefined" or self.dynamic

    @property
    def is_undeclared(self) -> bool:
        """True if it has neither a definition nor a declaration."""
        return not (
            self.is_defined
            or self.clauses
            or self.discontiguous
            or self.multifile
            or self.is_library_predicate
        )

    @property
    def is_forgettable(self) -> bool:
        """True if it has no clauses, and goals of the program alone have made it dynamic."""
        return (
            self.is_dynamic_by_goal
            and not self.clauses
            and not (self.discontiguous or self.multifile or self.is_library_predicate or self.is_incremental)
        )

    @property
    def is_static_user_predicate(self) -> bool:
        """True if it consists of clauses of the program that goals may not change."""
        return self.kind == "user" and not self.dynamic and not self.is_library_predicate

    @property
    def clause_owner(self) -> "Predicate":
        """The predicate that owns the clauses; for a tabled predicate, the hidden one that computes the answers."""
        return self if self.hidden_predicate is None else self.hidden_predicate

    def active_clauses(self) -> Iterator[Clause]:
        """Yield the clauses that have not been retracted, in order."""
        return (clause for clause in list(self.clauses) if clause.retracted_at == NEVER_RETRACTED)

    def last_clauses(self, count: int) -> List[Clause]:
        """Return the last clauses that have not been retracted, the last one first."""
        active = (clause for clause in reversed(self.clauses) if clause.retracted_at == NEVER_RETRACTED)
        return list(islice(active, count))

    def __len__(self) -> int:
        return len(self.clauses) - self.retracted_count

    # Changes

    def add(self, clause: Clause, first: bool = False) -> None:
        """Add a clause as the last or, if ``first``, as the first one."""
        self.has_only_ground_facts = (
            clause.is_ground_fact
            and self.functor.arity > 0
            and (self.has_only_ground_facts or not self.clauses)
        )
        self.record_change()
        # Running calls hold positions in the list, so the list is replaced if a clause is added in front.
        if first:
            self.clauses = [
                clause,
                *[existing for existing in self.clauses if existing.retracted_at == NEVER_RETRACTED],
            ]
            self.kind = "user"
            self.retracted_count = 0
            self.indexes.clear()
            return
        self.clauses.append(clause)
        self.kind = "user"
        self.indexes.add(clause)

    def remove(self, clause: Clause) -> bool:
        """Retract a clause, which running calls still see.

        Returns:
            Whether it had not been retracted before.
        """
        if clause.retracted_at != NEVER_RETRACTED:
            return False
        self.record_change()
        self.database.count_retraction()
        clause.retracted_at = self.database.generation
        self.retracted_count += 1
        # Dropping them when half of the clauses are retracted keeps the cost per retraction constant on average.
        if self.retracted_count == len(self.clauses) or (
            self.retracted_count > 16 and self.retracted_count * 2 > len(self.clauses)
        ):
            self._drop_retracted_clauses()
            self.indexes.clear()
        return True

    def _drop_retracted_clauses(self) -> None:
        """Drop retracted clauses from the list. The indexes are not updated; the caller clears or rebuilds them."""
        self.clauses = list(self.active_clauses())
        self.retracted_count = 0

    def clear(self) -> None:
        """Retract all clauses."""
        for clause in list(self.active_clauses()):
            self.remove(clause)

    def make_dynamic(self, by_goal: bool = False) -> None:
        """Make the predicate dynamic.

        Args:
            by_goal: whether a goal that asserts or retracts clauses does so, and not a declaration.
        """
        self.is_dynamic_by_goal = by_goal and (self.is_dynamic_by_goal or not self.dynamic)
        self.dynamic = True

    def abolish(self) -> None:
        """Remove all clauses and declarations, so that a call is an existence error."""
        self.clear()
        # Also if there were no clauses: compiled code fails, and has to be replaced by code that raises the error.
        self.record_change()
        self.dynamic = self.is_dynamic_by_goal = self.discontiguous = self.multifile = False
        if self.kind == "user":
            self.kind = "undefined"

    def record_change(self) -> None:
        """Record a change of the clauses and return to interpretation."""
        self.database.count_change()
        self._revision += 1
        if self.is_compiled:
            self.is_compiled = self.keeps_choice_points = False
            self._set_run(self._run_interpreted)
            # A predicate that alternates between calls and changes is compiled ever more rarely.
            self.compile_after *= 2
        self.call_count = 0
        if self.function_code is not None:
            self.function_code.reset(self)

    def set_tabled(self, hidden: "Predicate", run: Step) -> None:
        """Make the predicate tabled: a step answers calls from tables, and the hidden predicate owns the clauses."""
        self.hidden_predicate = hidden
        self.kind = "control"
        self.clauses = []
        self.indexes.clear()
        self.run = run
        self.keeps_choice_points = False

    def discard_compiled_code(self) -> None:
        """Discard compiled code, because a predicate that it refers to has been redefined."""
        if self.function_code is not None:
            self.function_code.reset(None)
        if self.kind == "user":
            self.is_compiled = self.keeps_choice_points = False
            self._set_run(self._run_interpreted)
            self.call_count = 0
            for clause in self.clauses:
                clause.discard_code()

    # Reads by incremental tables

    def observe(self, on_read: "Callable[[Predicate], None]") -> None:
        """Call ``on_read`` before each call and each access that is reported by `report_read` from then on.

        Only the first observer is registered. Calls from functions of compiled goals (see `FunctionCode`) are
        excluded, because these evaluate no tables.
        """
        if self._on_read is not None:
            return
        self.is_incremental = True
        self._on_read = on_read
        self.database.count_change()
        self._set_run(self.run)

    def report_read(self) -> None:
        """Report an access to the clauses to the observer."""
        if self._on_read is not None:
            self._on_read(self)

    def version(self, part: Hashable = None) -> int:
        """Return a number that differs after each change of the clauses.

        ``part`` is ignored, because all clauses have one version.
        """
        return self._revision

    def _set_run(self, step: Step) -> None:
        """Set the step that runs calls, preceded by the report of a read if the predicate is observed."""
        on_read = self._on_read
        if on_read is None:
            self.run = step
            return

        def run(frame: Frame) -> Optional[Frame]:
            on_read(self)
            return step(frame)

        self.run = run

    # Calls of interpreted clauses

    def _run_interpreted(self, frame: Frame) -> Optional[Frame]:
        """Run a call of the predicate from its clauses; compile it first if it is called often."""
        if self.kind == "undefined":
            return self.database.call_undefined(self, frame)
        self.call_count += 1
        if (
            (self.call_count > self.compile_after or self.is_library_predicate)
            and not self.is_compiled
            and self._compile()
        ):
            return self.run(frame)
        clauses, position = self.indexes.select(self.clauses, frame)
        if len(clauses) > _SLOW_SEARCH_CLAUSES:
            check_limits(0)  # the search may take long, so check for cancellation first
        generation = self.database.generation
        if self.has_only_ground_facts:
            # Keys are compared to find out whether another fact may match; for a single candidate they are not
            # needed.
            keys = keys_of(frame, position) if len(clauses) > 1 else None
            search = self._search_by_position.get(position) or self._make_search(position)
            return search(frame, clauses, 0, len(clauses), generation, keys)
        keys = keys_of(frame, position)
        return self._advance(frame, clauses, 0, len(clauses), generation, keys)

    def fact_finder(self, first_is_enough: bool) -> Callable[..., Optional[bool]]:
        """Return a function of the arguments that looks up a ground fact (see `FunctionCode`).

        Args:
            first_is_enough: whether the first matching fact is enough. If not, the function returns None if there are
                several.
        """
        choices = self.database.machine.choices

        def find(*args: Term) -> Optional[bool]:
            if not self.has_only_ground_facts:
                return None
            # The next frame is never run; any value except None indicates that a fact was found.
            frame = (self, *args, True)
            clauses, position = self.indexes.select(self.clauses, frame)
            search = self._search_by_position.get(position) or self._make_search(position)
            height = len(choices)
            keys = keys_of(frame, position)
            if search(frame, clauses, 0, len(clauses), self.database.generation, keys) is None:
                return False
            # The search has pushed a choice point, so another fact may match.
            if len(choices) > height:
                del choices[height:]
                return True if first_is_enough else None
            return True

        return find

    def _make_search(self, position: Optional[int]) -> Callable[..., Optional[Frame]]:
        names = fact_names(self.database.machine)
        search = self._search_by_position[position] = fact_search(self.functor.arity, position, names)
        return search

    def select(self, frame: Frame) -> Tuple[List[Clause], Optional[int]]:
        """Return a list with all clauses that a call may match, and the position of the index used, or None."""
        return self.indexes.select(self.clauses, frame)

    def _retry_call(self, entry: Frame) -> Optional[Frame]:
        return self._advance(*entry[1:-1])

    def _advance(  # noqa: C901 -- the loop of all interpreted calls; a call per clause would slow it
        self,
        frame: Frame,
        clauses: List[Clause],
        position: int,
        end: int,
        generation: int,
        keys: Optional[List[object]],
    ) -> Optional[Frame]:
        """Try the clauses from ``position`` up to ``end``, pushing a choice point if another one may match.

        Args:
            frame: the call.
            clauses: candidates, including retracted ones.
            position: position of the first clause to try.
            end: number of clauses when the call began; later ones are invisible to it.
            generation: generation when the call began; clauses retracted since then are visible to it.
            keys: first-level keys of the arguments; None if no argument has a key, except the one that an index
                has compared.
        """
        machine = self.database.machine
        trail = machine.trail
        while position < end:
            clause = clauses[position]
            position += 1
            if clause.retracted_at <= generation or keys is not None and not may_match(keys, clause.keys):
                continue
            # The next candidate is searched first: without one no choice point is pushed, and the call is
            # deterministic.
            while position < end:
                next_clause = clauses[position]
                if next_clause.retracted_at > generation and (
                    keys is None or may_match(keys, next_clause.keys)
                ):
                    break
                position += 1
            height = len(machine.choices)
            mark = len(trail)
            # Facts need neither a frame for the body nor compilation. A static non-ground fact that is the last
            # candidate is treated as a rule instead, so that it gets compiled.
            if clause.is_fact and (position < end or clause.is_ground_fact or self.dynamic):
                if match_head(frame, clause, {}, trail):
                    if position < end:
                        machine.choices.append(
                            (self._retry, frame, clauses, position, end, generation, keys, mark)
                        )
                    return frame[-1]  # type: ignore[no-any-return]
                undo(trail, mark)
                continue
            if position < end:
                machine.choices.append((self._retry, frame, clauses, position, end, generation, keys, mark))
            code = clause.code
            if code is None:
                clause.call_count += 1
                if clause.call_count <= self.database.compile_after and not self.is_library_predicate:
                    return self._interpret(frame, clause, height, trail)
                code = self._compile_clause(clause)
                if code is None:
                    return self._interpret(frame, clause, height, trail)
            return code((*frame, height))
        return None

    def _interpret(self, frame: Frame, clause: Clause, height: int, trail: Trail) -> Optional[Frame]:
        """Unify a call with the head of a clause, and return the frame that interprets the body."""
        fresh: Dict[Var, Term] = {}
        if not match_head(frame, clause, fresh, trail):
            return None
        return self.database.control.solve(copy(clause.body, fresh), height, frame[-1])

    # Compilation

    def precompile(self) -> None:
        """Compile the predicate before it is called, unless a compiled version has been invalidated by a change."""
        if (
            self.is_compiled
            or self.compile_after != self.database.compile_after
            or self.database.is_interpreter_only
        ):
            return
        try:
            self._compile()
        except (PrologError, RecursionError):
            # The first call raises the error, with its caller as context.
            self.is_compiled = False

    def _compile(self) -> bool:
        """Compile the predicate as a whole, or let calls go through its indexes; return whether either was done."""
        self.call_count = 0
        clauses = list(self.active_clauses())
        count = len(clauses)
        has_only_facts = all(clause.is_fact for clause in clauses)
        is_too_large = count > (_MAX_COMPILED_FACTS if has_only_facts else _MAX_COMPILED_CLAUSES)
        if not count or any(clause.is_large for clause in clauses):
            self.compile_after = NEVER_COMPILE
            return False
        if is_too_large:
            return self._call_through_indexes()
        parts = [ClauseParts(_arguments_of(clause.head), clause.body, clause.place) for clause in clauses]
        generator = PredicateGenerator(self._resolver(), self.functor, parts, self)
        self._set_run(generator.generate())
        self.keeps_choice_points = generator.keeps_choice_points
        self.is_compiled = True
        return True

    def _call_through_indexes(self) -> bool:
        """Let calls go through the existing indexes that have no variables; return whether there are any."""
        if self.retracted_count:
            self._drop_retracted_clauses()
            self.indexes.rebuild(self.clauses)
        choices = self.database.machine.choices
        # Indexes are tried in order of their arguments. If a step cannot select a single clause, it calls the step of
        # the next index, and the last one calls the interpreter.
        run: Step = self._run_interpreted
        for position, index in reversed(self.indexes.without_variables()):
            run = indexed_step(position, index.clauses_by_key, choices, self._make_search(position), run)
        if run == self._run_interpreted:
            self.compile_after *= 2
            return False
        self._set_run(run)
        self.is_compiled = True
        return True

    def _compile_clause(self, clause: Clause) -> Optional[Step]:
        """Return the compiled code of a clause, which it stores; None if the clause is too large."""
        if clause.is_large:
            clause.call_count = -NEVER_COMPILE
            return None
        parts = ClauseParts(_arguments_of(clause.head), clause.body, clause.place)
        clause.code = PredicateGenerator(self._resolver(), self.functor, [parts], self).generate_clause()
        return clause.code

    def _resolver(self) -> PredicateResolver:
        """Return the predicates that the clauses call: a redefinition by the program does not concern the library."""
        return self.database.library if self.is_library_predicate else self.database


def fact_names(machine: Machine) -> Dict[str, object]:
    """Return the global names of the code that searches facts."""
    return {
        "Var": Var,
        "unify": unify,
        "undo": undo,
        "trail": machine.trail,
        "push": machine.trail.append,
        "choose": machine.choices.append,
        "Code": Code,
        "may_match": may_match,
    }


def _arguments_of(head: Term) -> Values:
    return head[1:] if head.__class__ is tuple else ()
