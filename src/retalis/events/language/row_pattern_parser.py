"""Parser of row patterns ``steps(Steps, Options)``.

A row pattern ``steps([low, high(2, 5) where T > prev(T)])`` corresponds to MATCH_RECOGNIZE of SQL. A step is a
pattern variable with a quantifier: ``high(2, 5)`` is ``HIGH{2,5}``, ``reluctant`` makes it reluctant, and its
``where`` goal is the DEFINE condition. ``prev(X, N)``, ``first(Step, X)`` and ``last(Step, X)`` are the navigation
functions, ``avg(Step, X * 2)`` and others the aggregates of `STEP_AGGREGATES`; the parser replaces each of them by
a fresh variable and records in a `RowNavigation` the value to bind it to. `split_condition` splits a condition at its
commas into parts, so that each part can be evaluated as soon as the rows that it refers to exist. The option
``after_match`` is AFTER MATCH SKIP.
"""

from typing import (
    TYPE_CHECKING,
    Any,
    Container,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
)

from ...foundation.errors import RuleError
from ...foundation.similar_names import did_you_mean
from ...prolog.terms.list_terms import list_items, make_list
from ...prolog.terms.term_traversal import variables
from ...prolog.terms.types import (
    COMMA,
    NIL,
    Atom,
    CompoundTerm,
    Term,
    Var,
    atom,
    deref,
    functor,
    functor_name,
)
from ..streams.aggregates import AGGREGATES
from ..streams.row_pattern_automaton import (
    ALTERNATIVES,
    MAX_POSITIONS,
    PERMUTATION,
    SEQUENCE,
    WHOLE_MATCH,
    PatternPart,
    RowPatternNFA,
    RowPatternSkip,
    RowPatternVariable,
    StepGroup,
    StepTest,
    count_positions,
    may_be_empty,
)
from .event_operators import OPERATOR_NAMES
from .pattern_tree import (
    RowPatternStep,
    WindowPattern,
    WindowSpec,
)

if TYPE_CHECKING:
    from .pattern_parser import PatternReader

MAX_STEPS = 100
"""Maximum number of steps of a row pattern."""
_UNIFY = functor("=", 2)
_LATER, _UNTIL, _WHERE = functor("later", 1), functor("until", 1), functor("where", 2)
_STEPS, _STEPS_WITH_OPTIONS = functor("steps", 1), functor("steps", 2)
_AFTER_MATCH = functor("after_match", 1)
_STEP_OPTION_NOTATION = "the option of steps is after_match(Strategy)"
_OR, _PERMUTE = functor("or", 2), functor("permute", 1)
_GROUP = "group"
_MAX_GROUP_DEPTH = 20
_GREEDY = "many"
_RELUCTANT = "reluctant"
_NAVIGATIONS = {functor("prev", 1): "prev", functor("first", 1): "first", functor("last", 1): "last"}
_STEP_NAVIGATIONS = {functor("first", 2): "first", functor("last", 2): "last"}
_PREV_WITH_DISTANCE = functor("prev", 2)
_MAX_DISTANCE = 100
"""Maximum number of events between that of ``prev(X, N)`` and the current one."""
STEP_AGGREGATES = ("count", "sum", "avg", "min", "max", "stddev")
"""Aggregates of conditions; their states are small and immutable, because the states of a match share them."""
_EVALUABLE_WITH_TWO_ARGUMENTS = ("min", "max")
_MATCH_NAME = "match"
ROW_START, ROW_END = Var(), Var()
"""Variables of the start and of the end of a row, in conditions of steps and in the measures of row patterns."""
_ROW_STAMPS = {"t1": ROW_START, "t2": ROW_END}
_STAMP_GOALS = {functor(name, 1): var for name, var in _ROW_STAMPS.items()}
_UNKNOWN_STEP = -2
_STEP_NOTATION = "Name, Name(N), Name(N, M), Name(N, many), with reluctant or until(Goal) behind the numbers"


class SkipStrategy(NamedTuple):
    """Strategy of ``after_match`` of a row pattern.

    Attributes:
        words: where the next match begins, in words; S is the step.
    """

    notation: str
    words: str


SKIP_STRATEGIES = {
    "skip_past_last": SkipStrategy("skip_past_last", "after the last event of a match"),
    "skip_to_next": SkipStrategy("skip_to_next", "at the event after the first one of a match"),
    "skip_to_first": SkipStrategy("skip_to_first(Step)", "at the first event of step S in a match"),
    "skip_to_last": SkipStrategy("skip_to_last(Step)", "at the last event of step S in a match"),
}
"""The strategies of ``after_match`` of row patterns (AFTER MATCH SKIP)."""
_GROUP_NOTATION = (
    "group(Steps), group(Steps, N), group(Steps, N, M), group(Steps, N, many), "
    "with reluctant behind the numbers"
)
_COMPARISONS = tuple(functor(name, 2) for name in ("<", ">", "=<", ">=", "=:=", "=\\=", "is"))


class RowNavigation(NamedTuple):
    """Navigation of a condition to a value in an earlier row, or aggregate of values in the rows so far.

    Attributes:
        kind: ``prev`` for an earlier row, ``first`` or ``last`` for a row of a step, or the name of an aggregate.
        step: number of the step, or `WHOLE_MATCH` for all rows; for ``prev`` the distance of the row. Another number
            if there is no such step or distance.
        value: variable of the pattern, for an aggregate also an expression; None for ``count``.
        placeholder: variable that replaces the navigation in the condition.
    """

    kind: str
    step: int
    value: Optional[Term]
    placeholder: Var
    term: CompoundTerm

    @property
    def is_aggregate(self) -> bool:
        """True if it is an aggregate."""
        return self.kind in STEP_AGGREGATES

    @property
    def vars(self) -> List[Var]:
        """The variables of its value."""
        return [] if self.value is None else variables(self.value)

    @property
    def is_valid(self) -> bool:
        """True if its step or distance exists."""
        if self.kind == "prev":
            return 1 <= self.step <= _MAX_DISTANCE
        return self.step >= 0 or self.step == WHOLE_MATCH


class StepCondition(NamedTuple):
    """Part of a condition; it is evaluated when all rows that it refers to exist.

    Attributes:
        goal: the goal, with a variable in place of each navigation.
    """

    goal: Term
    navigations: Tuple[RowNavigation, ...]


def parse_row_pattern(
    reader: "PatternReader", row_pattern_term: CompoundTerm, pattern_variables: Set[Var]
) -> WindowSpec:
    """Return the window of a row pattern.

    Args:
        reader: reads goals, and creates errors with places.
        row_pattern_term: the term of the row pattern.
        pattern_variables: the variables that the event pattern binds.

    Raises:
        RuleError: if a step or option is malformed, or a step can never end.
    """
    items = list_items(row_pattern_term[1])
    if not items or len(items) > MAX_STEPS:
        raise reader.create_error(f"steps needs a list of 1 to {MAX_STEPS} steps", row_pattern_term, 1)
    steps: List[RowPatternStep] = []
    structure = _parse_parts(reader, items, row_pattern_term, steps)
    if len(steps) > MAX_STEPS or count_positions(structure) > MAX_POSITIONS:
        message = f"steps needs at most {MAX_STEPS} steps, which have at most {MAX_POSITIONS} places in their groups"
        raise reader.create_error(message, row_pattern_term, 1)
    names = [step.name for step in steps]
    for name in names:
        # Navigations refer to steps by name.
        if names.count(name) > 1:
            raise reader.create_error(f"two steps are called {name}", row_pattern_term, 1)
    # A match without any row would hold at every instant.
    if may_be_empty(structure, steps):
        raise reader.create_error("at least one step must have a minimum above 0", row_pattern_term, 1)
    is_plain = structure.parts == tuple(range(len(steps)))
    nfa = RowPatternNFA([_variable_without_tests(step) for step in steps], (), (), structure)
    _require_step_ends(reader, steps, nfa, row_pattern_term)
    navigated_vars: List[Var] = []
    for number, step in enumerate(steps):
        for goal in step.goals:
            parts = split_condition(goal, names, number, pattern_variables)
            for navigation in (navigation for part in parts for navigation in part.navigations):
                unknown_vars = {*navigation.vars}.difference(pattern_variables, (ROW_START, ROW_END))
                if unknown_vars or not navigation.is_valid:
                    raise _navigation_error(reader, navigation, names)
                _require_plain_expression(reader, navigation, names)
            navigated_vars += [var for var in variables(goal) if var in pattern_variables]
    options = deref(row_pattern_term[2]) if len(row_pattern_term) == 3 else NIL
    return _parse_step_options(reader, options, row_pattern_term, steps, nfa)._replace(
        steps=tuple(steps),
        navigated_vars=tuple(dict.fromkeys(navigated_vars)),
        structure=None if is_plain else structure,
    )


def _parse_parts(
    reader: "PatternReader",
    items: Sequence[Term],
    row_pattern_term: CompoundTerm,
    steps: List[RowPatternStep],
    depth: int = 0,
) -> StepGroup:
    """Return the sequence of parts that terms denote; their steps are added to ``steps``."""
    if depth > _MAX_GROUP_DEPTH:
        raise reader.create_error("groups of steps are nested too deeply", row_pattern_term, 1)

    def parse_list(term: Term) -> StepGroup:
        listed = list_items(term)
        if not listed:
            raise reader.create_error("a group of steps needs a list of steps", row_pattern_term, 1)
        return _parse_parts(reader, listed, row_pattern_term, steps, depth + 1)

    parts: List[PatternPart] = []
    for item in items:
        term: Any = deref(item)
        is_compound = term.__class__ is tuple
        if list_items(term) is not None:
            parts.append(parse_list(term))
        elif is_compound and OPERATOR_NAMES.get(term[0]) == "or":
            alternatives = _parse_parts(reader, _list_alternatives(term), row_pattern_term, steps, depth + 1)
            parts.append(alternatives._replace(kind=ALTERNATIVES))
        elif is_compound and term[0] is _PERMUTE:
            permutation = parse_list(term[1])._replace(kind=PERMUTATION)
            if any(may_be_empty(part, steps) for part in permutation.parts):
                raise reader.create_error("each step of permute needs a minimum above 0", term)
            parts.append(permutation)
        elif is_compound and term[0].name == _GROUP and list_items(term[1]) is not None:
            parts.append(_parse_quantified_group(reader, term, parse_list(term[1]), steps))
        else:
            steps.append(_parse_step(reader, term, row_pattern_term))
            parts.append(len(steps) - 1)
    return StepGroup(SEQUENCE, tuple(parts))


def _list_alternatives(term: Any) -> List[Term]:
    """Return the operands of ``or`` from left to right."""
    alternatives: List[Term] = []
    stack = [term]
    while stack:
        operand: Any = deref(stack.pop())
        if operand.__class__ is tuple and OPERATOR_NAMES.get(operand[0]) == "or":
            stack += [operand[2], operand[1]]
        else:
            alternatives.append(operand)
    return alternatives


def _parse_quantified_group(
    reader: "PatternReader", term: CompoundTerm, group: StepGroup, steps: Sequence[RowPatternStep]
) -> StepGroup:
    """Return the group that ``group(Steps, N, M)`` denotes."""
    if len(term) == 2:
        return group
    # The counts are those of a step.
    counted = _parse_quantified_step(reader, term, False, None, first_count=2)
    if counted.until is not None:
        raise reader.create_error("until belongs to a step, not to a group", term)
    if counted.max_count is None and may_be_empty(group, steps):
        raise reader.create_error(
            "a group without a largest number needs a step with a minimum above 0", term
        )
    has_conditions = any(steps[number].goals for number in _steps_of(group))
    if counted.max_count is None and not counted.reluctant and not has_conditions:
        raise reader.create_error(
            "nothing ends the group: give it a largest number or reluctant, or one of its steps a condition",
            term,
        )
    return group._replace(
        min_count=counted.min_count, max_count=counted.max_count, reluctant=counted.reluctant
    )


def _steps_of(part: PatternPart) -> List[int]:
    """Return the numbers of the steps in a part of a row pattern."""
    return (
        [part] if isinstance(part, int) else [number for inner in part.parts for number in _steps_of(inner)]
    )


def _variable_without_tests(step: RowPatternStep) -> RowPatternVariable:
    """Return a step without its conditions, for questions about the order of steps."""
    until = () if step.until is None else (StepTest((), (), lambda *_: True),)
    return RowPatternVariable(step.min_count, step.max_count, step.reluctant, step.skips_rows, (), until)


def _parse_step_options(
    reader: "PatternReader",
    options: Any,
    row_pattern_term: CompoundTerm,
    steps: Sequence[RowPatternStep],
    nfa: RowPatternNFA,
) -> WindowSpec:
    """Return the window of a row pattern with its options only."""
    items = list_items(options)
    if items is None:
        raise reader.create_error(
            f"steps needs a list of options; {_STEP_OPTION_NOTATION}", row_pattern_term, 2
        )
    window = WindowSpec("steps")
    for item in items:
        option: Any = deref(item)
        if option.__class__ is not tuple or option[0] is not _AFTER_MATCH:
            raise reader.create_error(_STEP_OPTION_NOTATION, row_pattern_term, 2)
        if window.skip is not None:
            raise reader.create_error("two options are after_match", row_pattern_term, 2)
        window = window._replace(skip=_parse_skip(reader, deref(option[1]), option, steps, nfa))
    return window


def _parse_skip(
    reader: "PatternReader",
    strategy: Any,
    option: CompoundTerm,
    steps: Sequence[RowPatternStep],
    nfa: RowPatternNFA,
) -> RowPatternSkip:
    """Return where the next match begins."""
    takes_step = strategy.__class__ is tuple
    known_strategy = SKIP_STRATEGIES.get(functor_name(strategy))
    if known_strategy is None or takes_step != known_strategy.notation.endswith("(Step)"):
        notations = ", ".join(known.notation for known in SKIP_STRATEGIES.values())
        near_name = did_you_mean(functor_name(strategy), SKIP_STRATEGIES)
        raise reader.create_error(f"after_match of steps needs one of {notations}{near_name}", option, 1)
    if not takes_step:
        return RowPatternSkip(strategy.name)
    names = [step.name for step in steps]
    name = functor_name(deref(strategy[1]))
    if name not in names:
        raise reader.create_error(
            f"unknown step; the steps are {', '.join(names)}{did_you_mean(name, names)}", strategy, 1
        )
    number = names.index(name)
    is_first = nfa.first_steps == {number}
    is_single = steps[number].max_count == 1 and nfa.step_numbers.count(number) == 1
    if is_first and (strategy[0].name == "skip_to_first" or is_single):
        raise reader.create_error(
            f"the next match would begin at the first event of the match, without end: {strategy[0].name} needs "
            "an event after the first one, such as that of a later step; or use skip_to_next",
            strategy,
            1,
        )
    return RowPatternSkip(strategy[0].name, number)


def _is_group(term: Any) -> bool:
    """Return whether a term denotes a group of steps."""
    if list_items(term) is not None:
        return True
    if term.__class__ is not tuple:
        return False
    is_group = term[0].name == _GROUP and list_items(term[1]) is not None
    return is_group or term[0] is _PERMUTE or OPERATOR_NAMES.get(term[0]) == "or"


def _parse_step(reader: "PatternReader", term: Any, row_pattern_term: CompoundTerm) -> RowPatternStep:
    unwrapped, skips_rows = term, False
    goal: Optional[Term] = None
    while unwrapped.__class__ is tuple and unwrapped[0] in (_LATER, _WHERE):
        if unwrapped[0] is _WHERE and goal is None:
            goal = reader.read_goal(unwrapped, 2, "where", has_interval=True)
        elif unwrapped[0] is _LATER and not skips_rows and deref(unwrapped[1]).__class__ in (Atom, tuple):
            skips_rows = True
        else:
            break
        unwrapped = deref(unwrapped[1])
    if unwrapped is not term and _is_group(unwrapped):
        raise reader.create_error("where and later belong to a step, not to a group", term)
    if unwrapped.__class__ is Atom:
        return RowPatternStep(unwrapped.name, 1, 1, False, skips_rows, goal, None)
    if unwrapped.__class__ is not tuple or unwrapped[0] in (_WHERE, _UNTIL):
        raise reader.create_error(
            f"a step is {_STEP_NOTATION}; and Step where Goal, later(Step)", row_pattern_term, 1
        )
    return _parse_quantified_step(reader, unwrapped, skips_rows, goal)


def _parse_quantified_step(
    reader: "PatternReader",
    term: CompoundTerm,
    skips_rows: bool,
    goal: Optional[Term],
    first_count: int = 1,
) -> RowPatternStep:
    """Return the step that a term with a quantifier denotes; its quantifier begins at argument ``first_count``."""
    arguments: List[Any] = [deref(argument) for argument in term[first_count:]]
    reluctant, until = False, None
    option = arguments[-1]
    if option.__class__ is Atom and option.name == _RELUCTANT:
        reluctant = True
    elif option.__class__ is tuple and option[0] is _UNTIL:
        until = reader.read_goal(option, 1, "until", has_interval=True)
    if reluctant or until is not None:
        arguments.pop()
    minimum: Any = arguments[0] if arguments else None
    maximum: Any = arguments[-1] if arguments else None
    if len(arguments) == 2 and maximum.__class__ is Atom and maximum.name == _GREEDY:
        maximum = None
    if not 1 <= len(arguments) <= 2 or not _are_counts(minimum, maximum):
        if term[0] is _AFTER_MATCH:
            raise reader.create_error(
                "options follow the list of steps: steps([Step, ...], [after_match(Strategy)])", term
            )
        is_group = term[0].name == _GROUP
        notation = f"a group is {_GROUP_NOTATION}" if is_group else f"a step is {_STEP_NOTATION}"
        raise reader.create_error(f"{notation}, where N is not larger than M, and M at least 1", term)
    return RowPatternStep(term[0].name, minimum, maximum, reluctant, skips_rows, goal, until)


def _are_counts(minimum: Any, maximum: Any) -> bool:
    if minimum.__class__ is not int or minimum < 0:
        return False
    return maximum is None or (maximum.__class__ is int and 1 <= maximum >= minimum)


def _require_step_ends(
    reader: "PatternReader",
    steps: Sequence[RowPatternStep],
    nfa: RowPatternNFA,
    row_pattern_term: CompoundTerm,
) -> None:
    """Raise an error for a step without an end, because a match with it would never be complete."""
    # With ``skips_rows``, an optional further row can arrive at any time, so the match is never final.
    endless_step = nfa.find_endless_step()
    for number, step in enumerate(steps):
        missing = ""
        if step.reluctant or step.until is not None:
            continue
        if step.max_count is None and step.goal is None:
            missing = "a condition, a largest number" if not step.skips_rows else "a largest number"
        elif number == endless_step:
            missing = "a single number"
        if missing:
            message = f"nothing ends the step {step.name}: give it {missing}, reluctant, or until(Goal)"
            raise reader.create_error(message, row_pattern_term, 1)


def _navigation_error(reader: "PatternReader", navigation: RowNavigation, names: Sequence[str]) -> RuleError:
    term = navigation.term
    if not navigation.is_valid and navigation.kind == "prev":
        message = f"prev(X, N) needs a number of events from 1 to {_MAX_DISTANCE}"
        return reader.create_error(message, term, len(term) - 1)
    if not navigation.is_valid:
        near_name = did_you_mean(functor_name(deref(term[1])), names)
        return reader.create_error(f"unknown step; the steps are {', '.join(names)}{near_name}", term, 1)
    if navigation.kind in AGGREGATES and navigation.kind not in (*STEP_AGGREGATES, "first", "last"):
        known = ", ".join(STEP_AGGREGATES)
        return reader.create_error(
            f"{navigation.kind} is no aggregate of conditions of steps: expected {known}", term
        )
    needed = "an expression of variables" if navigation.is_aggregate else "a variable"
    return reader.create_error(f"{navigation.kind} needs {needed} that the pattern binds", term)


def _require_plain_expression(
    reader: "PatternReader", navigation: RowNavigation, names: Sequence[str]
) -> None:
    """Raise an error for an aggregate whose expression has values of other rows."""
    stack: List[Any] = [navigation.value]
    while stack:
        term = stack.pop()
        if term.__class__ is not tuple:
            continue
        if _parse_navigation(term, names, 0, True) is not None or _is_malformed_navigation(term, True):
            message = f"{term[0].name} cannot be in the expression of {navigation.kind}"
            raise reader.create_error(message, navigation.term)
        stack += map(deref, term[1:])


def split_condition(
    goal: Term, names: Sequence[str], step: int, pattern_variables: Container[Var]
) -> List[StepCondition]:
    """Return the parts of a condition, each with its navigations.

    Conjuncts that share a variable local to the condition form one part, together with the conjuncts between them.

    Args:
        goal: the condition.
        names: names of the steps.
        step: number of the step that has the condition.
        pattern_variables: variables that the event pattern binds; all others are local to the condition.
    """
    conjuncts = list(_split_conjunction(goal))
    free_variables = [
        [var for var in variables(conjunct) if var not in pattern_variables] for conjunct in conjuncts
    ]
    last_use = {var: position for position, used in enumerate(free_variables) for var in used}
    parts: List[Term] = []
    end = -1
    for position, conjunct in enumerate(conjuncts):
        # A local variable is bound in one conjunct and used in another one, so both must be solved as one goal.
        if position > end:
            parts.append(conjunct)
        else:
            parts[-1] = (COMMA, parts[-1], conjunct)
        end = max([end, *(last_use[var] for var in free_variables[position])])
    return [_replace_navigations(conjunct, names, step) for conjunct in parts]


def _split_conjunction(goal: Term) -> Iterator[Term]:
    stack = [deref(goal)]
    while stack:
        goal_part: Any = stack.pop()
        if goal_part.__class__ is tuple and goal_part[0] is COMMA:
            # Left conjunct last, so that it is popped first.
            stack += [deref(goal_part[2]), deref(goal_part[1])]
        else:
            yield goal_part


def _replace_navigations(goal: Term, names: Sequence[str], step: int) -> StepCondition:
    navigations: List[RowNavigation] = []

    def replace(term: Term, is_number: bool) -> Term:
        term = deref(term)
        if term.__class__ is not tuple:
            return term
        if term[0] in _STAMP_GOALS:
            return (_UNIFY, term[1], _STAMP_GOALS[term[0]])
        navigation = _parse_navigation(term, names, step, is_number)
        if navigation is None and _is_malformed_navigation(term, is_number):
            # The parser reports it, because its variable is not one of the pattern.
            navigation = RowNavigation(term[0].name, 1, Var(), Var(), term)
        if navigation is None:
            is_number = is_number or term[0] in _COMPARISONS
            return (term[0], *[replace(arg, is_number) for arg in term[1:]])
        navigations.append(navigation)
        return navigation.placeholder

    return StepCondition(replace(goal, False), tuple(navigations))


def _is_malformed_navigation(term: CompoundTerm, is_number: bool) -> bool:
    """Return whether a term that is no navigation has the name of one, and no other meaning.

    Args:
        term: the term.
        is_number: whether it is a part of an arithmetic expression; a predicate may have the name.
    """
    name, arity = term[0].name, len(term) - 1
    if name == "prev" and arity <= 2:
        return True
    is_evaluable = name in _EVALUABLE_WITH_TWO_ARGUMENTS and arity == 2
    return is_number and arity <= 2 and name in AGGREGATES and not is_evaluable


def _parse_navigation(
    term: CompoundTerm, names: Sequence[str], step: int, is_number: bool
) -> Optional[RowNavigation]:
    """Return the navigation that a term denotes, or None.

    Args:
        term: the term.
        names: names of the steps.
        step: number of the step that has the condition.
        is_number: whether it is a part of an arithmetic expression, where aggregates may have expressions.
    """
    name = term[0].name
    first: Any = deref(term[1])
    last: Any = deref(term[-1])
    first_var, last_var = insert_stamps(first), insert_stamps(last)
    if term[0] is _PREV_WITH_DISTANCE and first_var.__class__ is Var:
        return RowNavigation("prev", last if last.__class__ is int else 0, first_var, Var(), term)
    if term[0] in _NAVIGATIONS and last_var.__class__ is Var:
        kind = _NAVIGATIONS[term[0]]
        return RowNavigation(kind, 1 if kind == "prev" else step, last_var, Var(), term)
    if term[0] in _STEP_NAVIGATIONS and first.__class__ is Atom and last_var.__class__ is Var:
        return RowNavigation(name, _find_step(first.name, names), last_var, Var(), term)
    if name not in STEP_AGGREGATES or len(term) > 3:
        return None
    has_value = AGGREGATES[name].has_value
    is_value = last_var.__class__ is Var or (is_number and last.__class__ in (tuple, int, float))
    if len(term) - 1 == has_value and is_value:
        return RowNavigation(name, step, last_var, Var(), term)
    if len(term) - 2 != has_value or first.__class__ is not Atom or (has_value and not is_value):
        return None
    number = _find_step(first.name, names)
    # `max(e, X)` is the larger one of two numbers.
    if number == _UNKNOWN_STEP and name in _EVALUABLE_WITH_TWO_ARGUMENTS:
        return None
    return RowNavigation(name, number, last_var if has_value else None, Var(), term)


def _find_step(name: str, names: Sequence[str]) -> int:
    """Return the number of a step; `WHOLE_MATCH` for ``match``, unless it is the name of a step."""
    if name in names:
        return names.index(name)
    return WHOLE_MATCH if name == _MATCH_NAME else _UNKNOWN_STEP


def insert_stamps(term: Term) -> Any:
    """Return a term with `ROW_START` and `ROW_END` in place of the atoms ``t1`` and ``t2``."""
    term = deref(term)
    if term.__class__ is Atom:
        return _ROW_STAMPS.get(term.name, term)
    return (term[0], *map(insert_stamps, term[1:])) if term.__class__ is tuple else term


def is_step_name(term: Term) -> bool:
    """Return whether a measured term is the name of the step of a row (CLASSIFIER)."""
    return term.__class__ is Atom and functor_name(term) == "step"


def uses_stamps(pattern: WindowPattern) -> bool:
    """Return whether the measures or conditions of a row pattern use the stamps of its rows."""
    names = [step.name for step in pattern.window.steps]
    terms = [insert_stamps(value) for value in pattern.values if value is not None]
    for number, step in enumerate(pattern.window.steps):
        for part in (part for goal in step.goals for part in split_condition(goal, names, number, ())):
            terms += [part.goal, *(var for navigation in part.navigations for var in navigation.vars)]
    return any(var in (ROW_START, ROW_END) for term in terms for var in variables(term))


def row_pattern_term(window: WindowSpec) -> Term:
    """Return the term of a row pattern."""
    structure = window.structure or StepGroup(SEQUENCE, tuple(range(len(window.steps))))
    steps = _parts_term(structure, window.steps)
    if window.skip is None:
        return _STEPS(steps)
    name, step = window.skip
    strategy: Term = atom(name)
    if SKIP_STRATEGIES[name].notation != name:
        strategy = functor(name, 1)(atom(window.steps[step].name))
    return _STEPS_WITH_OPTIONS(steps, make_list([_AFTER_MATCH(strategy)]))


def _parts_term(group: StepGroup, steps: Sequence[RowPatternStep]) -> Term:
    return make_list([_part_term(part, steps) for part in group.parts])


def _part_term(part: PatternPart, steps: Sequence[RowPatternStep]) -> Term:
    if isinstance(part, int):
        return step_term(steps[part])
    if part.kind == PERMUTATION:
        return _PERMUTE(_parts_term(part, steps))
    if part.kind == ALTERNATIVES:
        *others, last = [_part_term(inner_part, steps) for inner_part in part.parts]
        for other in reversed(others):
            last = _OR(other, last)
        return last
    counts = _count_arguments(part.min_count, part.max_count, part.reluctant, None)
    return (
        functor(_GROUP, len(counts) + 1)(_parts_term(part, steps), *counts)
        if counts
        else _parts_term(part, steps)
    )


def _count_arguments(
    min_count: int, max_count: Optional[int], reluctant: bool, until: Optional[Term]
) -> List[Term]:
    """Return the arguments of a step or group; none for exactly one."""
    arguments: List[Term] = [] if min_count == max_count == 1 else [min_count]
    if max_count != min_count:
        arguments.append(atom(_GREEDY) if max_count is None else max_count)
    ending: Optional[Term] = atom(_RELUCTANT) if reluctant else None
    if until is not None:
        ending = _UNTIL(until)
    return arguments if ending is None else [*(arguments or [1]), ending]


def step_term(step: RowPatternStep) -> Term:
    """Return the term of a step."""
    arguments = _count_arguments(step.min_count, step.max_count, step.reluctant, step.until)
    term: Term = functor(step.name, len(arguments))(*arguments) if arguments else atom(step.name)
    if step.goal is not None:
        term = _WHERE(term, step.goal)
    return _LATER(term) if step.skips_rows else term
