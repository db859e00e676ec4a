"""Compilation of predicates to Python functions, with clause indexing as in the WAM.

The function of a predicate switches on the first-level key of one argument (constant or functor, as
``switch_on_term``, ``switch_on_constant`` and ``switch_on_structure`` do). Unlike the WAM it may choose an argument
other than the first: the one whose keys distinguish the clauses best. Each case runs its chain of clauses in order. A
clause with others after it pushes a choice point for them unless the keys of other arguments exclude them; the code
for retrying is generated when backtracking first needs it. If the switched argument is unbound, a second switch on
another argument may be used.

A recursive last call is an iteration of a loop. A clause that builds a list while it recurses gets a loop of its own:
``app([H|T], L, [H|R]) :- app(T, L, R)`` with an unbound third argument would create and bind a variable for each
cell. The loop collects the items and builds the cells from the last to the first, without variables in between (the
effect of last call modulo cons).

Predicates with many facts are not compiled but searched: `fact_search` generates one search function for each arity
and indexed argument.
"""

from typing import Any, Callable, Dict, FrozenSet, List, NamedTuple, Optional, Sequence, Tuple

from ...foundation import codegen
from ...foundation.source_places import Place
from ..machine.machine import Code
from ..terms.types import TRUE, Atom, CompoundTerm, Frame, Functor, Lazy, Step, Term, Var, deref
from .body_code import BodyGenerator
from .clause_nodes import BodyParser, CallNode, GoalNode, Height, PredicateResolver, needed_by
from .code_scope import ClauseVariables, CompilationUnit, Loop, Scope
from .inline_goals import write_inline
from .unification_code import match, write_read_mode


def key_of(term: Any) -> object:
    """Return the first-level key of a term for indexes: its constant or functor; None for a variable."""
    term_class = term.__class__
    if term_class is tuple:
        return term[0]
    if term_class is Atom or term_class is int:
        return term
    if term_class is Var:
        term = deref(term)
        return None if term.__class__ is Var else key_of(term)
    if term_class is Lazy:
        lazy_functor = term.functor
        return lazy_functor if lazy_functor.arity else key_of(term.term())
    # As keys of a dictionary, 1.0 would equal 1, and 0.0 would equal -0.0; the text tells them apart.
    if term_class is float:
        return float, term.hex()
    return term


def fact_search(
    arity: int, indexed: Optional[int], namespace: Dict[str, object]
) -> Callable[..., Optional[Frame]]:
    """Return ``search(frame, clauses, position, end, generation, keys)``, which tries ground facts in order.

    The search returns the next frame, after pushing a choice point if another fact may match; None if none matches.

    Args:
        arity: arity of the predicate.
        indexed: position (from 0) of the argument that an index has compared: its first level agrees in all facts.
        namespace: global names of the search: ``Var``, ``Code``, ``unify``, ``undo``, ``trail``, ``push``,
            ``choose``, ``may_match``.
    """
    source = "\n".join(_search_lines(arity, indexed)) + "\n"
    search: Callable[..., Optional[Frame]] = codegen.shared_function(
        source, namespace, f"facts of {arity} arguments"
    )
    return search


def _search_lines(arity: int, indexed: Optional[int]) -> List[str]:
    retry_lines = [
        "def retry_facts(entry):",
        "    _, frame, clauses, position, end, generation, keys, mark = entry",
    ]
    search_lines = [
        "def generated(frame, clauses, position, end, generation, keys):",
        "    mark = len(trail)",
    ]
    try_lines = _try_lines(arity, indexed)
    return [
        *retry_lines,
        *try_lines,
        'retry = Code("facts", retry_facts)',
        *search_lines,
        *_skip_lines("    "),
        *try_lines,
    ]


def _skip_lines(indent: str) -> List[str]:
    """Return the lines that advance to the next fact that is not retracted and may match."""
    lines = [
        "while position < end:",
        "    other = clauses[position]",
        "    if other.retracted_at > generation and (keys is None or may_match(keys, other.keys)):",
        "        break",
        "    position += 1",
    ]
    return [indent + line for line in lines]


def _try_lines(arity: int, indexed: Optional[int]) -> List[str]:
    """Return the lines that try facts, beginning with one that may match."""
    lines = [
        f"    _, {''.join(f'a{position}, ' for position in range(arity))}after = frame",
        "    while position < end:",
        f"        _, {''.join(f'c{position}, ' for position in range(arity))[:-2]} = clauses[position].head",
        "        position += 1",
        # The next candidate is found before the current fact is unified: if there is none, no choice point is left
        # behind, and the caller stays deterministic.
        *_skip_lines("        "),
    ]
    for position in range(arity):
        lines += _unify_lines(position, position == indexed)
    return [
        *lines,
        "        if position < end:",
        "            choose((retry, frame, clauses, position, end, generation, keys, mark))",
        "        return after",
        "    return None",
    ]


def _unify_lines(position: int, indexed: bool) -> List[str]:
    """Return the lines that unify the argument at a position with that of the fact."""
    lines = [
        f"        b = a{position}",
        f"        if b is not c{position}:",
        "            k = b.__class__",
        "            while k is Var:",
        "                r = b.ref",
        "                if r is None:",
        "                    break",
        "                b = r",
        "                k = r.__class__",
        "            if k is Var:",
        f"                b.ref = c{position}",
        "                push(b)",
        f"            elif b is not c{position} and not unify(b, c{position}, trail):",
        "                undo(trail, mark)",
        "                continue",
    ]
    # The index has compared constants completely, and of compounds the functor only.
    if indexed:
        return [f"        if c{position}.__class__ is tuple:", *["    " + line for line in lines]]
    return lines


class ConsLoop(NamedTuple):
    """Loop of a clause that builds a chain of cells: last call modulo cons.

    Attributes:
        built_position: position of the argument that is built.
        hole_position: position in its cell of the variable that the recursive call binds.
    """

    built_position: int
    hole_position: int


def find_cons_loop(
    variables: ClauseVariables, args: Sequence[Term], nodes: Sequence[GoalNode], key: Functor, switch: int
) -> Optional[ConsLoop]:
    """Return the loop of a clause that builds cells while it recurses, or None for other clauses.

    Args:
        variables: variables of the clause.
        args: arguments of its head.
        nodes: its body. Inline goals before the recursive call may be arithmetic only, which cannot observe that a
            cell is built later.
        key: functor of the predicate.
        switch: position of the argument that the predicate switches on, a compound term.
    """
    call = nodes[-1] if nodes else None
    if not isinstance(call, CallNode) or call.is_inline or call.key is not key:
        return None
    if any(not isinstance(node, CallNode) or node.form not in ("is", "arithmetic") for node in nodes[:-1]):
        return None
    cons_loop = None
    for position, arg in enumerate(args):
        arg = deref(arg)
        if arg.__class__ is not tuple or position == switch:
            continue
        # The hole must occur once in the cell and once in the call: any other goal could observe it unbound.
        hole = deref(call.args[position])
        holes = [number for number, item in enumerate(arg) if number and deref(item) is hole]
        if (
            cons_loop is not None
            or hole.__class__ is not Var
            or len(holes) != 1
            or variables.counts[hole] != 2
        ):
            return None
        cons_loop = ConsLoop(position, holes[0])
    return cons_loop


def write_cons_loop(
    scope: Scope,
    argument_locals: Sequence[str],
    args: Sequence[Term],
    nodes: Sequence[GoalNode],
    cons_loop: ConsLoop,
    switch: int,
) -> None:
    """Write the loop for calls whose built argument is unbound; the general code of the clause follows it."""
    call = nodes[-1]
    assert isinstance(call, CallNode)
    source_local, built_local = argument_locals[switch], argument_locals[cons_loop.built_position]
    pattern, cell = deref(args[switch]), deref(args[cons_loop.built_position])
    assert pattern.__class__ is tuple
    assert cell.__class__ is tuple
    saved_scope = scope.snapshot()
    scope.dereference(built_local)
    scope.write("if k is Var:")
    scope.depth += 1
    scope.write("items = []")
    scope.write("for _ in LOOP:")
    scope.depth += 1
    # No choice point exists within the loop, so a failure in any iteration fails the whole call, and the items are
    # dropped.
    for position, arg in enumerate(args):
        arg = deref(arg)
        if arg.__class__ is Var and position != cons_loop.built_position:
            scope.names.setdefault(arg, argument_locals[position])
    write_read_mode(scope, source_local, pattern, 0, check=False)
    for position, arg in enumerate(args):
        arg = deref(arg)
        if position not in (switch, cons_loop.built_position) and not (
            arg.__class__ is Var and scope.clause.is_void(arg)
        ):
            match(scope, argument_locals[position], arg)
    for position, node in enumerate(nodes[:-1]):
        scope.needed_later = needed_by(nodes[position + 1 :])
        write_inline(scope, node)
    items = [
        scope.build(item) for number, item in enumerate(cell) if number not in (0, cons_loop.hole_position)
    ]
    scope.write(f"items.append({', '.join(items) if len(items) == 1 else '(' + ', '.join(items) + ')'})")
    _write_next_arguments(scope, argument_locals, call, cons_loop)
    scope.dereference(source_local)
    scope.write(f"if k is not tuple or {source_local}[0] is not {scope.unit.constant(pattern[0])}:")
    scope.write("    break")
    scope.depth -= 1
    scope.write("else:")
    scope.write("    BUDGET.count_loops()")
    scope.write("last = hole = Var()")
    _write_cells(scope, cell, cons_loop)
    scope.write(f"{built_local}.ref = last")
    scope.write(f"push({built_local})")
    # `LOOP` bounds the items that are collected at once. After many of them the machine gets control, so that it can
    # check limits and interrupts; after few the call continues in this function.
    continued = [*argument_locals]
    continued[cons_loop.built_position] = "hole"
    scope.write("if len(items) > 255:")
    scope.write(f"    return ({', '.join([scope.unit.predicate(call.key), *continued, 'after'])})")
    scope.write(f"{built_local} = hole")
    scope.write("continue")
    scope.depth -= 1
    scope.restore(saved_scope)
    scope.has_iteration = True


def _write_next_arguments(
    scope: Scope, argument_locals: Sequence[str], call: CallNode, cons_loop: ConsLoop
) -> None:
    """Write the assignment of the arguments of the next iteration."""
    changed: List[Tuple[str, str]] = []
    for position, arg in enumerate(call.args):
        if position != cons_loop.built_position:
            value = scope.build(arg)
            if value != argument_locals[position]:
                changed.append((argument_locals[position], value))
    if changed:
        targets, sources = zip(*changed)
        scope.write(f"{', '.join(targets)} = {', '.join(sources)}")


def _write_cells(scope: Scope, cell: CompoundTerm, cons_loop: ConsLoop) -> None:
    """Write the construction of the cells, from the last to the first."""
    count = len(cell) - 2
    parts = []
    number = 0
    for position in range(1, len(cell)):
        if position == cons_loop.hole_position:
            parts.append("last")
        else:
            parts.append("item" if count == 1 else f"item[{number}]")
            number += 1
    scope.write("items.reverse()")
    scope.write("for item in items:")
    scope.write(f"    last = ({', '.join([scope.unit.constant(cell[0]), *parts])})")


_MAX_CHAIN_CLAUSES = 4
"""Clauses of a chain in one function; the following ones are in another function, generated on demand."""


class ClauseParts:
    """Clause as the generator reads it: arguments of the head, body, and source position."""

    __slots__ = ("args", "body", "place")

    def __init__(self, args: Sequence[Term], body: Term, place: Optional[Place] = None):
        self.args = tuple(args)
        self.body = body
        self.place = place


class PredicateGenerator:
    """Generator of the functions of one predicate.

    Args:
        database: the predicates, with their machine.
        clauses: its clauses in order.
        code: the code object that runs its calls.
        unbound: positions of arguments that are known to be unbound.
    """

    def __init__(
        self,
        database: PredicateResolver,
        key: Functor,
        clauses: Sequence[ClauseParts],
        code: object,
        unbound: FrozenSet[int] = frozenset(),
    ):
        self.database = database
        self.key = key
        self.clauses = clauses
        self.code = code
        self.locals = [f"a{position}" for position in range(1, key.arity + 1)]
        self._unbound = unbound
        self.position = _selective_position(clauses, key.arity, unbound)
        self._retries: Dict[Tuple[int, ...], Code] = {}
        self.keeps_choice_points = False

    def generate(self) -> Step:
        """Return the function of the predicate, and set `keeps_choice_points` (see `Code.keeps_choice_points`)."""
        unit = CompilationUnit(self.database.machine, self.database)
        body = self._write_switch(unit)
        self.keeps_choice_points = not body.uses_choices
        head = self._unpacking_line("")
        # LOOP bounds the iterations. When it is exhausted the budget is charged, and a new frame continues the call.
        if body.has_iteration:
            loop = ["    for _ in LOOP:", *["    " + line for line in body.lines]]
            arguments = ", ".join([unit.constant(self.code), *self.locals, "after"])
            lines = [head, *loop, "    BUDGET.count_loops()", f"    return ({arguments})"]
        else:
            lines = [head, *body.lines]
        unit.add_function(["def main(frame):", *lines])
        return self._define(unit, "main", "")

    def generate_clause(self) -> Step:
        """Return the function of the first clause; the last item of its frame is the height that its cuts restore."""
        unit = CompilationUnit(self.database.machine, self.database)
        scope = self._write_clause(unit, 0, None, height="height")
        unit.add_function(["def main(frame):", self._unpacking_line(", height"), *scope.lines])
        return self._define(unit, "main", " clause 1")

    def _define(self, unit: CompilationUnit, name: str, part: str) -> Step:
        source = unit.complete_source()
        place = next((clause.place for clause in self.clauses if clause.place is not None), None)
        function: Step = unit.define(source, title_of(place, f"{self.key}{part}"))[name]
        return function

    def _unpacking_line(self, last: str) -> str:
        return f"    {', '.join(['_', *self.locals, 'after'])}{last} = frame"

    # The switch

    def _write_switch(self, unit: CompilationUnit) -> Scope:
        all_clauses = tuple(range(len(self.clauses)))
        scope = Scope(unit, ClauseVariables(()))
        if self.position is None:
            self._write_chain(scope, all_clauses, None)
            return scope
        groups = self._group_by_key(self.position)
        local = self.locals[self.position]
        scope.dereference(local)
        self._write_tuple_case(scope, groups, local)
        # An unbound argument distinguishes nothing: switch on another one, or try all clauses.
        scope.write("elif k is Var:")
        unbound_code = self._unbound_code(self.position)
        if unbound_code is not None:
            frame = ", ".join(["None", *self.locals, "after"])
            scope.write_choice(f"    return {unit.constant(unbound_code)}.run(({frame}))")
        else:
            retry = ", ".join(
                [unit.constant(self._retry_code(all_clauses)), *self.locals, "after", "len(trail)"]
            )
            scope.write(f"    return ({retry})")
        self._write_atomic_case(scope, groups, local, Atom, "is")
        self._write_atomic_case(scope, groups, local, int, "==")
        # A lazy term is decoded and dispatched again; it is neither an atom nor an integer before.
        scope.write("elif k is Lazy:")
        arguments = ["None", *self.locals, "after"]
        arguments[self.position + 1] = f"{local}.term()"
        scope.write(f"    return {unit.constant(self.code)}.run(({', '.join(arguments)}))")
        other_keys = [key for key in groups if key.__class__ not in (Atom, int, Functor)]
        others = tuple(sorted({*groups[None], *[index for key in other_keys for index in groups[key]]}))
        if others:
            scope.write("else:")
            self._write_case(scope, others, None)
        scope.write("return None")
        return scope

    def _unbound_code(self, position: int) -> Optional[Code]:
        """Return code for calls whose argument at ``position`` is unbound, or None if no other argument is selective.

        Its function is generated when it is first run.
        """
        unbound = self._unbound | {position}
        if _selective_position(self.clauses, self.key.arity, unbound) is None:
            return None

        def generate(frame: Frame) -> Optional[Frame]:
            code.run = PredicateGenerator(
                self.database, self.key, self.clauses, self.code, unbound
            ).generate()
            return code.run(frame)

        code = Code(str(self.key), generate)
        code.functor = self.key
        return code

    def _group_by_key(self, position: int) -> Dict[object, List[int]]:
        """Return the indexes of the clauses for each first-level key of the switched argument.

        The entry of None has the clauses for all keys without an entry: those with a variable. They belong to every
        group, in the order of the program.
        """
        groups: Dict[object, List[int]] = {None: []}
        for index, clause in enumerate(self.clauses):
            key = key_of(clause.args[position])
            if key is None:
                for group in groups.values():
                    group.append(index)
            else:
                # A new group begins with the earlier clauses that match any key.
                groups.setdefault(key, list(groups[None])).append(index)
        return groups

    def _write_tuple_case(self, scope: Scope, groups: Dict[object, List[int]], local: str) -> None:
        keys = [key for key in groups if key.__class__ is Functor]
        scope.write("if k is tuple:")
        scope.depth += 1
        keyword = "if"
        for key in keys:
            scope.write(f"{keyword} {local}[0] is {scope.unit.constant(key)}:")
            self._write_case(scope, tuple(groups[key]), key)
            keyword = "elif"
        if groups[None]:
            if keys:
                scope.write("else:")
                self._write_case(scope, tuple(groups[None]), None)
            else:
                self._write_chain(scope, tuple(groups[None]), None)
        else:
            if keys:
                scope.write("else:")
                scope.depth += 1
            scope.write("return None")
            if keys:
                scope.depth -= 1
        scope.depth -= 1

    def _write_atomic_case(
        self, scope: Scope, groups: Dict[object, List[int]], local: str, key_class: type, test: str
    ) -> None:
        keys = [key for key in groups if key.__class__ is key_class]
        if not keys:
            return
        scope.write(f"elif k is {key_class.__name__}:")
        scope.depth += 1
        keyword = "if"
        for key in keys:
            scope.write(f"{keyword} {local} {test} {scope.unit.constant(key)}:")
            self._write_case(scope, tuple(groups[key]), key)
            keyword = "elif"
        if groups[None]:
            scope.write("else:")
            self._write_case(scope, tuple(groups[None]), None)
        else:
            scope.write("else:")
            scope.write("    return None")
        scope.depth -= 1

    def _write_case(self, scope: Scope, chain: Tuple[int, ...], key: object) -> None:
        scope.depth += 1
        self._write_chain(scope, chain, key)
        scope.depth -= 1

    # Chains of clauses

    def _write_chain(
        self, outer_scope: Scope, chain: Tuple[int, ...], key: object, retried: bool = False
    ) -> None:
        """Write the clauses of a chain in order.

        Args:
            outer_scope: the function that is written.
            chain: indexes of the clauses.
            key: functor or constant of the switched argument, if known.
            retried: whether the function runs on backtracking, where ``mark`` is set.
        """
        unit = outer_scope.unit
        if len(chain) > 1 and not retried:
            outer_scope.write("mark = len(trail)")
        for offset, index in enumerate(chain[:_MAX_CHAIN_CLAUSES]):
            following = chain[offset + 1 :]
            scope = self._write_clause(
                unit, index, following, key, outer_scope.depth, not retried, len(chain) == 1
            )
            outer_scope.has_iteration |= scope.has_iteration
            outer_scope.uses_choices |= scope.uses_choices
            outer_scope.lines += scope.lines
            if following and scope.may_bind:
                outer_scope.write("while len(trail) > mark:")
                outer_scope.write("    pop().ref = None")
        following = chain[_MAX_CHAIN_CLAUSES:]
        if following:
            frame = ", ".join([unit.constant(self._retry_code(following)), *self.locals, "after", "mark"])
            outer_scope.write(f"return ({frame})")

    def _retry_code(self, chain: Tuple[int, ...]) -> Code:
        """Return the code of a choice point for a chain; the function is generated when it first runs."""
        existing = self._retries.get(chain)
        if existing is not None:
            return existing

        # Most choice points are cut or never retried, so their code would be generated in vain.
        def generate(frame: Frame) -> Optional[Frame]:
            unit = CompilationUnit(self.database.machine, self.database)
            scope = Scope(unit, ClauseVariables(()))
            self._write_chain(scope, chain, None, retried=True)
            unit.add_function(["def main(frame):", self._unpacking_line(", mark"), *scope.lines])
            code.run = self._define(unit, "main", f" from clause {chain[0] + 1}")
            return code.run(frame)

        code = self._retries[chain] = Code(str(self.key), generate)
        code.functor = self.key
        return code

    def _write_clause(
        self,
        unit: CompilationUnit,
        index: int,
        following: Optional[Tuple[int, ...]],
        key: object = None,
        depth: int = 1,
        is_in_loop: bool = False,
        is_only_clause: bool = False,
        height: Optional[str] = None,
    ) -> Scope:
        """Return the code of a clause: head, then body.

        Args:
            unit: receives the functions.
            index: index of the clause.
            following: indexes of the clauses that follow in the chain; if there are any, the code is a block that
                ``break`` leaves on failure. None for the function of a single clause.
            key: functor or constant of the switched argument, if known.
            depth: indentation.
            is_in_loop: whether a recursive last call may become an iteration of the loop around the predicate.
            is_only_clause: whether the chain has no other clause.
            height: local that holds the height at entry, if the frame carries it.
        """
        clause = self.clauses[index]
        variables = ClauseVariables((*clause.args, clause.body))
        entry = Height("height")
        scope = Scope(unit, variables)
        scope.depth = depth
        if following:
            scope.fail = "break"
            scope.depth += 1
        if is_in_loop:
            scope.loop = Loop(self.key, self.locals, "" if following else "continue", self._base_case(unit))
        elif following == ():
            # Backtracking runs the last clause. Running a call of the predicate itself directly saves a step for each
            # solution. Such calls do not nest, because only backtracking runs this code.
            scope.direct_last_call = self.key
        if height is not None:
            scope.names[entry] = height
        if is_in_loop and is_only_clause and key.__class__ is Functor and self.position is not None:
            self._write_cons_loop(scope, clause, entry, self.position)
        argument_locals = self._copy_arguments(scope, clause, key) if following else self.locals
        if following:
            frame = ", ".join([unit.constant(self._retry_code(following)), *self.locals, "after", "mark"])
            scope.pending_choice = (
                f"{self._choice_point_test(scope, index, following, argument_locals)}choose(({frame}))"
            )
        self._write_head(scope, clause, key, argument_locals)
        nodes = BodyParser(self.database, entry).parse(clause.body)
        bodies = BodyGenerator(unit, variables, entry, self.database.interpret, str(self.key), self.key)
        bodies.write(scope, nodes)
        if following:
            indent = "    " * depth
            # The end of the block starts another iteration of the loop around the predicate, and ``break`` means
            # failure. A for-else tells them apart: its else part runs only if the block was not left by ``break``.
            if scope.has_iteration:
                scope.lines = [
                    f"{indent}for _ in ONE:",
                    *scope.lines,
                    f"{indent}else:",
                    f"{indent}    continue",
                ]
            else:
                scope.lines = [f"{indent}while True:", *scope.lines]
        return scope

    def _choice_point_test(
        self, scope: Scope, index: int, following: Tuple[int, ...], argument_locals: Sequence[str]
    ) -> str:
        """Return ``if test: `` for pushing the choice point of the following clauses; "" if it is always pushed.

        Following clauses cannot match if an argument that is bound at the call has the key of this clause, and they
        all have other keys for it. The test is evaluated before the head, which binds variables.
        """
        tests = []
        for position, (local, arg) in enumerate(zip(argument_locals, self.clauses[index].args)):
            key = key_of(arg)
            later_keys = [key_of(self.clauses[later].args[position]) for later in following]
            if (
                position != self.position
                and key is not None
                and None not in later_keys
                and key not in later_keys
            ):
                scope.dereference(local)
                tests.append(f"{local}.__class__ is Var")
        if not tests:
            return ""
        may_match = scope.temp("u")
        scope.write(f"{may_match} = {' and '.join(tests)}")
        return f"if {may_match}: "

    def _base_case(self, unit: CompilationUnit) -> Optional[Tuple[int, str]]:
        """Return the position of the switched argument and an atom for which the predicate is true; None if none."""
        if self.position is None:
            return None
        for key, group in self._group_by_key(self.position).items():
            clause = self.clauses[group[0]] if group else None
            if key.__class__ is not Atom or clause is None or len(group) > 1 or clause.body is not TRUE:
                continue
            others = [deref(arg) for position, arg in enumerate(clause.args) if position != self.position]
            if len(set(others)) == len(others) and all(arg.__class__ is Var for arg in others):
                return self.position, unit.constant(key)
        return None

    def _write_cons_loop(self, scope: Scope, clause: ClauseParts, entry: Height, position: int) -> None:
        """Write the loop of a clause that builds a list while it recurses; see `write_cons_loop`."""
        nodes = BodyParser(self.database, entry).parse(clause.body)
        cons_loop = find_cons_loop(scope.clause, clause.args, nodes, self.key, position)
        if cons_loop is not None:
            write_cons_loop(scope, self.locals, clause.args, nodes, cons_loop, position)

    def _copy_arguments(self, scope: Scope, clause: ClauseParts, key: object) -> List[str]:
        """Copy the arguments for a clause that others follow, and return the names of the copies.

        Dereferencing replaces a local by its value. If the clause itself has bound the variable, the following
        clauses must not see that value.
        """
        names = []
        for position, (local, arg) in enumerate(zip(self.locals, clause.args)):
            arg = deref(arg)
            needs_no_test = key is not None and position == self.position
            if needs_no_test or (arg.__class__ is Var and scope.clause.is_void(arg)):
                names.append(local)
            else:
                names.append(f"b{position + 1}")
        copies = [(name, local) for name, local in zip(names, self.locals) if name != local]
        if copies:
            targets, sources = zip(*copies)
            scope.write(f"{', '.join(targets)} = {', '.join(sources)}")
        return names

    def _write_head(
        self, scope: Scope, clause: ClauseParts, key: object, argument_locals: Sequence[str]
    ) -> None:
        """Write the unification of the head: first constants, then variables, then compound terms."""
        patterns = [
            (local, deref(arg), position)
            for position, (local, arg) in enumerate(zip(argument_locals, clause.args))
        ]
        for local, arg, _ in patterns:
            if arg.__class__ is Var and arg not in scope.names:
                scope.names[arg] = local
        for stage in (0, 1, 2):
            for local, arg, position in patterns:
                if stage != (2 if arg.__class__ is tuple else 1 if arg.__class__ is Var else 0):
                    continue
                if key is not None and position == self.position:
                    if arg.__class__ is tuple:
                        write_read_mode(scope, local, arg, 0, check=False)
                        continue
                    if arg.__class__ is not Var:
                        continue
                if arg.__class__ is Var and scope.clause.is_void(arg):
                    continue
                match(scope, local, arg)


def title_of(place: Optional[Place], name: str) -> str:
    """Return the name in tracebacks of the code generated for a clause or goal."""
    return name if place is None else f"{place.source}:{place.line} {name}"


def _selective_position(
    clauses: Sequence[ClauseParts], arity: int, unbound: FrozenSet[int] = frozenset()
) -> Optional[int]:
    """Return the position of the argument whose keys distinguish the clauses best; None if none does.

    The first argument is preferred to better ones if it distinguishes clauses and its score is positive: programmers
    rely on first-argument indexing.
    """
    best_score, position = 0, None
    # Only the first arguments are examined, which bounds the work for predicates of many arguments.
    for candidate in range(min(arity, 8) if len(clauses) > 1 else 0):
        if candidate in unbound:
            continue
        keys = [key_of(clause.args[candidate]) for clause in clauses]
        bound_keys = [key for key in keys if key is not None]
        distinct = len(set(bound_keys))
        # A clause with a variable belongs to every case, which makes the switch less selective: each costs three
        # quarters of what a further key gains.
        score = distinct * 4 - (len(keys) - len(bound_keys)) * 3
        if bound_keys and score > best_score:
            best_score, position = score, candidate
        if candidate == 0 and distinct > 1 and position == 0:
            break
    return position
