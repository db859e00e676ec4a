"""Errors of Prolog goals: ISO error terms carried by a Python exception."""

from typing import Optional

from ...foundation import RetalisError, TermTooLarge
from ..terms import COMMA, SLASH, Atom, Functor, Term, Var, atom, deref, functor
from .describing import CONTEXT, ERROR, describe

_TYPE_ERROR = functor("type_error", 2)
_DOMAIN_ERROR = functor("domain_error", 2)
_EXISTENCE_ERROR = functor("existence_error", 2)
_NO_ARGUMENT = functor("existence_error", 3)
_PERMISSION_ERROR = functor("permission_error", 3)
_REPRESENTATION_ERROR = functor("representation_error", 1)
_EVALUATION_ERROR = functor("evaluation_error", 1)
_RESOURCE_ERROR = functor("resource_error", 1)
_SYNTAX_ERROR = functor("syntax_error", 1)
_SYSTEM_ERROR = functor("system_error", 1)
_UNINSTANTIATION_ERROR = functor("uninstantiation_error", 1)
_QUALIFIED = functor(":", 2)
_INSTANTIATION_ERROR = atom("instantiation_error")


class PrologError(RetalisError):
    """An error of a goal, or anything else that ``throw/1`` threw.

    >>> engine = Engine()
    >>> try:
    ...     engine.call("throw(too_hot(kitchen))")
    ... except PrologError as error:
    ...     print(engine.show(error.term))
    too_hot(kitchen)

    Attributes:
        term: the ball; ISO errors are ``error(Formal, Context)``.
    """

    def __init__(self, term: Term):
        Exception.__init__(self)
        self.term = term
        self.place = None

    @property
    def message(self) -> str:  # type: ignore[override]
        """What went wrong, as text.

        >>> PrologError(atom("too_hot")).message
        'Unhandled exception: too_hot'
        """
        return describe(self.term)


class Halt(RetalisError):
    """``halt/0,1`` was called: a program inside a robot's node may not end it."""


def error(formal: Term, context: Optional[Term] = None) -> PrologError:
    """Return the exception for ``error(formal, context)``; the context is filled in later by default."""
    return PrologError((ERROR, formal, Var() if context is None else context))


def instantiation_error() -> PrologError:
    """Return the error for an argument that has to be bound and is not."""
    return error(_INSTANTIATION_ERROR)


def type_error(kind: str, culprit: Term) -> PrologError:
    """Return the error for a term of the wrong type."""
    return error((_TYPE_ERROR, atom(kind), culprit))


def domain_error(domain: str, culprit: Term, reason: Optional[str] = None) -> PrologError:
    """Return the error for a term of the right type outside the values that are allowed."""
    return error((_DOMAIN_ERROR, atom(domain), culprit), _because(reason))


def _because(reason: Optional[str]) -> Optional[Term]:
    return None if reason is None else (CONTEXT, Var(), atom(reason))


def existence_error(kind: str, culprit: Term, context: Optional[Term] = None) -> PrologError:
    """Return the error for something that is not there."""
    return error((_EXISTENCE_ERROR, atom(kind), culprit), context)


def no_argument(number: int, term: Term) -> PrologError:
    """Return the error for an argument that a compound term does not have."""
    return error((_NO_ARGUMENT, atom("argument"), number, term))


def no_matching_rule(module: str, goal: Term) -> PrologError:
    """Return the error for arguments that no clause of a predicate of single-sided rules takes."""
    return existence_error("matching_rule", (_QUALIFIED, atom(module), goal))


def permission_error(action: str, kind: str, culprit: Term, reason: Optional[str] = None) -> PrologError:
    """Return the error for something that may not be done."""
    return error((_PERMISSION_ERROR, atom(action), atom(kind), culprit), _because(reason))


def representation_error(limit: str, reason: Optional[str] = None) -> PrologError:
    """Return the error for a value that cannot be represented."""
    return error((_REPRESENTATION_ERROR, atom(limit)), _because(reason))


def evaluation_error(what: str) -> PrologError:
    """Return the error for an arithmetic function without a value."""
    return error((_EVALUATION_ERROR, atom(what)))


def resource_error(what: str, context: Optional[Term] = None, reason: Optional[str] = None) -> PrologError:
    """Return the error for a limit that was reached."""
    return error((_RESOURCE_ERROR, atom(what)), _because(reason) if context is None else context)


def syntax_error(what: str) -> PrologError:
    """Return the error for a text that does not read."""
    return error((_SYNTAX_ERROR, atom(what)))


def system_error(message: str) -> PrologError:
    """Return the error for a failure outside Prolog."""
    return error((_SYSTEM_ERROR, atom(message)))


def uninstantiation_error(culprit: Term) -> PrologError:
    """Return the error for an argument that has to be unbound and is not."""
    return error((_UNINSTANTIATION_ERROR, culprit))


def indicator(key: Functor) -> Term:
    """Return ``Name/Arity`` as a term."""
    return (SLASH, atom(key.name), key.arity)


_BODIES = {COMMA, functor(";", 2), functor("->", 2), functor("*->", 2)}


def first_called(goal: Term) -> Optional[Functor]:
    """Return the functor of a goal, in a body of its first; None where it is nothing that can be called."""
    goal = deref(goal)
    while goal.__class__ is tuple and goal[0] in _BODIES:
        goal = deref(goal[1])
    return goal[0] if goal.__class__ is tuple else goal.functor if goal.__class__ is Atom else None


def from_python(exc: BaseException) -> Optional[PrologError]:
    """Return the Prolog error that stands for a Python exception, or None where it is not to be caught."""
    if isinstance(exc, PrologError):
        return exc
    found: Optional[PrologError] = None
    if isinstance(exc, ZeroDivisionError):
        found = evaluation_error("zero_divisor")
    elif isinstance(exc, OverflowError):
        found = evaluation_error("float_overflow")
    elif isinstance(exc, MemoryError):
        found = resource_error("memory")
    elif isinstance(exc, (TermTooLarge, RecursionError)):
        found = resource_error("term_size")
    elif isinstance(exc, RetalisError) and not isinstance(exc, Halt):
        found = system_error(exc.message)
    if found is not None:
        found.__cause__ = exc
    return found
