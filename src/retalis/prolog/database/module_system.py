"""Which arguments of predicates are goals, closures, clauses or names of predicates: there a module's names hold.

Names of predicates in modules: what a file calls its own is nobody else's name for it.

There is one table of predicates. Those that a module exports have their plain names in it; every other name that is
used in a module's file, and not the system's or imported, stands there with the module's in front: ``p/1`` of module
``m`` is ``m:p/1``. A name of a module that nobody has defined stands for the plain one (`ModuleNames.plain_of`).

Modules: clauses and goals of their files, rewritten when they are added so that they mean the same everywhere.

Running them costs nothing then. What only is a goal at run time, as a variable in ``call/1``, is marked with its
module, and rewritten when it is called.
"""

from contextlib import contextmanager
from typing import Callable, Dict, FrozenSet, Iterable, Iterator, List, Optional, Sequence, Set, Tuple, Union

from ..compiler.clause_nodes import FIXED
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
"""What an argument is.

A number is that of the arguments that are added to it before it is called, 0 for a goal. ``^`` is a goal after
``Variable^``, ``:`` anything that belongs to a module, ``clause`` a clause to be added, ``match`` one to be found,
``head`` a head, ``names`` indicators of what is declared, ``named`` of what is there. Anything else is plain.
"""

ArgumentKinds = Tuple[ArgumentKind, ...]

PLAIN: ArgumentKind = "?"


def _kinds(text: str) -> Dict[Functor, ArgumentKinds]:
    found: Dict[Functor, ArgumentKinds] = {}
    for entry in text.split():
        name, _, rest = entry.rpartition("(")
        kinds = tuple(int(one) if one.isdigit() else one for one in rest.rstrip(")").split("|"))
        found[functor(name, len(kinds))] = kinds
    return found


METAS: Dict[Functor, ArgumentKinds] = _kinds(
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
    aggregate(?|?|^|?) foreach(0|0) group_by(?|?|0|?) scanl(3|?|?|?) sublist(1|?|?) checklist(1|?) order_by(?|0)
    mapargs(2|?|?) mapsubterms(2|?|?)
    phrase(:|?) phrase(:|?|?) phrase_from_file(:|?) phrase_from_file(:|?|?) phrase_from_stream(:|?)
    assert(clause) asserta(clause) assertz(clause) retract(match) retractall(head)
    clause(head|?) abolish(named) dynamic(names) discontiguous(names) multifile(names) table(names)
    public(names) volatile(names) module_transparent(names) current_predicate(named) predicate_property(head|?)
    meta_predicate(names) nth_clause(head|?|?) strip_module(:|?|?) listing(named)
    """
)
"""Those of the system."""


def declared_kinds(args: Tuple[object, ...]) -> ArgumentKinds:
    """Return what the arguments of a predicate are, as ``meta_predicate/1`` says by integers and modes."""
    kinds: List[ArgumentKind] = []
    for arg in args:
        if isinstance(arg, int):
            kinds.append(arg)
        else:
            name = getattr(arg, "name", "")
            kinds.append({"^": "^", ":": ":", "//": ":"}.get(name, PLAIN))
    return tuple(kinds)


GRAMMAR_NAME = functor("//", 2)

_EVERYBODYS = FIXED | {
    *(functor(name, 2) for name in ("term_expansion", "goal_expansion")),
    *(functor("portray", 1), functor("message_hook", 3)),
}
"""What no module has for itself: what is fixed, and what the system asks the program for."""

KeptModule = Tuple[List[Functor], List[Functor], List[str], List[str]]
"""What a module exports and imports, the names of its own, and what those that it imports are called."""


def indicated(term: CompoundTerm) -> Optional[Functor]:
    """Return the functor that ``Name/Arity`` or ``Name//Arity`` names, None where it names none."""
    name, arity = deref(term[1]), deref(term[2])
    if not isinstance(name, Atom) or not isinstance(arity, int):
        return None
    return functor(name.name, arity + (2 if term[0] is GRAMMAR_NAME else 0))


class Module:
    """A module.

    Attributes:
        name: of it.
        mark: the same as an atom.
        exports: its predicates that others call by their plain names.
        hidden: those of them whose plain names another module has had before.
        imports: those of others that it has asked for, and what these are called.
    """

    def __init__(self, name: str):
        self.name = name
        self.mark = atom(name)
        self.exports: Set[Functor] = set()
        self.hidden: Set[Functor] = set()
        self.imports: Dict[Functor, Functor] = {}


EVERYBODY = Module("user")
"""Stands for no module."""


class ModuleNames:
    """The modules of a program.

    Attributes:
        table: by their names.
        metas: what arguments of the program's own predicates are, see `metas`.
        loading: the module whose file is being loaded.
        last: the name of that whose file was loaded last, "" where that was none.
        is_there: tells whether the program has a predicate of a functor.
        is_of_system: tells whether the system has one.
        shared: predicates that are everybody's for now, wherever they are defined.
        on_begin: called with the name of each module whose file begins.
        on_change: called where there is a new one.
        on_clash: called with what cannot be imported.
    """

    def __init__(self) -> None:
        self.table: Dict[str, Module] = {}
        self.shared: Set[Functor] = set()
        self.metas: Dict[Functor, ArgumentKinds] = {}
        self.loading: Optional[Module] = None
        self.last = ""
        self.is_there: Callable[[Functor], bool] = lambda key: False
        self.is_of_system: Callable[[Functor], bool] = lambda key: False
        self.on_begin: Callable[[str], None] = lambda name: None
        self.on_change: Callable[[], None] = lambda: None
        self.on_clash: Callable[[str], None] = lambda text: None
        self._files: List[bool] = []
        self._plain: Dict[str, str] = {}

    @contextmanager
    def of_file(self, may_be_one: bool = True) -> Iterator[None]:
        """Load a file meanwhile: a module that it says it is ends with it.

        Args:
            may_be_one: whether it may be one, and goes on with that of the file that loads it: not one of event
                rules, whose goals belong to nobody.
        """
        before = self.loading
        if not may_be_one:
            self.loading = None
        self._files.append(may_be_one)
        depth = len(self._files)
        try:
            yield
            self.last = "" if self.loading is None or self.loading is before else self.loading.name
        finally:
            self.loading = before
            del self._files[depth - 1 :]

    def begin(self, name: str, exports: Iterable[Functor]) -> bool:
        """Have the rest of the file belong to a module; return whether it may.

        Raises:
            PrologError: where no file is being loaded.
        """
        if not self._files:
            raise permission_error("load", "module", atom(name), "module/2 is a directive of a file")
        if not self._files[-1]:
            return False
        new = name not in self.table
        module = self.table.setdefault(name, Module(name))
        module.exports = set(exports)
        module.hidden = module.exports & self._taken(module)
        for key in sorted(module.hidden, key=str):
            self._clash(module, key, "user", key)
        self.loading = module
        self.on_begin(name)
        if new:
            self.on_change()  # what has been compiled has calls of it without its names
        return True

    def bring_in(self, name: str) -> None:
        """Have the names that a module exports mean its predicates in the file that is being loaded."""
        found = self.table.get(name)
        if found is not None and self.loading is not None and found is not self.loading:
            for key in sorted(found.exports, key=str):
                target = self.own(found, key)
                if self.loading.imports.setdefault(key, target) is not target:
                    self._clash(found, key, self.loading.name, self.loading.imports[key])

    def _taken(self, module: Module) -> Set[Functor]:
        """Return the plain names that other modules have."""
        others = (other for other in self.table.values() if other is not module)
        return {key for other in others for key in other.exports - other.hidden}

    def _clash(self, module: Module, key: Functor, importer: str, there: Functor) -> None:
        before = next(
            (
                one.name
                for one in self.table.values()
                if one is not module and key in one.exports and self.own(one, key) is there
            ),
            "user",
        )
        what = f"{module.name}:{key}"
        self.on_clash(
            f"Warning: no permission to import {what} into {importer}: already imported from {before}; "
            f"{module.name}:{key.name}(...) calls it\n"
        )

    def mend(self) -> None:
        """Go back to where no file is being loaded."""
        self.loading = None
        self.shared.clear()
        self._files.clear()

    def named(self, term: Term) -> Optional[Module]:
        """Return the module that a term names, None where there is no such."""
        term = deref(term)
        return self.table.get(term.name) if isinstance(term, Atom) else None

    # Names

    def plain_of(self, key: Functor) -> Optional[Functor]:
        """Return the plain name of a predicate of a module; None for other predicates."""
        name = self._plain.get(key.name)
        return None if name is None else functor(name, key.arity)

    def shown(self, key: Functor) -> Optional[Term]:
        """Return the indicator of a predicate of a module, as ``m:(p/1)``; None for other predicates."""
        name = self._plain.get(key.name)
        if name is None:
            return None
        return (COLON, atom(key.name[: -len(name) - 1]), (SLASH, atom(name), key.arity))

    def _is_plain(self, module: Module, key: Functor) -> bool:
        if key in module.exports and key not in module.hidden:
            return True
        return key in _EVERYBODYS or key in self.shared or key.name in self._plain

    def own(self, module: Module, key: Functor) -> Functor:
        """Return the functor of a predicate that a module defines."""
        if self._is_plain(module, key):
            return key
        name = f"{module.name}:{key.name}"
        self._plain[name] = key.name
        return functor(name, key.arity)

    def stored(self, module: Module, key: Functor) -> Functor:
        """Return the functor of a predicate that clauses are asserted of in a module: its own, or one it imports."""
        own = self.own(module, key)
        return module.imports[key] if key in module.imports and not self.is_there(own) else own

    def resolve(self, module: Module, key: Functor) -> Functor:
        """Return the functor of the predicate that a name means in a module."""
        if self._is_plain(module, key):
            return key
        if (key in module.imports or self.is_of_system(key)) and not self.is_there(
            functor(f"{module.name}:{key.name}", key.arity)
        ):
            return module.imports.get(key, key)
        return self.own(module, key)

    def restore(self, table: Dict[str, KeptModule]) -> None:
        """Have the modules that `kept` returned."""
        for name, (exports, imports, own, *called) in table.items():
            module = self.table.setdefault(name, Module(name))
            module.exports.update(exports)
            module.hidden = module.exports & self._taken(module)
            names = called[0] if called else [key.name for key in imports]
            module.imports.update({key: functor(one, key.arity) for key, one in zip(imports, names)})
            self._plain.update({f"{name}:{one}": one for one in own})

    def kept(self) -> Dict[str, KeptModule]:
        """Return what there is, as plain data."""
        return {
            name: (
                sorted(module.exports, key=str),
                sorted(module.imports, key=str),
                sorted(plain for whole, plain in self._plain.items() if whole == f"{name}:{plain}"),
                [module.imports[key].name for key in sorted(module.imports, key=str)],
            )
            for name, module in self.table.items()
        }

    def kinds(self, key: Functor) -> Optional[ArgumentKinds]:
        """Return what the arguments of a predicate are, None where all are plain."""
        found = self.metas.get(key)
        if found is None:
            plain = self.plain_of(key)
            if plain is not None and not self.is_there(key):
                key = plain
            found = self.metas.get(key) or METAS.get(key)
        return found


_NECK, _GRAMMAR = functor(":-", 2), functor("-->", 2)
_SINGLE_SIDED = functor("=>", 2)
_HAT, _LAMBDA = functor("^", 2), functor(">>", 2)
_CHAINS = frozenset(functor(name, 2) for name in (",", ";", "|", "->", "*->"))
_AS = functor("as", 2)
_NOTHING: FrozenSet[Var] = frozenset()


class Modules(ModuleNames):
    """The modules of a program, and what stands in their files."""

    def goal(self, goal: CompoundTerm) -> Term:
        """Return what ``Module:Goal`` calls; the goal alone where there is no such module."""
        module = self.named(goal[1])
        if module is None:
            if deref(goal[1]).__class__ is Var:
                raise instantiation_error()
            return deref(goal[2])
        inner = deref(goal[2])
        if inner.__class__ is Var:
            raise instantiation_error()
        if inner.__class__ is not tuple and inner.__class__ is not Atom:
            raise type_error("callable", inner)
        return self.body(module, inner)

    def hatted(self, goal: CompoundTerm) -> Term:
        """Return what ``Module:Goal`` calls where ``Variable^`` may stand before the goal."""
        module, inner = self.named(goal[1]), deref(goal[2])
        return (
            inner
            if module is None or inner.__class__ is Var
            else self._argument(module, "^", inner, _NOTHING)
        )

    def closure_of(self, goal: CompoundTerm, more: int) -> Term:
        """Return what ``Module:Closure`` means where so many arguments are added to it."""
        module = self.named(goal[1])
        inner = deref(goal[2])
        return inner if module is None or inner.__class__ is Var else self.closure(module, inner, more)

    def body(self, module: Module, goal: Term, held: FrozenSet[Var] = _NOTHING) -> Term:
        """Return a goal that means everywhere what it means in a module.

        Args:
            module: where it was written.
            goal: the goal.
            held: variables whose values have been given their modules already.
        """
        chain: List[Tuple[Functor, Term]] = []
        goal = deref(goal)
        while goal.__class__ is tuple and goal[0] in _CHAINS:
            chain.append((goal[0], self.body(module, goal[1], held)))
            goal = deref(goal[2])
        found = self._goal(module, goal, held)
        for key, left in reversed(chain):
            found = (key, left, found)
        return found

    def _goal(self, module: Module, goal: Term, held: FrozenSet[Var]) -> Term:
        if goal.__class__ is Var:
            return goal if goal in held else (COLON, module.mark, goal)
        if goal.__class__ is Atom:
            key = self.resolve(module, goal.functor)
            return goal if key is goal.functor else atom(key.name)
        if goal.__class__ is not tuple:
            return goal
        if goal[0] is COLON:
            other = self.named(goal[1])
            return goal if other is None else self.body(other, goal[2], held)
        key = self.resolve(module, goal[0])
        return (key, *self._arguments(module, key, goal[1:], held))

    def _arguments(
        self, module: Module, key: Functor, args: Tuple[Term, ...], held: FrozenSet[Var]
    ) -> Sequence[Term]:
        kinds = self.kinds(key)
        if kinds is None:
            return args
        return [self._argument(module, kind, arg, held) for kind, arg in zip(kinds, args)]

    def _argument(self, module: Module, kind: ArgumentKind, arg: Term, held: FrozenSet[Var]) -> Term:
        if kind is PLAIN or kind == PLAIN:
            return arg
        if isinstance(kind, int):
            return self.closure(module, arg, kind, held) if kind else self.body(module, arg, held)
        arg = deref(arg)
        if kind == "names" or kind == "named":
            return self.indicators(module, arg, self.own if kind == "names" else self.resolve)
        if arg.__class__ is Var:
            return arg if arg in held else (COLON, module.mark, arg)
        if kind == "^":
            if arg.__class__ is tuple and arg[0] is _HAT:
                return (_HAT, arg[1], self._argument(module, kind, arg[2], held))
            return self.body(module, arg, held)
        if kind == "clause":
            return self.clause(module, arg, held, self.stored)
        if kind == "match":
            return self._matched(module, arg)
        if kind == "head":
            return self._head(module, arg, self.resolve)
        return arg if arg.__class__ is tuple and arg[0] is COLON else (COLON, module.mark, arg)

    def closure(self, module: Module, goal: Term, more: int, held: FrozenSet[Var] = _NOTHING) -> Term:
        """Return what is called with more arguments, as it means the same everywhere; see `body`."""
        goal = deref(goal)
        if goal.__class__ is Var:
            return goal if goal in held else (COLON, module.mark, goal)
        if goal.__class__ is Atom:
            key = self.resolve(module, functor(goal.name, more))
            return goal if key.name == goal.name else atom(key.name)
        if goal.__class__ is not tuple:
            return goal
        if goal[0] is COLON:
            other = self.named(goal[1])
            return goal if other is None else self.closure(other, goal[2], more, held)
        if goal[0] is _LAMBDA:
            return self._lambda(module, goal, more, held)
        inner: Term = deref(goal[-1])
        if goal[0] is SLASH and inner.__class__ is tuple and inner[0] is _LAMBDA:
            return (SLASH, goal[1], self.closure(module, inner, more, held))
        whole = self.resolve(module, functor(goal[0].name, len(goal) - 1 + more))
        key = goal[0] if whole.name == goal[0].name else functor(whole.name, len(goal) - 1)
        return (key, *self._arguments(module, whole, goal[1:], held))

    def _lambda(self, module: Module, goal: CompoundTerm, more: int, held: FrozenSet[Var]) -> Term:
        parameters = deref(goal[1])
        if parameters.__class__ is tuple and parameters[0] is SLASH:
            parameters = deref(parameters[2])
        left = more - len(list_items(parameters) or ())
        body = self.closure(module, goal[2], left, held) if left > 0 else self.body(module, goal[2], held)
        return (_LAMBDA, goal[1], body)

    # Clauses

    def clause(
        self,
        module: Module,
        term: Term,
        held: FrozenSet[Var] = _NOTHING,
        name: Optional[Callable[[Module, Functor], Functor]] = None,
    ) -> Term:
        """Return a clause of a module as one of the program.

        Args:
            module: where it was written.
            term: the clause.
            held: see `body`.
            name: gives the name of its predicate; that which the module defines by default.
        """
        name = name or self.own
        term = deref(term)
        if term.__class__ is not tuple or term[0] not in (_NECK, _SINGLE_SIDED, _GRAMMAR, COLON):
            return self._head(module, term, name)
        if term[0] is _GRAMMAR:
            return (COLON, module.mark, term)
        if term[0] is COLON:
            inner, other = deref(term[2]), self.named(term[1])
            if other is not None and inner.__class__ is not Var:
                return self.clause(other, inner, held, name)
            return term
        left = deref(term[1])
        guard: Optional[Term] = None
        if term[0] is _SINGLE_SIDED and isinstance(left, tuple) and left[0] is COMMA:
            guard, left = left[2], deref(left[1])
        head = self._head(module, left, name)
        held = held | self._held(head)
        if guard is not None:
            head = (COMMA, head, self.body(module, guard, held))
        return (term[0], head, self.body(module, term[2], held))

    def _held(self, head: Term) -> FrozenSet[Var]:
        """Return the variables that are goals as arguments of a head: who calls it gives them their modules."""
        if head.__class__ is not tuple:
            return _NOTHING
        kinds = self.metas.get(head[0])
        found = [deref(arg) for kind, arg in zip(kinds or (), head[1:]) if kind != PLAIN]
        return frozenset(arg for arg in found if isinstance(arg, Var))

    def _head(self, module: Module, head: Term, name: Callable[[Module, Functor], Functor]) -> Term:
        if head.__class__ is Atom:
            key = name(module, head.functor)
            return head if key is head.functor else atom(key.name)
        if head.__class__ is not tuple:
            return head
        if head[0] is not COLON:
            return (name(module, head[0]), *head[1:])
        other = self.named(head[1])
        inner = deref(head[2])
        if other is None or inner.__class__ is Var:
            return head if inner.__class__ is Var else inner
        return self._head(other, inner, name)

    def of_another(self, term: CompoundTerm) -> Term:
        """Return a clause of no module whose head may name one."""
        head = deref(term[1])
        if head.__class__ is tuple and head[0] is COLON:
            return (term[0], self._head(EVERYBODY, head, self.own), term[2])
        return term

    def looked_for(self, term: Term) -> Term:
        """Return a clause or head that is looked for, without the module in front of it."""
        term = deref(term)
        while term.__class__ is tuple and term[0] is COLON:
            module, inner = self.named(term[1]), deref(term[2])
            if module is not None and (inner.__class__ is tuple or inner.__class__ is Atom):
                inner = self._matched(module, inner)
            term = inner
        return term

    def names_of(self, term: Term) -> Term:
        """Return what names predicates, without the modules in front of it."""
        if not self.table:
            return term
        return self.indicators(
            EVERYBODY, term, lambda module, key: key if module is EVERYBODY else self.own(module, key)
        )

    def _matched(self, module: Module, term: Term) -> Term:
        if term.__class__ is not tuple or term[0] is not _NECK:
            return self._head(module, term, self.resolve)
        head, body = deref(term[1]), deref(term[2])
        head = (COLON, module.mark, head) if head.__class__ is Var else self._head(module, head, self.resolve)
        return (_NECK, head, body if body.__class__ is Var else self.body(module, body))

    def indicators(self, module: Module, term: Term, name: Callable[[Module, Functor], Functor]) -> Term:
        """Return what names predicates of a module (indicators, heads with modes, lists of them) for everybody."""
        term = deref(term)
        if term.__class__ is not tuple:
            return term
        if term[0] in (COMMA, CONS):
            left = self.indicators(module, term[1], name)
            return (term[0], left, self.indicators(module, term[2], name))
        if term[0] is COLON:
            other = self.named(term[1])
            return deref(term[2]) if other is None else self.indicators(other, term[2], name)
        if term[0] is _AS:
            return (_AS, self.indicators(module, term[1], name), term[2])
        if term[0] is SLASH or term[0] is GRAMMAR_NAME:
            key = indicated(term)
            return term if key is None else indicator(name(module, key))
        return (name(module, term[0]), *term[1:])

    # What is shown

    def plain(self, term: Term) -> Term:
        """Return a term with the plain names of predicates of modules, and goals without the marks of `body`."""
        if not self._plain:
            return term
        try:
            return self._shown(term)
        except RecursionError:
            return term

    def _shown(self, term: Term) -> Term:
        term = deref(term)
        if isinstance(term, Atom):
            name = self._plain.get(term.name)
            return term if name is None else atom(name)
        if term.__class__ is not tuple:
            return term
        if term[0] is COLON and deref(term[2]).__class__ is Var and self.named(term[1]) is not None:
            return deref(term[2])
        return (self.plain_of(term[0]) or term[0], *[self._shown(arg) for arg in term[1:]])
