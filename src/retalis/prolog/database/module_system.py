"""Modules, implemented by renaming predicates when clauses are loaded.

There is one predicate table for all modules. Exported predicates of a module have their plain names in it. Every
other predicate that the module's file defines has a qualified name: ``p/1`` of module ``m`` is stored as ``m:p/1``.
If a qualified name is called and not defined, the plain one is called instead (`ModuleNames.plain_functor`).

`Modules` rewrites the clauses and goals of a module's file when they are added, so modules have no cost at run time.
It has to know which arguments of a predicate are goals, closures, clauses, or predicate indicators:
`SYSTEM_ARGUMENT_KINDS` declares that for the system's predicates, ``meta_predicate/1`` for the program's. An argument
that becomes a goal only at run time, such as a variable in ``call/1``, is wrapped as ``Module:Goal`` and rewritten
when it is called.
"""

from contextlib import contextmanager
from typing import (
    Callable,
    Dict,
    FrozenSet,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
    Union,
)

from ..compiler.clause_nodes import PROTECTED_PREDICATES
from ..machine.errors import indicator, instantiation_error, permission_error, type_error
from ..terms.list_terms import list_items
from ..terms.types import (
    COLON,
    COMMA,
    CONS,
    SLASH,
    Atom,
    CompoundTerm,
    Functor,
    Term,
    Var,
    atom,
    deref,
    functor,
)

ArgumentKind = Union[int, str]
"""Kind of an argument of a predicate.

A number is a closure to which that many arguments are added before it is called; 0 is a goal. ``^`` is a goal that
``Variable^`` may precede, ``:`` any term that belongs to a module, ``clause`` a clause to be added, ``search`` a
clause to be found, ``head`` a clause head, ``declared`` indicators of predicates that are declared, ``existing``
indicators of existing predicates. Any other kind is a plain term.
"""

ArgumentKinds = Tuple[ArgumentKind, ...]

PLAIN: ArgumentKind = "?"
"""Kind of an argument that is a plain term."""


def _parse_kinds(text: str) -> Dict[Functor, ArgumentKinds]:
    """Return the argument kinds in a text of entries such as ``findall(?|0|?)``."""
    kinds_of: Dict[Functor, ArgumentKinds] = {}
    for entry in text.split():
        name, _, rest = entry.rpartition("(")
        argument_kinds = tuple(int(kind) if kind.isdigit() else kind for kind in rest.rstrip(")").split("|"))
        kinds_of[functor(name, len(argument_kinds))] = argument_kinds
    return kinds_of


SYSTEM_ARGUMENT_KINDS: Dict[Functor, ArgumentKinds] = _parse_kinds(
    """
    ,(0|0) ;(0|0) |(0|0) ->(0|0) *->(0|0) \\+(0) not(0) once(0) ignore(0) forall(0|0) catch(0|?|0)
    call(0) call(1|?) call(2|?|?) call(3|?|?|?) call(4|?|?|?|?) call(5|?|?|?|?|?) call(6|?|?|?|?|?|?)
    call(7|?|?|?|?|?|?|?) apply(:|?) findall(?|0|?) findall(?|0|?|?) findnsols(?|?|0|?) findnsols(?|?|0|?|?)
    bagof(?|^|?) setof(?|^|?) aggregate_all(?|0|?) aggregate_all(?|?|0|?) aggregate(?|^|?)
    setup_call_cleanup(0|0|0) call_cleanup(0|0) with_output_to(?|0) call_with_time_limit(?|0)
    call_with_inference_limit(0|?|?) limit(?|0) offset(?|0) call_nth(0|?) freeze(?|0) when(?|0) assertion(0)
    trace(0) time(0) initialization(0) initialization(0|?)
    maplist(1|?) maplist(2|?|?) maplist(3|?|?|?) maplist(4|?|?|?|?) maplist(5|?|?|?|?|?) maplist(6|?|?|?|?|?|?)
    foldl(3|?|?|?) foldl(4|?|?|?|?) foldl(5|?|?|?|?|?) foldl(6|?|?|?|?|?|?) foldr(3|?|?|?)
    include(1|?|?) exclude(1|?|?) partition(1|?|?|?) partition(2|?|?|?|?|?) predsort(3|?|?) max_member(2|?|?)
    min_member(2|?|?) map_assoc(1|?) map_assoc(2|?|?) convlist(2|?|?)
    aggregate(?|?|^|?) foreach(0|0) group_by(?|?|0|?) scanl(3|?|?|?) order_by(?|0)
    phrase(:|?) phrase(:|?|?) phrase_from_file(:|?) phrase_from_file(:|?|?) phrase_from_stream(:|?)
    assert(clause) asserta(clause) assertz(clause) retract(search) retractall(head)
    clause(head|?) abolish(existing) dynamic(declared) discontiguous(declared) multifile(declared) table(declared)
    public(declared) volatile(declared) module_transparent(declared) current_predicate(existing)
    predicate_property(head|?) meta_predicate(declared) nth_clause(head|?|?) strip_module(:|?|?) listing(existing)
    """
)
"""Argument kinds of the system's predicates."""


def parse_meta_declaration(args: Tuple[object, ...]) -> ArgumentKinds:
    """Return the argument kinds that a ``meta_predicate/1`` declaration specifies by its arguments."""
    kinds: List[ArgumentKind] = []
    for arg in args:
        if isinstance(arg, int):
            kinds.append(arg)
        else:
            name = getattr(arg, "name", "")
            kinds.append({"^": "^", ":": ":", "//": ":"}.get(name, PLAIN))
    return tuple(kinds)


GRAMMAR_NAME = functor("//", 2)

_GLOBAL_PREDICATES = PROTECTED_PREDICATES | {
    functor("term_expansion", 2),
    functor("goal_expansion", 2),
    functor("portray", 1),
    functor("message_hook", 3),
}
"""Predicates that belong to no module: control constructs and other fixed ones, and hooks that the system calls."""


class ModuleSnapshot(NamedTuple):
    """Module as plain data.

    Attributes:
        exports: functors of the exported predicates.
        imports: functors of the imported predicates.
        own_names: names of its own predicates.
        import_names: for each import, the name under which the predicate is stored.
    """

    exports: List[Functor]
    imports: List[Functor]
    own_names: List[str]
    import_names: List[str]


def functor_of_indicator(term: CompoundTerm) -> Optional[Functor]:
    """Return the functor that ``Name/Arity`` or ``Name//Arity`` names; None if it is not a valid indicator."""
    name, arity = deref(term[1]), deref(term[2])
    if not isinstance(name, Atom) or not isinstance(arity, int):
        return None
    return functor(name.name, arity + (2 if term[0] is GRAMMAR_NAME else 0))


class Module:
    """Module of a program.

    Attributes:
        name_atom: the name as an atom, which qualifies goals.
        exports: predicates that other modules call by their plain names.
        shadowed_exports: exported predicates whose plain names another module exports already.
        imports: functors of imported predicates, mapped to the functors under which they are stored.
    """

    def __init__(self, name: str):
        self.name = name
        self.name_atom = atom(name)
        self.exports: Set[Functor] = set()
        self.shadowed_exports: Set[Functor] = set()
        self.imports: Dict[Functor, Functor] = {}


USER_MODULE = Module("user")
"""Context of terms that do not belong to a module."""


class ModuleNames:
    """Modules of a program, and resolution of names in them.

    Args:
        is_defined: returns whether the program has a predicate with a functor.
        is_system_predicate: returns whether a functor is that of a predicate of the system.
        on_module: called with the name of each module that a file declares.
        on_change: called after a module was added.
        warn: called with a warning about a name that cannot be imported.

    Attributes:
        modules: modules by name.
        declared_kinds_of: argument kinds of the program's own predicates.
        loading_module: module whose file is being loaded, or None.
        last_loaded_name: name of the module whose file was loaded last; "" if that file was no module.
    """

    def __init__(
        self,
        is_defined: Callable[[Functor], bool],
        is_system_predicate: Callable[[Functor], bool],
        on_module: Callable[[str], None],
        on_change: Callable[[], None],
        warn: Callable[[str], None],
    ):
        self._is_defined = is_defined
        self._is_system_predicate = is_system_predicate
        self._on_module = on_module
        self._on_change = on_change
        self._warn = warn
        self.modules: Dict[str, Module] = {}
        self.declared_kinds_of: Dict[Functor, ArgumentKinds] = {}
        self.loading_module: Optional[Module] = None
        self.last_loaded_name = ""
        # For each file that is being loaded, whether it may declare a module; the innermost one is last.
        self._files: List[bool] = []
        self._plain_names: Dict[str, str] = {}

    @contextmanager
    def loading_file(self, may_be_module: bool = True) -> Iterator[None]:
        """Return a context in which a file is loaded. A module that the file declares is active until it ends.

        Args:
            may_be_module: whether the file may declare a module. A file without a declaration belongs to the module
                of the file that loads it. False for files of event rules, whose goals belong to no module.
        """
        outer_module = self.loading_module
        if not may_be_module:
            self.loading_module = None
        self._files.append(may_be_module)
        depth = len(self._files)
        try:
            yield
            self.last_loaded_name = (
                ""
                if self.loading_module is None or self.loading_module is outer_module
                else self.loading_module.name
            )
        finally:
            self.loading_module = outer_module
            # An exception may have left entries of files that this one was loading.
            del self._files[depth - 1 :]

    def begin_module(self, name: str, exports: Iterable[Functor]) -> bool:
        """Assign the following terms of the file to a module.

        Returns:
            Whether the file may declare a module.

        Raises:
            PrologError: if no file is being loaded.
        """
        if not self._files:
            raise permission_error("load", "module", atom(name), "module/2 is a directive of a file")
        if not self._files[-1]:
            return False
        is_new = name not in self.modules
        module = self.modules.setdefault(name, Module(name))
        module.exports = set(exports)
        # The first module keeps the plain name. A silent replacement would change the meaning of files loaded before.
        module.shadowed_exports = module.exports & self._exported_elsewhere(module)
        for key in sorted(module.shadowed_exports, key=str):
            self._warn_of_import_conflict(module, key, "user", key)
        self.loading_module = module
        self._on_module(name)
        if is_new:
            # Code that has been compiled so far calls the plain names.
            self._on_change()
        return True

    def import_exports(self, name: str) -> None:
        """Import the exports of a module into the module of the file that is being loaded."""
        module = self.modules.get(name)
        if module is not None and self.loading_module is not None and module is not self.loading_module:
            for key in sorted(module.exports, key=str):
                target = self.stored_functor(module, key)
                if self.loading_module.imports.setdefault(key, target) is not target:
                    self._warn_of_import_conflict(
                        module, key, self.loading_module.name, self.loading_module.imports[key]
                    )

    def _exported_elsewhere(self, module: Module) -> Set[Functor]:
        """Return the plain names that other modules export."""
        other_modules = (other_module for other_module in self.modules.values() if other_module is not module)
        return {
            key
            for other_module in other_modules
            for key in other_module.exports - other_module.shadowed_exports
        }

    def _warn_of_import_conflict(self, module: Module, key: Functor, importer: str, current: Functor) -> None:
        """Warn that a module cannot import a predicate, because it has imported ``current`` under its name."""
        exporter = next(
            (
                other_module.name
                for other_module in self.modules.values()
                if other_module is not module
                and key in other_module.exports
                and self.stored_functor(other_module, key) is current
            ),
            "user",
        )
        qualified = f"{module.name}:{key}"
        self._warn(
            f"Warning: no permission to import {qualified} into {importer}: already imported from {exporter}; "
            f"{module.name}:{key.name}(...) calls it\n"
        )

    def find_module(self, term: Term) -> Optional[Module]:
        """Return the module whose name a term is; None if there is no such module."""
        term = deref(term)
        return self.modules.get(term.name) if isinstance(term, Atom) else None

    # Names

    def plain_functor(self, key: Functor) -> Optional[Functor]:
        """Return the plain functor of a qualified predicate; None for other predicates."""
        name = self._plain_names.get(key.name)
        return None if name is None else functor(name, key.arity)

    def module_indicator(self, key: Functor) -> Optional[Term]:
        """Return the indicator of a qualified predicate, such as ``m:(p/1)``; None for other predicates."""
        name = self._plain_names.get(key.name)
        if name is None:
            return None
        return (COLON, atom(key.name[: -len(name) - 1]), (SLASH, atom(name), key.arity))

    def _has_plain_name(self, module: Module, key: Functor) -> bool:
        """Return whether a module's predicate is stored under its name without the module."""
        if key in module.exports and key not in module.shadowed_exports:
            return True
        return key in _GLOBAL_PREDICATES or key.name in self._plain_names

    def stored_functor(self, module: Module, key: Functor) -> Functor:
        """Return the functor under which a module's own predicate is stored in the predicate table."""
        if self._has_plain_name(module, key):
            return key
        name = f"{module.name}:{key.name}"
        self._plain_names[name] = key.name
        return functor(name, key.arity)

    def assertion_target(self, module: Module, key: Functor) -> Functor:
        """Return the functor of the predicate to which a module asserts clauses: its own, or an imported one."""
        own_functor = self.stored_functor(module, key)
        return (
            module.imports[key]
            if key in module.imports and not self._is_defined(own_functor)
            else own_functor
        )

    def resolve(self, module: Module, key: Functor) -> Functor:
        """Return the functor of the predicate that a name refers to in a module."""
        if self._has_plain_name(module, key):
            return key
        # Own definitions take precedence over imported and system predicates, as in SWI-Prolog.
        if (key in module.imports or self._is_system_predicate(key)) and not self._is_defined(
            functor(f"{module.name}:{key.name}", key.arity)
        ):
            return module.imports.get(key, key)
        return self.stored_functor(module, key)

    def restore(self, modules: Dict[str, ModuleSnapshot]) -> None:
        """Add the modules that `snapshot` returned."""
        for name, saved in modules.items():
            module = self.modules.setdefault(name, Module(name))
            module.exports.update(saved.exports)
            module.shadowed_exports = module.exports & self._exported_elsewhere(module)
            for key, stored_name in zip(saved.imports, saved.import_names):
                module.imports[key] = functor(stored_name, key.arity)
            self._plain_names.update({f"{name}:{plain}": plain for plain in saved.own_names})

    def snapshot(self) -> Dict[str, ModuleSnapshot]:
        """Return all modules as plain data, for `restore`."""
        return {
            name: ModuleSnapshot(
                exports=sorted(module.exports, key=str),
                imports=sorted(module.imports, key=str),
                own_names=sorted(
                    plain
                    for qualified_name, plain in self._plain_names.items()
                    if qualified_name == f"{name}:{plain}"
                ),
                import_names=[module.imports[key].name for key in sorted(module.imports, key=str)],
            )
            for name, module in self.modules.items()
        }

    def argument_kinds(self, key: Functor) -> Optional[ArgumentKinds]:
        """Return the argument kinds of a predicate; None if all arguments are plain."""
        argument_kinds = self.declared_kinds_of.get(key)
        if argument_kinds is None:
            # If a qualified predicate is not defined, the plain one is called instead.
            plain = self.plain_functor(key)
            if plain is not None and not self._is_defined(key):
                key = plain
            argument_kinds = self.declared_kinds_of.get(key) or SYSTEM_ARGUMENT_KINDS.get(key)
        return argument_kinds


_NECK, _GRAMMAR = functor(":-", 2), functor("-->", 2)
_SINGLE_SIDED = functor("=>", 2)
_HAT, _LAMBDA = functor("^", 2), functor(">>", 2)
_CHAINS = frozenset(functor(name, 2) for name in (",", ";", "|", "->", "*->"))
_AS = functor("as", 2)
_NO_VARIABLES: FrozenSet[Var] = frozenset()


class Modules(ModuleNames):
    """Modules of a program, and rewriting of the clauses and goals in their files."""

    def resolve_qualified_goal(self, goal: CompoundTerm) -> Term:
        """Return the goal that ``Module:Goal`` calls. If the module is unknown, return the goal without the
        qualifier.

        Raises:
            PrologError: an instantiation or type error if it is not a goal.
        """
        module = self.find_module(goal[1])
        if module is None:
            if deref(goal[1]).__class__ is Var:
                raise instantiation_error()
            return deref(goal[2])
        plain_goal = deref(goal[2])
        if plain_goal.__class__ is Var:
            raise instantiation_error()
        if plain_goal.__class__ is not tuple and plain_goal.__class__ is not Atom:
            raise type_error("callable", plain_goal)
        return self.resolve_body(module, plain_goal)

    def resolve_quantified_goal(self, goal: CompoundTerm) -> Term:
        """Return the goal that ``Module:Goal`` calls if ``Variable^`` may precede the goal."""
        module, plain_goal = self.find_module(goal[1]), deref(goal[2])
        return (
            plain_goal
            if module is None or plain_goal.__class__ is Var
            else self._resolve_argument(module, "^", plain_goal, _NO_VARIABLES)
        )

    def resolve_qualified_closure(self, goal: CompoundTerm, extra_count: int) -> Term:
        """Return the closure that ``Module:Closure`` refers to if ``extra_count`` arguments are added to it."""
        module = self.find_module(goal[1])
        plain_closure = deref(goal[2])
        return (
            plain_closure
            if module is None or plain_closure.__class__ is Var
            else self.resolve_closure(module, plain_closure, extra_count)
        )

    def resolve_body(
        self, module: Module, goal: Term, module_variables: FrozenSet[Var] = _NO_VARIABLES
    ) -> Term:
        """Return a goal of a module with all names resolved, so that it has the same meaning anywhere.

        Args:
            module: module in which the goal was written.
            goal: the goal.
            module_variables: variables that are bound to module-qualified goals at run time.
        """
        # Iterates along conjunctions, which may be longer than the recursion limit allows.
        chain: List[Tuple[Functor, Term]] = []
        goal = deref(goal)
        while goal.__class__ is tuple and goal[0] in _CHAINS:
            chain.append((goal[0], self.resolve_body(module, goal[1], module_variables)))
            goal = deref(goal[2])
        resolved = self._resolve_goal(module, goal, module_variables)
        for key, conjunct in reversed(chain):
            resolved = (key, conjunct, resolved)
        return resolved

    def _resolve_goal(self, module: Module, goal: Term, module_variables: FrozenSet[Var]) -> Term:
        """Return a goal that is no control construct, with its name and arguments resolved; see `resolve_body`."""
        if goal.__class__ is Var:
            # The goal is known only at run time, so it is qualified with the module.
            return goal if goal in module_variables else (COLON, module.name_atom, goal)
        if goal.__class__ is Atom:
            key = self.resolve(module, goal.functor)
            return goal if key is goal.functor else atom(key.name)
        if goal.__class__ is not tuple:
            return goal
        if goal[0] is COLON:
            named_module = self.find_module(goal[1])
            return (
                goal if named_module is None else self.resolve_body(named_module, goal[2], module_variables)
            )
        key = self.resolve(module, goal[0])
        return (key, *self._resolve_arguments(module, key, goal[1:], module_variables))

    def _resolve_arguments(
        self, module: Module, key: Functor, args: Tuple[Term, ...], module_variables: FrozenSet[Var]
    ) -> Sequence[Term]:
        kinds = self.argument_kinds(key)
        if kinds is None:
            return args
        return [
            self._resolve_argument(module, argument_kind, arg, module_variables)
            for argument_kind, arg in zip(kinds, args)
        ]

    def _resolve_argument(
        self, module: Module, argument_kind: ArgumentKind, arg: Term, module_variables: FrozenSet[Var]
    ) -> Term:
        if argument_kind is PLAIN or argument_kind == PLAIN:
            return arg
        if isinstance(argument_kind, int):
            return (
                self.resolve_closure(module, arg, argument_kind, module_variables)
                if argument_kind
                else self.resolve_body(module, arg, module_variables)
            )
        arg = deref(arg)
        if argument_kind == "declared" or argument_kind == "existing":
            return self.resolve_indicators(
                module, arg, self.stored_functor if argument_kind == "declared" else self.resolve
            )
        if arg.__class__ is Var:
            return arg if arg in module_variables else (COLON, module.name_atom, arg)
        if argument_kind == "^":
            if arg.__class__ is tuple and arg[0] is _HAT:
                return (
                    _HAT,
                    arg[1],
                    self._resolve_argument(module, argument_kind, arg[2], module_variables),
                )
            return self.resolve_body(module, arg, module_variables)
        if argument_kind == "clause":
            return self.resolve_clause(module, arg, module_variables, self.assertion_target)
        if argument_kind == "search":
            return self._resolve_clause_to_find(module, arg)
        if argument_kind == "head":
            return self._resolve_head(module, arg, self.resolve)
        return arg if arg.__class__ is tuple and arg[0] is COLON else (COLON, module.name_atom, arg)

    def resolve_closure(
        self, module: Module, goal: Term, extra_count: int, module_variables: FrozenSet[Var] = _NO_VARIABLES
    ) -> Term:
        """Return a closure to which ``extra_count`` arguments are added, with names resolved; see `resolve_body`."""
        goal = deref(goal)
        if goal.__class__ is Var:
            return goal if goal in module_variables else (COLON, module.name_atom, goal)
        if goal.__class__ is Atom:
            key = self.resolve(module, functor(goal.name, extra_count))
            return goal if key.name == goal.name else atom(key.name)
        if goal.__class__ is not tuple:
            return goal
        if goal[0] is COLON:
            named_module = self.find_module(goal[1])
            return (
                goal
                if named_module is None
                else self.resolve_closure(named_module, goal[2], extra_count, module_variables)
            )
        if goal[0] is _LAMBDA:
            return self._resolve_lambda(module, goal, extra_count, module_variables)
        plain_closure: Term = deref(goal[-1])
        if goal[0] is SLASH and plain_closure.__class__ is tuple and plain_closure[0] is _LAMBDA:
            return (
                SLASH,
                goal[1],
                self.resolve_closure(module, plain_closure, extra_count, module_variables),
            )
        # The name is resolved with the arity of the call, and the closure keeps its own arity.
        resolved_functor = self.resolve(module, functor(goal[0].name, len(goal) - 1 + extra_count))
        key = (
            goal[0]
            if resolved_functor.name == goal[0].name
            else functor(resolved_functor.name, len(goal) - 1)
        )
        return (key, *self._resolve_arguments(module, resolved_functor, goal[1:], module_variables))

    def _resolve_lambda(
        self, module: Module, goal: CompoundTerm, extra_count: int, module_variables: FrozenSet[Var]
    ) -> Term:
        parameters = deref(goal[1])
        if parameters.__class__ is tuple and parameters[0] is SLASH:
            parameters = deref(parameters[2])
        missing = extra_count - len(list_items(parameters) or ())
        body = (
            self.resolve_closure(module, goal[2], missing, module_variables)
            if missing > 0
            else self.resolve_body(module, goal[2], module_variables)
        )
        return (_LAMBDA, goal[1], body)

    # Clauses

    def resolve_clause(
        self,
        module: Module,
        term: Term,
        module_variables: FrozenSet[Var] = _NO_VARIABLES,
        resolve_name: Optional[Callable[[Module, Functor], Functor]] = None,
    ) -> Term:
        """Return a clause of a module with all names resolved.

        Args:
            module: module in which the clause was written.
            term: the clause.
            module_variables: variables that are bound to module-qualified goals at run time; see `resolve_body`.
            resolve_name: returns the functor of the clause's predicate; by default `stored_functor`.
        """
        resolve_name = resolve_name or self.stored_functor
        term = deref(term)
        if term.__class__ is not tuple or term[0] not in (_NECK, _SINGLE_SIDED, _GRAMMAR, COLON):
            return self._resolve_head(module, term, resolve_name)
        # A grammar rule is resolved after translation to a clause, because names are resolved by arity and the
        # translation adds two arguments.
        if term[0] is _GRAMMAR:
            return (COLON, module.name_atom, term)
        if term[0] is COLON:
            plain_clause, named_module = deref(term[2]), self.find_module(term[1])
            if named_module is not None and plain_clause.__class__ is not Var:
                return self.resolve_clause(named_module, plain_clause, module_variables, resolve_name)
            return term
        head_term = deref(term[1])
        guard: Optional[Term] = None
        if term[0] is _SINGLE_SIDED and isinstance(head_term, tuple) and head_term[0] is COMMA:
            guard, head_term = head_term[2], deref(head_term[1])
        head = self._resolve_head(module, head_term, resolve_name)
        module_variables = module_variables | self._goal_variables(head)
        if guard is not None:
            head = (COMMA, head, self.resolve_body(module, guard, module_variables))
        return (term[0], head, self.resolve_body(module, term[2], module_variables))

    def _goal_variables(self, head: Term) -> FrozenSet[Var]:
        """Return the variables of a head in arguments that are goals; callers pass qualified goals for them."""
        if head.__class__ is not tuple:
            return _NO_VARIABLES
        kinds = self.declared_kinds_of.get(head[0])
        goals = [deref(arg) for kind, arg in zip(kinds or (), head[1:]) if kind != PLAIN]
        return frozenset(arg for arg in goals if isinstance(arg, Var))

    def _resolve_head(
        self, module: Module, head: Term, resolve_name: Callable[[Module, Functor], Functor]
    ) -> Term:
        if head.__class__ is Atom:
            key = resolve_name(module, head.functor)
            return head if key is head.functor else atom(key.name)
        if head.__class__ is not tuple:
            return head
        if head[0] is not COLON:
            return (resolve_name(module, head[0]), *head[1:])
        named_module = self.find_module(head[1])
        plain_head = deref(head[2])
        if named_module is None or plain_head.__class__ is Var:
            return head if plain_head.__class__ is Var else plain_head
        return self._resolve_head(named_module, plain_head, resolve_name)

    def resolve_head_module(self, term: CompoundTerm) -> Term:
        """Return a clause that belongs to no module, with the module qualifier of its head resolved."""
        head = deref(term[1])
        if head.__class__ is tuple and head[0] is COLON:
            return (term[0], self._resolve_head(USER_MODULE, head, self.stored_functor), term[2])
        return term

    def resolve_searched_clause(self, term: Term) -> Term:
        """Return a clause or head that a goal searches, with its module qualifier resolved."""
        term = deref(term)
        while term.__class__ is tuple and term[0] is COLON:
            module, plain_clause = self.find_module(term[1]), deref(term[2])
            if module is not None and (plain_clause.__class__ is tuple or plain_clause.__class__ is Atom):
                plain_clause = self._resolve_clause_to_find(module, plain_clause)
            term = plain_clause
        return term

    def resolve_declared_indicators(self, term: Term) -> Term:
        """Return predicate indicators that belong to no module, with their module qualifiers resolved."""
        if not self.modules:
            return term
        return self.resolve_indicators(
            USER_MODULE,
            term,
            lambda module, key: key if module is USER_MODULE else self.stored_functor(module, key),
        )

    def _resolve_clause_to_find(self, module: Module, term: Term) -> Term:
        if term.__class__ is not tuple or term[0] is not _NECK:
            return self._resolve_head(module, term, self.resolve)
        head, body = deref(term[1]), deref(term[2])
        if head.__class__ is Var:
            head = (COLON, module.name_atom, head)
        else:
            head = self._resolve_head(module, head, self.resolve)
        return (_NECK, head, body if body.__class__ is Var else self.resolve_body(module, body))

    def resolve_indicators(
        self, module: Module, term: Term, resolve_name: Callable[[Module, Functor], Functor]
    ) -> Term:
        """Return indicators of a module's predicates (or heads with modes, or lists) with names resolved."""
        term = deref(term)
        if term.__class__ is not tuple:
            return term
        if term[0] in (COMMA, CONS):
            left = self.resolve_indicators(module, term[1], resolve_name)
            return (term[0], left, self.resolve_indicators(module, term[2], resolve_name))
        if term[0] is COLON:
            named_module = self.find_module(term[1])
            return (
                deref(term[2])
                if named_module is None
                else self.resolve_indicators(named_module, term[2], resolve_name)
            )
        if term[0] is _AS:
            return (_AS, self.resolve_indicators(module, term[1], resolve_name), term[2])
        if term[0] is SLASH or term[0] is GRAMMAR_NAME:
            key = functor_of_indicator(term)
            return term if key is None else indicator(resolve_name(module, key))
        return (resolve_name(module, term[0]), *term[1:])

    # Display

    def display_form(self, term: Term) -> Term:
        """Return a term for display, with plain names, and without the qualifiers that `resolve_body` adds."""
        if not self._plain_names:
            return term
        try:
            return self._to_display_form(term)
        except RecursionError:
            # For display only: a term that is nested too deeply is shown with its qualified names.
            return term

    def _to_display_form(self, term: Term) -> Term:
        term = deref(term)
        if isinstance(term, Atom):
            name = self._plain_names.get(term.name)
            return term if name is None else atom(name)
        if term.__class__ is not tuple:
            return term
        if term[0] is COLON and deref(term[2]).__class__ is Var and self.find_module(term[1]) is not None:
            return deref(term[2])
        return (self.plain_functor(term[0]) or term[0], *[self._to_display_form(arg) for arg in term[1:]])
