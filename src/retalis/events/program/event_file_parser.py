"""Parser of event files: classification of terms as rules, clauses, directives and properties, with diagnostics.

The terms of a file are checked before anything takes effect. Each becomes a `FileEntry` or a `RuleDefinition`;
problems are collected, so that all errors of a file are reported together. Terms that look like misspelled rules get
advice (``->`` in place of ``<-``). A fact such as ``subscribe(...)`` without ``:-`` would redefine a built-in
predicate; it is rejected, unless the file clearly defines that predicate itself (see `predicates_defined_in`).
"""

from enum import Enum
from itertools import chain
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence, Set

from ...foundation.errors import Errors, RetalisError, RuleError
from ...foundation.source_places import Place
from ...prolog.builtins.grammar_and_ssu_rules import SINGLE_SIDED, translate_single_sided
from ...prolog.database.goal_terms import split_clause
from ...prolog.files.library_names import renaming_clauses
from ...prolog.machine.errors import PrologError
from ...prolog.syntax.term_reader import ReadTerm
from ...prolog.system.predicate_resolution import is_replaceable
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.list_terms import list_items
from ...prolog.terms.term_traversal import copy, variables
from ...prolog.terms.types import (
    COLON,
    COMMA,
    CONS,
    SLASH,
    TRUE,
    Atom,
    CompoundTerm,
    Functor,
    Term,
    Var,
    atom,
    deref,
    functor,
)
from ..language.called_predicates import PredicateCall, Subgoal, calls
from ..language.event_declarations import Declarations, calls_in_query, events_raised_by_goals, head_event
from ..language.event_operators import ARROWS, OPERATOR_NAMES, RESERVED_FACT_FUNCTORS
from ..language.likely_mistakes import uncovered_gap_warning
from ..language.pattern_parser import PatternReader, PlaceLookup, check_aggregate, check_window, no_place
from ..language.pattern_tree import ActionPattern, Pattern, RuleDefinition, bound_by, occurrences
from ..language.rule_heads import ALARMS, SYNCHRONIZED, check_head
from ..language.rule_labels import RULE, Property, is_rule, is_unlabelled_rule, label_error, split_label
from ..language.state_parser import HOLDS, STATE, declares_state
from ..language.timer_schedules import TIMER, sets_timer
from .file_directives import FileDeclarations, Goals, directive_goals

_CLAUSE = functor(":-", 2)
_GRAMMAR = functor("-->", 2)
DIRECTIVES = frozenset((functor(":-", 1), functor("?-", 1)))
PROPERTY_FACT = functor("event_rule_property", 3)
_LESS_THAN = functor("<", 2)
_MINUS = functor("-", 1)
_ETALIS_NAMES: Dict[Functor, Functor] = {
    functor("print_trigger", 1): functor("external_trigger", 1),
    functor("persistent_rule", 1): functor("persistent_event", 1),
    functor("module", 2): functor("etalis_module", 2),
}
"""Predicates of ETALIS programs, with the predicates for which they are another name."""

_CLAUSE_WRAPPERS = frozenset(functor(name, 1) for name in ("db", "prolog", "static"))


class EntryKind(Enum):
    """Effects of a `FileEntry`."""

    CLAUSE = "clause"
    """Add a clause."""
    DIRECTIVE = "directive"
    """Run a goal."""
    PROPERTY = "property"
    """Set a property of a label."""
    LOAD = "load"
    """Load a file."""
    LOAD_ONCE = "load_once"
    """Load a file unless it has been loaded before."""
    AT_END = "at_end"
    """Run a goal after all other entries."""


_LOAD_KINDS = {
    functor("use_module", 1): EntryKind.LOAD,
    functor("use_module", 2): EntryKind.LOAD,
    functor("ensure_loaded", 1): EntryKind.LOAD_ONCE,
    **{functor(name, arity): EntryKind.LOAD for name in ("autoload", "reexport") for arity in (1, 2)},
}
_INITIALIZATION_AT = functor("initialization", 2)
_INITIALIZATION = frozenset((functor("initialization", 1), _INITIALIZATION_AT))
_NOW, _AFTER_LOAD, _MAIN = atom("now"), atom("after_load"), atom("main")
_AFTER_LOAD_TIMES = (_AFTER_LOAD, atom("restore"), atom("restore_state"), atom("program"))
_REV = functor("rev", 1)
_INSERT = functor("ins_event_rule", 2)
_SUBTRACTION = functor("-", 2)
TOO_DEEP = "the pattern is nested too deeply"


class FileEntry(NamedTuple):
    """An entry that takes effect when the file is accepted.

    Attributes:
        term: the clause, goal, `Property` or name of a file.
        place: place in the source.
        goals: goals of a directive with their places.
    """

    kind: EntryKind
    term: Term
    place: Optional[Place]
    goals: Goals = []


class EventFileParser:
    """Classifies the terms of a file and collects errors and warnings.

    Args:
        show: converts a term to text, for errors in terms without a place.
        declarations: declared events; the declarations of the file are added.
    """

    def __init__(
        self, show: Optional[Callable[[Term], str]] = None, declarations: Optional[Declarations] = None
    ) -> None:
        self._show = show
        self.errors = Errors()
        self._file_declarations = FileDeclarations(declarations, self.errors)
        self.warnings = Errors()
        self.entries: List[FileEntry] = []
        self.rules: List[RuleDefinition] = []
        self.nested_rules: List[RuleDefinition] = []
        self.calls: List[PredicateCall] = []
        self.interval_calls: List[PredicateCall] = []
        self._names: Dict[Var, str] = {}

    def parse_read_term(self, read_term: ReadTerm, place: Optional[Place] = None) -> None:
        """Classify and check a term that was read from a text; ``place`` is its position if known."""
        self._names = {var: name for name, var in read_term.names.items()}
        self.parse_term(read_term.term, read_term.place_of, place or read_term.place)
        self._names = {}

    def parse_term(self, term: Term, place_of: PlaceLookup, place: Optional[Place]) -> None:
        """Classify and check a term; ``place_of`` returns the place of a part, ``place`` is that of the term."""
        term = deref(term)
        # Problems beyond these counts are those of this term.
        previous_counts = [(problems, len(problems)) for problems in (self.errors, self.warnings)]
        try:
            self._classify(term, place_of, place)
        except RetalisError as error:
            self.errors.append(error if error.place else RuleError(error.message, place))
        # A term of 1,000 nested operators exceeds the recursion limit of the checks; this is an error of the file.
        except RecursionError:
            self.errors.append(RuleError(TOO_DEEP, place))
        # Without a position, only the text of the term identifies it.
        if place is None and self._show is not None:
            for problems, previous_count in previous_counts:
                for position in range(previous_count, len(problems)):
                    problems[position] = RuleError(f"{self._show(term)}: {problems[position].message}")

    def _classify(self, term: Any, place_of: PlaceLookup, place: Optional[Place]) -> None:
        head = term[0] if term.__class__ is tuple else None
        if is_rule(term):
            self._add_rule(term, place_of, place)
        elif head in DIRECTIVES:
            self._add_directive(term, place_of, place)
        elif head in _LOAD_KINDS:
            self._add_load_entries(term, place)
        elif head is PROPERTY_FACT:
            self._add_property(
                Property(deref(term[1]), _atom_name(term[2]), deref(term[3])), term, place_of, place
            )
            self.entries.append(FileEntry(EntryKind.CLAUSE, term, place))
        else:
            # Goals may call either name, so the clause is added under both.
            if head in _ETALIS_NAMES:
                self.entries.append(FileEntry(EntryKind.CLAUSE, (_ETALIS_NAMES[head], *term[1:]), place))
            elif head in _CLAUSE_WRAPPERS:
                self.entries.append(FileEntry(EntryKind.CLAUSE, deref(term[1]), place))
            self._warn_of_likely_rule(term, place_of, place)
            if head is _CLAUSE:
                self._file_declarations.check_events(
                    events_raised_by_goals(calls(term, 2)), term, self._names, place_of, place
                )
            self.entries.append(FileEntry(EntryKind.CLAUSE, term, place))

    def _add_directive(self, term: CompoundTerm, place_of: PlaceLookup, place: Optional[Place]) -> None:
        # A rule after ``:-`` would be a goal that is called once, which is never intended.
        goal, goal_place = deref(term[1]), place_of(term, 1) or place
        if is_rule(goal):
            raise RuleError("an event rule is written without :- before it", goal_place)
        if goal.__class__ is tuple and goal[0] in _INITIALIZATION:
            self._add_initialization(goal, place_of, goal_place)
            return
        if goal.__class__ is tuple and goal[0] in _LOAD_KINDS:
            self._add_load_entries(goal, goal_place)
            return
        goals = directive_goals(term, place_of)
        self._file_declarations.check_events(
            events_raised_by_goals(calls(term, 1)), term, self._names, place_of, place
        )
        self.entries.append(FileEntry(EntryKind.DIRECTIVE, goal, goal_place, goals))
        self._file_declarations.apply(goals, place_of)

    def _add_load_entries(self, goal: CompoundTerm, place: Optional[Place]) -> None:
        """Process a directive that loads a file, with clauses for predicates that it renames."""
        self.entries.append(FileEntry(_LOAD_KINDS[goal[0]], deref(goal[1]), place))
        self.entries += [FileEntry(EntryKind.CLAUSE, clause, place) for clause in renaming_clauses(*goal[1:])]

    def _add_initialization(self, term: CompoundTerm, place_of: PlaceLookup, place: Optional[Place]) -> None:
        """Process ``initialization/1,2``: the goal is called after loading or at the time that the term states."""
        call_time = deref(term[2]) if term[0] is _INITIALIZATION_AT else _AFTER_LOAD
        goals = directive_goals(term, place_of)
        if call_time is _MAIN:
            self._warn(
                "initialization(Goal, main) is not called: nothing here is started as a program of its own",
                place,
            )
        elif call_time is _NOW:
            self.entries.append(FileEntry(EntryKind.DIRECTIVE, deref(term[1]), place, goals))
        elif call_time in _AFTER_LOAD_TIMES:
            self.entries.append(FileEntry(EntryKind.AT_END, deref(term[1]), place, goals))
        else:
            raise RuleError(
                "initialization/2 takes now, after_load, restore, restore_state, program or main", place
            )

    def _warn_of_likely_rule(self, term: Term, place_of: PlaceLookup, place: Optional[Place]) -> None:
        """Warn about a clause that was probably meant as an event rule."""
        if term.__class__ is not tuple:
            return
        head = term[0]
        if head is RULE or head is COLON:
            error = label_error(term, lambda part, position=0: place_of(part, position) or place)
            if error is not None:
                raise error
            if head is RULE or _is_labelled(deref(term[2])):
                self._warn(
                    "this is not a labelled rule (a rule has one label), so it is kept as a fact", place
                )
        elif head in RESERVED_FACT_FUNCTORS:
            self._warn(
                "this is a fact; an event rule has <- between head and pattern", place_of(term) or place
            )
        elif head is _SUBTRACTION and all(deref(side).__class__ in (Atom, tuple) for side in term[1:]):
            self._warn(
                "this is a fact of -/2; an event rule has <- between head and pattern, a clause :- before its body",
                place_of(term) or place,
            )
        elif head is _CLAUSE:
            body = deref(term[2])
            if (
                body.__class__ is tuple
                and OPERATOR_NAMES.get(body[0]) is not None
                and body[0].name.isidentifier()
            ):
                advice = "the arrow of an event rule is <-"
                self.calls.append(PredicateCall(body[0], place_of(body) or place, "", advice))

    def _warn(self, message: str, place: Optional[Place]) -> None:
        self.warnings.append(RuleError(message, place))

    def _add_property(
        self, prop: Property, term: CompoundTerm, place_of: PlaceLookup, place: Optional[Place]
    ) -> None:
        """Process a property from a term whose last arguments are its name and value."""
        problem, value_position = prop.error_text, len(term) - 1
        if problem is None:
            self.entries.append(FileEntry(EntryKind.PROPERTY, prop, place))
        elif prop.is_known:
            raise RuleError(problem, place_of(term, value_position) or place)
        else:
            self._warn(problem, place_of(term, value_position - 1) or place)

    def _add_rule(self, term: CompoundTerm, place_of: PlaceLookup, place: Optional[Place]) -> None:
        label, rule = split_label(term)
        if label is not None and label.__class__ is tuple:
            name = label[0].name
            for item in list_items(label[1]) or ():
                property_term: Any = deref(item)  # `split_label` has checked the label
                self._add_property(
                    Property(atom(name), _atom_name(property_term[1]), deref(property_term[2])),
                    property_term,
                    place_of,
                    place,
                )
            label = atom(name)
        self.rules.append(self.parse_rule(rule, label, place_of, place))

    def parse_rule(
        self,
        rule: Any,
        label: Optional[Term],
        place_of: PlaceLookup,
        place: Optional[Place],
        names: Optional[Dict[Var, str]] = None,
    ) -> RuleDefinition:
        """Return the definition of a rule, and add its nested rules to `nested_rules`.

        Raises:
            RuleError: if the rule cannot fire.
        """
        if names is not None:
            self._names = names
        # A variable that occurs once and has no name is anonymous: no value has to be stored for it.
        single_variables = (var for var, number in occurrences([rule], None).items() if number == 1)
        anonymous = frozenset(var for var in single_variables if var not in self._names)
        reader = PatternReader(
            lambda part, position=0: place_of(part, position) or place, self.warnings.append, anonymous
        )
        # A rule P do G has no head.
        if rule[0] not in ARROWS:
            pattern = reader.read((RULE, rule), 1)
            definition = RuleDefinition(rule, None, pattern, label, place, self._names)
        else:
            head, goal = deref(rule[1]), None
            if head.__class__ is tuple and OPERATOR_NAMES.get(head[0]) == "do":
                goal = reader.read_goal(head, 2, "do")
                head = deref(head[1])
            head_place = place_of(head) if head.__class__ is tuple else place_of(rule, 1)
            check_head(
                head,
                lambda part, position=0: place_of(part, position) or place,
                head_place or place,
                self.warnings.append,
            )
            for call in calls_in_query(head):
                self._record_call(call, place_of, place)
            self._warn_of_pattern(rule, place_of)
            pattern = reader.read(rule, 2)
            if goal is not None:
                pattern = ActionPattern(pattern, goal, False)
            definition = RuleDefinition(rule, head, pattern, label, place, self._names)
            self._check_head_variables(head, pattern, head_place or place)
        self._check_goals(reader.goals, pattern, place_of, place)
        # ``t1/1`` and ``t2/1`` are defined in ``check`` only, so their use elsewhere is an error unless the program
        # defines them itself.
        for call in reader.interval_calls:
            assert call.term.__class__ is tuple
            self.interval_calls.append(PredicateCall(call.term[0], place_of(call.term) or place))
        self._warn_of_parts(reader, pattern, place_of, place)
        heads = [] if definition.head is None else [head_event(rule)]
        raised_events = events_raised_by_goals((*reader.goals, *calls_in_query(definition.head or TRUE)))
        self._file_declarations.check_events(
            chain(heads, reader.events, raised_events), rule, self._names, place_of, place
        )
        for window, part in reader.windows:
            check_window(window, part, rule, self._names, reader.place, self.warnings.append)
        for nested in reader.nested_rules:
            self.nested_rules.append(self.parse_rule(nested, None, place_of, place_of(nested) or place))
        return definition

    def _warn_of_parts(
        self, reader: PatternReader, pattern: Pattern, place_of: PlaceLookup, place: Optional[Place]
    ) -> None:
        """Warn about likely mistakes in aggregates and absences."""
        for aggregate, aggregate_term in reader.aggregates:
            check_aggregate(
                aggregate, aggregate_term, pattern, self._names, reader.place, self.warnings.append
            )
        for absence in reader.absences:
            warning = uncovered_gap_warning(absence, place_of, self._names)
            if warning is not None:
                self._warn(warning, place_of(absence) or place)

    def _warn_of_pattern(self, rule: CompoundTerm, place_of: PlaceLookup) -> None:
        """Warn about an unbracketed rule inside a pattern (two arrows in a row), and about a variable as pattern."""
        body, body_place = deref(rule[2]), place_of(rule, 2)
        if body.__class__ is Var:
            name = self._names.get(body, "_")
            # The variable matches the rule's own events, so the rule triggers itself without end.
            self._warn(f"{name} is any event, those of this rule included: it fires for itself", body_place)
        is_rule_inside = body.__class__ is tuple and body[0] in ARROWS
        if is_rule_inside and body_place is not None and body_place.character != "(":
            self._warn("this rule is inside the pattern of another; put it in brackets", place_of(body))

    def _check_goals(
        self, goals: List[Subgoal], pattern: Pattern, place_of: PlaceLookup, place: Optional[Place]
    ) -> None:
        """Check and record the goals of a rule; unknown predicates may be defined later in the file."""
        counts = occurrences([], pattern)
        for call in goals:
            term = call.term
            # All occurrences of the variable are calls, so nothing can bind it to a goal.
            if term.__class__ is Var and counts[term] == sum(subgoal.term is term for subgoal in goals):
                name = self._names.get(term, "this variable")
                constant = _FOREIGN_TRUTH_VALUES.get(name.lower())
                hint = f": a name with a capital is a variable; write {constant}" if constant else ""
                raise RuleError(
                    f"{name} never gets a goal to call{hint}", place_of(call.parent, call.position) or place
                )
            self._record_call(call, place_of, place)

    def _record_call(self, call: Subgoal, place_of: PlaceLookup, place: Optional[Place]) -> None:
        """Record the predicate that a goal of a rule calls."""
        term = call.term
        module = call.parent[1] if call.parent[0] is COLON else None
        if term.__class__ is tuple:
            self.calls.append(PredicateCall(term[0], place_of(term) or place, "", _advice_for(term), module))
        elif term.__class__ is Atom:
            goal_place = place_of(call.parent, call.position) or place
            self.calls.append(PredicateCall(term.functor, goal_place, module=module))

    def _check_head_variables(self, head: Term, pattern: Pattern, place: Optional[Place]) -> None:
        bound_variables = {*bound_by(pattern), *_variables_bound_by_query(head)}
        unbound_variables = [var for var in variables(head) if var not in bound_variables]
        event = deref(head[1]) if head.__class__ is tuple and head[0] in ALARMS else head
        if event.__class__ is Var and event in unbound_variables:
            subject = "the head" if event is head else "the event of this alarm"
            raise RuleError(f"nothing in the pattern gives {subject} a value", place)
        if unbound_variables:
            names = [self._names[var] for var in unbound_variables if var in self._names]
            subject = (
                f"{' and '.join(names)} in the head"
                if names
                else f"{len(unbound_variables)} variable(s) in the head"
            )
            note = (
                " (rev retracts exactly the event that it names)"
                if head.__class__ is tuple and head[0] is _REV
                else ""
            )
            advice = ": use it in the pattern, outside of cnot, fnot and absent, or remove it from the head"
            self._warn(f"nothing in the pattern can bind {subject}{note or advice}", place)


def _variables_bound_by_query(head: Term) -> List[Var]:
    """Return the variables of a synchronized event that its query binds."""
    if head.__class__ is tuple and head[0] in SYNCHRONIZED:
        return variables(head[2])
    return []


def reread_rule(
    term: Term, label: Optional[Term], place: Optional[Place], names: Dict[Var, str]
) -> RuleDefinition:
    """Return the definition of a rule from its term, for a program that was accepted before.

    Raises:
        RuleError: if the term is not a rule, or the rule cannot fire.
    """
    if not is_unlabelled_rule(term):
        raise RuleError("expected an event rule", place)
    return EventFileParser().parse_rule(term, label, no_place, place, names)


def _is_labelled(term: Term) -> bool:
    """Return whether a term has the form of a label followed by something."""
    return term.__class__ is tuple and (term[0] is RULE or term[0] is COLON)


_FOREIGN_TRUTH_VALUES = {"true": "true", "yes": "true", "false": "false", "no": "false"}
_GOAL_NOTATIONS = {
    "and": "goals are joined with a comma, as in A > 1, A < 2",
    "or": "alternatives of a goal are joined with a semicolon, as in (A > 2 ; A < 1)",
}
_COMPARISONS = frozenset(
    functor(name, 2) for name in ("<", ">", "=<", ">=", "=:=", "=\\=", "==", "\\==", "=", "\\=", "is")
)


def _functors_of_operands(term: CompoundTerm) -> List[Optional[Functor]]:
    operands: List[Any] = [deref(operand) for operand in term[1:]]
    return [operand[0] if operand.__class__ is tuple else None for operand in operands]


def _advice_for(goal: CompoundTerm) -> str:
    """Return advice for a goal whose predicate does not exist, or ""."""
    name = OPERATOR_NAMES.get(goal[0])
    if name in _GOAL_NOTATIONS and all(key in _COMPARISONS for key in _functors_of_operands(goal)):
        return _GOAL_NOTATIONS[name]
    if name is not None:
        return f"{name} is part of the goal here; to apply it to the pattern, write (Pattern where Goal) {name} ..."
    return "a rule that contains a comma needs brackets of its own" if goal[0] is _INSERT else ""


def _atom_name(term: Term) -> str:
    term = deref(term)
    return term.name if term.__class__ is Atom else "(not an atom)"


def _is_negative(term: Term) -> bool:
    return term.__class__ is tuple and term[0] is _MINUS


_SIMILAR_ARROWS = frozenset((functor("->", 2), functor("=", 2)))


def clause_error(logic: PrologSystem, term: Term) -> Optional[str]:
    """Return the reason why a term cannot be added as a clause, or None."""
    try:
        if term.__class__ is tuple and term[0] is _GRAMMAR:
            return None
        if term.__class__ is tuple and term[0] is SINGLE_SIDED:
            term, _ = translate_single_sided(term)
        head, _ = split_clause(copy(term))
        # `a < -b` reads as a comparison with a negative term; the user meant `a <- b`.
        if head.__class__ is tuple and head[0] is _LESS_THAN and _is_negative(deref(head[2])):
            return "this compares two terms; the arrow of an event rule is <-, without a space"
        key = head[0] if head.__class__ is tuple else head.functor if head.__class__ is Atom else None
        assert key is not None  # or `split_clause` has raised an error
        logic.database.require_writable(key)
    except PrologError as error:
        is_near = term.__class__ is tuple and term[0] in _SIMILAR_ARROWS
        return error.message + (
            "; the arrow of an event rule is <-, that of a clause is :-" if is_near else ""
        )
    return None


_INCLUDE = functor("include", 1)


def included_file_name(term: Term) -> Optional[Term]:
    """Return the name of the file in ``:- include(File)``, or None for another term."""
    term = deref(term)
    if term.__class__ is not tuple or term[0] not in DIRECTIVES:
        return None
    goal = deref(term[1])
    return deref(goal[1]) if goal.__class__ is tuple and goal[0] is _INCLUDE else None


_REPLACEABLE_PREDICATES: Dict[Functor, Callable[[Term], bool]] = {
    TIMER: sets_timer,
    functor("timers", 1): lambda term: False,
    functor("module", 2): lambda term: False,
    **dict.fromkeys(STATE, declares_state),
    **dict.fromkeys(HOLDS, lambda term: False),
}
"""Predicates whose names programs use for their own facts, with a test whether a fact was intended as a goal."""

_DECLARING_PREDICATES = frozenset(
    (
        *[functor(name, 1) for name in ("dynamic", "discontiguous", "multifile", "table")],
        functor("dynamic", 2),
    )
)
_AS = functor("as", 2)


def predicates_defined_in(entries: Sequence[FileEntry]) -> Set[Functor]:
    """Return the predicates that a file clearly defines: by clauses with a body, several facts, or a declaration.

    Several facts count only for predicates that a program may replace: not for ISO predicates and event goals.
    """
    defined: Set[Functor] = set()
    facts: Set[Optional[Functor]] = set()
    for entry in entries:
        if entry.kind is EntryKind.CLAUSE and entry.term.__class__ is tuple and _has_body(entry.term):
            key = _predicate_of(entry.term[1])
            if key is not None:
                defined.add(key)
        elif entry.kind is EntryKind.CLAUSE:
            key = _predicate_of(entry.term)
            if key is not None and key in facts and is_replaceable(key):
                defined.add(key)
            facts.add(key)
        elif entry.kind is EntryKind.DIRECTIVE:
            defined |= _predicates_declared_by(entry.term)
    return defined


def fact_error(
    logic: PrologSystem,
    term: Term,
    defined: Set[Functor],
    is_guarded: Optional[Callable[[Functor], bool]] = None,
) -> Optional[str]:
    """Return the reason why a fact is rejected, or None.

    Args:
        logic: provides the system's predicates.
        term: the fact.
        defined: predicates that the file clearly defines.
        is_guarded: returns whether facts must not replace a predicate of the system; by default all are guarded.
    """
    key = None if _has_body(term) else _predicate_of(term)
    if key is None or key in defined or not (is_guarded or logic.is_system_predicate)(key):
        return None
    if key in _REPLACEABLE_PREDICATES and not _REPLACEABLE_PREDICATES[key](term):
        return None
    return (
        f"a fact of {key} would replace the built-in predicate: write :- before a goal; "
        f"to define a predicate of that name, declare it (:- dynamic {key}.)"
    )


def _has_body(term: Term) -> bool:
    return term.__class__ is tuple and term[0] in (_CLAUSE, _GRAMMAR, SINGLE_SIDED)


def _predicate_of(term: Term) -> Optional[Functor]:
    term = deref(term)
    if isinstance(term, Atom):
        return term.functor
    return term[0] if term.__class__ is tuple else None


def _predicates_declared_by(goal: Term) -> Set[Functor]:
    goal = deref(goal)
    if goal.__class__ is not tuple or goal[0] not in _DECLARING_PREDICATES:
        return set()
    declared: Set[Functor] = set()
    stack = [deref(goal[1])]
    while stack:
        term = stack.pop()
        if term.__class__ is not tuple:
            continue
        if term[0] is COMMA or term[0] is CONS:
            stack += [deref(term[2]), deref(term[1])]
        # Tabling options follow: `p/1 as subsumptive`.
        elif term[0] is _AS:
            stack.append(deref(term[1]))
        elif term[0] is SLASH:
            name, arity = deref(term[1]), deref(term[2])
            if isinstance(name, Atom) and isinstance(arity, int):
                declared.add(functor(name.name, arity))
    return declared
