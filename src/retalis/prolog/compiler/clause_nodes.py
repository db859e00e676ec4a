"""Clause bodies as trees of goal nodes, the intermediate representation of the compiler.

`BodyParser` turns the body of a clause into a list of nodes. A node records the variables that it needs, whether it
can be written inline (as Python statements that leave no choice point), and whether it contains a cut of the clause.
The generators (`body_code`, `inline_goals`, `semidet_functions`) walk the nodes and write code for them.

A cut names a `Height`: the height of the choice point stack at entry of the clause, or of the condition or ``once/1``
around it. Control constructs nested deeper than `_MAX_CONTROL_DEPTH` and conjunctions that a module call expands to
become `Interpret` nodes, which run from their term.

`FunctionalModes` describes built-ins that are functions of some of their arguments, which compiled clauses call
without unifying the outputs.
"""

from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Dict,
    FrozenSet,
    Iterable,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Protocol,
    Sequence,
    Tuple,
    Union,
)

from ...foundation.source_places import Place
from ..machine.errors import type_error
from ..machine.machine import Machine
from ..terms.list_terms import conjuncts
from ..terms.term_traversal import variables
from ..terms.types import (
    COLON,
    COMMA,
    FALSE,
    TRUE,
    Atom,
    CompoundTerm,
    Functor,
    Lazy,
    Step,
    Term,
    Var,
    deref,
    functor,
)
from ..terms.unification import unify

if TYPE_CHECKING:
    from .semidet_functions import FunctionCode

PredicateFunction = Callable[..., Optional[bool]]
"""A predicate as a function of its arguments: whether there is a solution; None if the function cannot decide."""


class JoinedGoals(NamedTuple):
    """Consecutive goals that one function evaluates; see `inline_goals`.

    Attributes:
        length: number of goals.
        function: takes the inputs; returns the output, or None if a goal fails.
        inputs: arguments of the goals.
        output: the argument that the last goal computes.
    """

    length: int
    function: Callable[..., Optional[Term]]
    inputs: Tuple[Term, ...]
    output: Term


GoalJoiner = Callable[[Sequence[CompoundTerm], Mapping[Any, int]], Optional[JoinedGoals]]
"""Function that joins consecutive goals; takes the goals and how often each variable occurs in the clause."""


class FunctionalModes(NamedTuple):
    """Modes of a deterministic predicate that is implemented by a function from input to output arguments.

    Compiled clauses unify the outputs inline: an output that no goal uses is never converted, and the first
    occurrence of a variable becomes a local name for the value, without a binding.

    Attributes:
        function: takes the inputs; returns the output, or a tuple of several, or None if the predicate fails.
        inputs: positions of the inputs among the arguments.
        outputs: positions of the outputs.
        to_term_functions: for each output, the function that converts the returned value to a term; None if the value
            is a term.
        has_single_output: whether there is one output, which is returned without a tuple.
        joins: function that joins consecutive goals that begin with this predicate, or None; see `inline_goals`.
    """

    function: Callable[..., Any]
    inputs: Tuple[int, ...]
    outputs: Tuple[int, ...]
    to_term_functions: Tuple[Optional[Callable[..., Term]], ...]
    has_single_output: bool
    joins: Optional[GoalJoiner] = None

    def predicate(self) -> Callable[..., bool]:
        """Return the predicate as a function for `PredicateTable.define`."""
        function, inputs, has_single_output = self.function, self.inputs, self.has_single_output
        outputs = tuple(zip(self.outputs, self.to_term_functions))

        def call(machine: Machine, *args: Term) -> bool:
            result = function(*[args[position] for position in inputs])
            if result is None:
                return False
            for value, (position, to_term) in zip((result,) if has_single_output else result, outputs):
                if not unify(args[position], value if to_term is None else to_term(value), machine.trail):
                    return False
            return True

        return call


def functional(
    function: Callable[..., Any],
    arity: int,
    outputs: Tuple[int, ...] = (),
    to_term_functions: Tuple[Optional[Callable[..., Term]], ...] = (),
) -> FunctionalModes:
    """Return the modes of a function; without ``outputs`` the last argument is the only output."""
    has_single_output = not outputs
    outputs = outputs or (arity - 1,)
    inputs = tuple(position for position in range(arity) if position not in outputs)
    return FunctionalModes(
        function, inputs, outputs, to_term_functions or (None,) * len(outputs), has_single_output
    )


class SourceClause(Protocol):
    """Clause as the compiler reads it; see `Clause`."""

    head: Term
    body: Term
    place: Optional[Place]

    @property
    def is_large(self) -> bool:
        """True if the clause is too large to be compiled."""


class SourcePredicate(Protocol):
    """Predicate as the compiler reads it; see the attributes of `Predicate`."""

    @property
    def run(self) -> Step:
        """The function that executes a frame of a call."""

    kind: str
    function: Optional[Callable[..., Any]]
    make_pushdown_filter: Optional[Callable[[Functor, Tuple[int, ...]], object]]
    functional_modes: Optional[FunctionalModes]
    bound_argument_builtin: Optional[Functor]
    dynamic: bool
    is_library_predicate: bool
    has_only_ground_facts: bool

    @property
    def hidden_predicate(self) -> Optional[object]:
        """The predicate that owns the clauses, if calls are answered by tables."""

    def active_clauses(self) -> Iterable[SourceClause]:
        """Return the clauses that have not been retracted, in order."""

    def __len__(self) -> int:
        """Return the number of these clauses."""

    def fact_finder(self, first_is_enough: bool, /) -> PredicateFunction:
        """Return a function of the arguments that looks up a ground fact."""


class PredicateResolver(Protocol):
    """Predicates as the compiler reads them: those of the program (`Database`) or of the library (`LibraryView`)."""

    machine: Machine

    @property
    def is_library(self) -> bool:
        """True if names are resolved as the library's clauses do."""

    @property
    def is_interpreter_only(self) -> bool:
        """True if nothing of the program is compiled."""

    @property
    def interpret(self) -> object:
        """Code of frames that run a goal from its term."""

    def predicate(self, key: Functor, /) -> SourcePredicate:
        """Return the predicate of a functor."""

    def resolve_qualified_goal(self, goal: CompoundTerm, /) -> Term:
        """Return the goal that ``Module:Goal`` calls."""

    def is_inline(self, key: Functor, /) -> bool:
        """Return whether a predicate is a deterministic built-in."""

    def function_code(self, key: Functor, /) -> "FunctionCode":
        """Return the functions of a predicate."""


ARROW = functor("->", 2)
SOFT_ARROW = functor("*->", 2)
SEMICOLON = functor(";", 2)
BAR = functor("|", 2)
NOT = functor("\\+", 1)
CALL = functor("call", 1)
ONCE = functor("once", 1)
IGNORE = functor("ignore", 1)
EQUAL = functor("=", 2)
DIFFERENT = functor("\\=", 2)
IS = functor("is", 2)

COMPARISONS = {
    functor("=:=", 2): "==",
    functor("=\\=", 2): "!=",
    functor("<", 2): "<",
    functor(">", 2): ">",
    functor("=<", 2): "<=",
    functor(">=", 2): ">=",
}
ORDERS = {
    functor("==", 2): "== 0",
    functor("\\==", 2): "!= 0",
    functor("@<", 2): "< 0",
    functor("@>", 2): "> 0",
    functor("@=<", 2): "<= 0",
    functor("@>=", 2): ">= 0",
}
TYPE_TESTS = {
    functor("var", 1): "{0}.__class__ is Var",
    functor("nonvar", 1): "{0}.__class__ is not Var",
    functor("atom", 1): "{0}.__class__ is Atom",
    functor("integer", 1): "{0}.__class__ is int",
    functor("float", 1): "{0}.__class__ is float",
    functor("number", 1): "({0}.__class__ is int or {0}.__class__ is float)",
    functor("string", 1): "{0}.__class__ is String",
    functor("compound", 1): "{0}.__class__ is tuple",
    functor("atomic", 1): "({0}.__class__ is not tuple and {0}.__class__ is not Var)",
    functor("callable", 1): "({0}.__class__ is tuple or {0}.__class__ is Atom)",
}

CONTROL = {COMMA, SEMICOLON, BAR, ARROW, SOFT_ARROW, NOT, TRUE.functor, functor("!", 0)}
"""Control constructs, which a program may not define."""

# ``$arg/3`` is ``arg/3`` with an argument number that is known to be bound, and so is deterministic.
ARG, KNOWN_ARG = functor("arg", 3), functor("$arg", 3)
FUNCTOR = functor("functor", 3)
_CUT = functor("!", 0)
_MAX_CONTROL_DEPTH = 40
"""Nesting of control constructs that is compiled; deeper ones are interpreted."""


class Height:
    """Height of the choice point stack that a cut restores."""

    __slots__ = ("name",)

    def __init__(self, name: str):
        self.name = name


Needed = Union[Var, Height]
"""Variable or height that a goal needs."""


class GoalNode:
    """Goal of a body.

    Attributes:
        needed: variables and heights that it needs.
        is_inline: whether it is compiled to statements that leave no choice point and run no frame of the program.
        has_cut: whether it contains a cut of the clause.
        source: the goal as a term; None for nodes that the compiler adds.
    """

    __slots__ = ("needed", "is_inline", "has_cut", "source")

    def __init__(self, needed: FrozenSet[Needed], is_inline: bool, has_cut: bool = False):
        self.needed = needed
        self.is_inline = is_inline
        self.has_cut = has_cut
        self.source: Optional[Term] = None


class CallNode(GoalNode):
    """Call of a predicate.

    Attributes:
        form: name of the code that is written for it, a key of ``inline_goals._WRITERS``; "call" for a frame.
        args: arguments of the call.
        first_is_enough: for a call of a function (form "function"), whether the first solution is enough.
    """

    __slots__ = ("form", "key", "args", "first_is_enough")

    def __init__(self, form: str, key: Functor, args: Tuple[Term, ...], is_inline: bool):
        super().__init__(frozenset(variables((key, *args))), is_inline)
        self.form = form
        self.key = key
        self.args = args
        self.first_is_enough = False


class Succeed(GoalNode):
    """Goal ``true``, which is dropped."""

    __slots__ = ()


class Fail(GoalNode):
    """Goal ``fail``."""

    __slots__ = ()


class Cut(GoalNode):
    """Cut to a height; if ``is_soft``, it disables only the choice point at that height, as ``*->`` requires."""

    __slots__ = ("height", "is_soft")

    def __init__(self, height: Height, is_soft: bool = False):
        super().__init__(frozenset([height]), True)
        self.height = height
        self.is_soft = is_soft


class IfThenElse(GoalNode):
    """If-then-else (``is_soft`` for ``*->``).

    Negation is the case whose ``then`` fails and whose ``otherwise`` is empty.

    Attributes:
        test_height: height that cuts in the test cut to; None if there are none.
    """

    __slots__ = ("test", "then", "otherwise", "is_soft", "test_height")

    def __init__(
        self,
        test: List[GoalNode],
        then: List[GoalNode],
        otherwise: List[GoalNode],
        test_height: Optional[Height],
        is_soft: bool = False,
    ):
        everything = (*test, *then, *otherwise)
        cuts = any(node.has_cut for node in (*then, *otherwise))
        inline = (
            not is_soft and not cuts and test_height is None and all(node.is_inline for node in everything)
        )
        super().__init__(needed_by(everything).difference([test_height]), inline, cuts)
        self.test = test
        self.then = then
        self.otherwise = otherwise
        self.is_soft = is_soft
        self.test_height = test_height


class Disjunction(GoalNode):
    """Disjunction."""

    __slots__ = ("branches",)

    def __init__(self, branches: List[List[GoalNode]]):
        everything = [node for branch in branches for node in branch]
        super().__init__(needed_by(everything), False, any(node.has_cut for node in everything))
        self.branches = branches


class Interpret(GoalNode):
    """Goal that is interpreted from its term; its cuts cut to a height."""

    __slots__ = ("term", "height")

    def __init__(self, term: Term, height: Height):
        super().__init__(frozenset(variables((COMMA, term))) | {height}, False, True)
        self.term = term
        self.height = height


def needed_by(nodes: Iterable[GoalNode]) -> FrozenSet[Needed]:
    """Return the variables and heights that nodes need."""
    return frozenset().union(*[node.needed for node in nodes])


class BodyParser:
    """Parser that turns a clause body into nodes.

    Args:
        database: the predicates; deterministic built-ins among them are called inline.
        entry: the height at entry of the clause, the target of its cuts.
        can_be_function: returns whether a predicate of the program can be called as a function; by default none is.
    """

    def __init__(
        self,
        database: PredicateResolver,
        entry: Height,
        can_be_function: Optional[Callable[[Functor], bool]] = None,
    ):
        self._database = database
        self._can_be_function = can_be_function
        self._height_count = 0
        self._entry = entry

    def _new_height(self) -> Height:
        self._height_count += 1
        return Height(f"h{self._height_count}")

    def parse(self, body: Term, cut: Optional[Height] = None, depth: int = 0) -> List[GoalNode]:
        """Return the nodes of a body.

        Raises:
            PrologError: a type error if part of the body is not a goal.
        """
        cut = self._entry if cut is None else cut
        nodes: List[GoalNode] = []
        for goal in conjuncts(body):
            node = self._goal_node(goal, cut, depth)
            if not isinstance(node, Succeed):
                node.source = goal
                nodes.append(node)
        return nodes

    def _goal_node(self, goal: Term, cut: Height, depth: int) -> GoalNode:
        if goal.__class__ is Var:
            return CallNode("call", CALL, (goal,), False)
        if goal.__class__ is Atom:
            return self._atom_node(goal, cut)
        if goal.__class__ is Lazy:
            goal = goal.term()
        if goal.__class__ is not tuple:
            raise type_error("callable", goal)
        key = goal[0]
        if key is COLON:
            if deref(goal[1]).__class__ is Var or deref(goal[2]).__class__ is Var:
                return CallNode("call", CALL, (goal,), False)
            module_goal = self._database.resolve_qualified_goal(goal)
            # A node stands for one goal, so a module call that expands to a conjunction is interpreted.
            is_conjunction = module_goal.__class__ is tuple and module_goal[0] is COMMA
            return Interpret(module_goal, cut) if is_conjunction else self._goal_node(module_goal, cut, depth)
        # ignore/1 is the only one of these that a program may redefine.
        if key in _COMPILED_CONSTRUCTS and (
            key is not IGNORE or self._database.predicate(IGNORE).is_library_predicate
        ):
            # The compiler is recursive and Python limits the nesting of blocks.
            if depth > _MAX_CONTROL_DEPTH:
                return Interpret(goal, cut)
            return self._control_node(key, goal, cut, depth + 1)
        return self._call_node(key, goal[1:])

    def _atom_node(self, goal: Atom, cut: Height) -> GoalNode:
        if goal is TRUE:
            return Succeed(frozenset(), True)
        if goal is FALSE or goal.name == "fail":
            return Fail(frozenset(), True)
        if goal.functor is _CUT:
            node = Cut(cut)
            node.has_cut = cut is self._entry
            return node
        return self._call_node(goal.functor, ())

    def _call_node(self, key: Functor, args: Tuple[Term, ...]) -> GoalNode:
        form = _FORMS.get(key)
        if form is not None:
            return CallNode(form, key, args, True)
        if (
            key is ARG
            and deref(args[0]).__class__ is int
            and self._database.predicate(ARG).is_library_predicate
        ):
            key = KNOWN_ARG
        inline = self._database.is_inline(key)
        # A nondeterministic built-in may be a function if its first argument is bound at compile time.
        if not inline and args and deref(args[0]).__class__ is not Var:
            bound_form = self._database.predicate(key).bound_argument_builtin
            if bound_form is not None:
                key, inline = bound_form, True
        if not inline and self._can_be_function is not None and self._can_be_function(key):
            return CallNode("function", key, args, True)
        form = ("functor" if key is FUNCTOR else "builtin") if inline else "call"
        return CallNode(form, key, args, inline)

    def _control_node(self, key: Functor, goal: CompoundTerm, cut: Height, depth: int) -> GoalNode:
        if key is SEMICOLON or key is BAR:
            return self._disjunction_node(goal, cut, depth)
        if key is ARROW or key is SOFT_ARROW:
            return self._condition_node(goal, None, cut, depth)
        argument = deref(goal[1])
        # A variable as a goal is opaque to cuts, which call/1 provides.
        if argument.__class__ is Var:
            argument = (CALL, argument)
        inner_height = self._new_height()
        test = self.parse(argument, inner_height, depth)
        barrier = _if_needed(inner_height, test)
        if key is NOT:
            return IfThenElse(test, [Fail(frozenset(), True)], [], barrier)
        return IfThenElse(test, [], [] if key is IGNORE else [Fail(frozenset(), True)], barrier)

    def _disjunction_node(self, goal: CompoundTerm, cut: Height, depth: int) -> GoalNode:
        branch = deref(goal[1])
        if branch.__class__ is tuple and (branch[0] is ARROW or branch[0] is SOFT_ARROW):
            return self._condition_node(branch, goal[2], cut, depth)
        # Right-nested disjunctions become one node with many branches, which keeps long ones from being nested too
        # deep.
        branches = [self.parse(branch, cut, depth)]
        alternatives = deref(goal[2])
        while alternatives.__class__ is tuple and alternatives[0] is SEMICOLON:
            branch = deref(alternatives[1])
            if branch.__class__ is tuple and (branch[0] is ARROW or branch[0] is SOFT_ARROW):
                break
            branches.append(self.parse(branch, cut, depth))
            alternatives = deref(alternatives[2])
        branches.append(self.parse(alternatives, cut, depth))
        return Disjunction(branches)

    def _condition_node(
        self, arrow: CompoundTerm, otherwise: Optional[Term], cut: Height, depth: int
    ) -> GoalNode:
        inner_height = self._new_height()
        test = self.parse(arrow[1], inner_height, depth)
        then = self.parse(arrow[2], cut, depth)
        else_nodes: List[GoalNode] = (
            [Fail(frozenset(), True)] if otherwise is None else self.parse(otherwise, cut, depth)
        )
        return IfThenElse(test, then, else_nodes, _if_needed(inner_height, test), arrow[0] is SOFT_ARROW)


def _if_needed(height: Height, nodes: List[GoalNode]) -> Optional[Height]:
    return height if height in needed_by(nodes) else None


_COMPILED_CONSTRUCTS = {SEMICOLON, BAR, ARROW, SOFT_ARROW, NOT, ONCE, IGNORE}
_FORMS: Dict[Functor, str] = {
    EQUAL: "unify",
    DIFFERENT: "differ",
    IS: "is",
    **dict.fromkeys(COMPARISONS, "arithmetic"),
    **dict.fromkeys(ORDERS, "order"),
    **dict.fromkeys(TYPE_TESTS, "type"),
}

PROTECTED_PREDICATES = frozenset(
    (
        *CONTROL,
        *_FORMS,
        *(functor("call", arity) for arity in range(1, 9)),
        functor("catch", 3),
        functor("throw", 1),
        functor("fail", 0),
        FALSE.functor,
        ONCE,
        functor("unify_with_occurs_check", 2),
        functor("subsumes_term", 2),
        functor("ground", 1),
        functor("$arg", 3),
        functor("$no_rule", 2),
        functor("$within", 3),
    )
)
"""Predicates that no program may define: control constructs, unification, comparison and type tests."""
