"""Modules: clauses and goals of their files, rewritten when they are added so that they mean the same everywhere.

Running them costs nothing then. What only is a goal at run time, as a variable in ``call/1``, is marked with its
module, and rewritten when it is called.
"""

from typing import Callable, FrozenSet, List, Optional, Sequence, Tuple

from ..machine import indicator, instantiation_error, type_error
from ..terms import (
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
    list_items,
)
from .metas import PLAIN, ArgumentKind
from .modulenames import EVERYBODY, GRAMMAR_NAME, Module, ModuleNames, indicated

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
