"""Text of error terms, for logs and exceptions.

Errors of Prolog goals: ISO error terms carried by a Python exception.
"""

from typing import Optional

from ...foundation.errors import MAX_MESSAGE_CHARACTERS, RetalisError, TermTooLarge, beginning
from ..syntax.term_writer import beginning_of
from ..terms.types import COLON, COMMA, SLASH, Atom, Functor, String, Term, Var, atom, deref, functor

ERROR = functor("error", 2)
CONTEXT = functor("context", 2)


def describe(ball: Term) -> str:
    """Return an error term as one sentence in English."""
    ball = deref(ball)
    if ball.__class__ is not tuple or ball[0] is not ERROR:
        return f"Unhandled exception: {_shown(ball)}"
    text = _formal(deref(ball[1]))
    # An unknown procedure is where its error comes from: that is said already.
    text += _context(deref(ball[2])).replace(f" (in {text[len(_UNKNOWN) :]})", "", text.startswith(_UNKNOWN))
    return beginning(text, MAX_MESSAGE_CHARACTERS)


_UNKNOWN = "Unknown procedure: "


def _formal(formal: Term) -> str:
    if formal.__class__ is Atom:
        if formal.name == "instantiation_error":
            return "Arguments are not sufficiently instantiated"
        return formal.name
    if formal.__class__ is not tuple:
        return f"Unknown error: {_shown(formal)}"
    name, args = formal[0].name, [deref(arg) for arg in formal[1:]]
    if name == "existence_error" and _name(args[0]) == "procedure":
        return f"{_UNKNOWN}{_shown(args[1])}"
    if name == "existence_error" and _name(args[0]) == "source_sink":
        return f"cannot read {_name(args[1])}: No such file or directory"
    if name == "system_error":
        return _name(args[0])  # a sentence
    template = _TEMPLATES.get(name)
    if template is None or template.count("{}") != len(args):
        return f"Unknown error: {_shown(formal)}"
    return template.format(*[_name(arg) for arg in args[:-1]], _shown(args[-1]))


_TEMPLATES = {
    "type_error": "Type error: `{}' expected, found `{}'",
    "domain_error": "Domain error: `{}' expected, found `{}'",
    "existence_error": "Unknown {}: {}",
    "permission_error": "No permission to {} {} `{}'",
    "representation_error": "Cannot represent due to `{}'",
    "evaluation_error": "Arithmetic: evaluation error: {}",
    "resource_error": "Not enough resources: {}",
    "syntax_error": "Syntax error: {}",
    "assertion_error": "Assertion failed ({}): {}",
    "format": "Format error: {}",
    "uninstantiation_error": "Cannot unify `{}': it has to be unbound",
}


def _name(term: Term) -> str:
    return beginning(term.name, MAX_MESSAGE_CHARACTERS) if term.__class__ is Atom else _shown(term)


def _shown(term: Term) -> str:
    return beginning_of(term, MAX_MESSAGE_CHARACTERS)


def _context(context: Term) -> str:
    if context.__class__ is Var:
        return ""
    if context.__class__ is tuple and context[0] is CONTEXT:
        where, message = deref(context[1]), deref(context[2])
        text = "" if where.__class__ is Var else f" (in {_shown(where)})"
        if message.__class__ is Atom:
            text += f": {beginning(message.name, MAX_MESSAGE_CHARACTERS)}"
        elif message.__class__ is String:
            text += f": {beginning(message.text, MAX_MESSAGE_CHARACTERS)}"
        elif message.__class__ is not Var:
            text += f": {_shown(message)}"
        return text
    if context.__class__ is tuple and context[0] in (SLASH, COLON):
        return f" (in {_shown(context)})"
    return f": {_shown(context)}"


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
