"""Prolog errors: ISO error terms carried by a Python exception, and their text.

`PrologError` carries any thrown term (the *ball*); ISO errors have the form ``error(Formal, Context)`` (ISO 13211-1,
7.12). One function for each kind of formal term creates the exception. `from_python` converts Python exceptions that
a program may catch, and `describe` writes a ball as a sentence, with the wording of SWI-Prolog where it has one.

Texts are cut off at `MAX_MESSAGE_CHARACTERS`: an error can contain a term of any size, and writing all of it could
take longer than the goal that failed.
"""

from typing import Optional

from ...foundation.displayed_text import shorten
from ...foundation.errors import MAX_MESSAGE_CHARACTERS, RetalisError, TermTooLarge
from ..syntax.term_writer import truncated_text
from ..terms.types import COLON, COMMA, SLASH, Atom, Functor, String, Term, Var, atom, deref, functor

ERROR = functor("error", 2)
CONTEXT = functor("context", 2)


def describe(ball: Term) -> str:
    """Return a ball as one English sentence."""
    ball = deref(ball)
    if ball.__class__ is not tuple or ball[0] is not ERROR:
        return f"Unhandled exception: {_term_text(ball)}"
    text = _formal_text(deref(ball[1]))
    context_text = _context_text(deref(ball[2]))
    # The context of an unknown procedure is usually the procedure itself, which the text names already.
    if text.startswith(_UNKNOWN_PROCEDURE):
        context_text = context_text.replace(f" (in {text[len(_UNKNOWN_PROCEDURE) :]})", "", 1)
    return shorten(text + context_text, MAX_MESSAGE_CHARACTERS)


_UNKNOWN_PROCEDURE = "Unknown procedure: "
"""Beginning of the text for a missing procedure."""


def _formal_text(formal: Term) -> str:
    """Return the text of a formal term."""
    if formal.__class__ is Atom:
        if formal.name == "instantiation_error":
            return "Arguments are not sufficiently instantiated"
        return formal.name
    if formal.__class__ is not tuple:
        return f"Unknown error: {_term_text(formal)}"
    name, args = formal[0].name, [deref(arg) for arg in formal[1:]]
    if name == "existence_error" and _name_text(args[0]) == "procedure":
        return f"{_UNKNOWN_PROCEDURE}{_term_text(args[1])}"
    if name == "existence_error" and _name_text(args[0]) == "source_sink":
        return f"cannot read {_name_text(args[1])}: No such file or directory"
    if name == "system_error":
        # The argument is a sentence.
        return _name_text(args[0])
    template = _TEMPLATES.get(name)
    # A program can throw a formal term of its own, or an ISO one with another number of arguments.
    if template is None or template.count("{}") != len(args):
        return f"Unknown error: {_term_text(formal)}"
    return template.format(*[_name_text(arg) for arg in args[:-1]], _term_text(args[-1]))


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
"""Texts of ISO errors by the functor of the formal term; all arguments but the last one are names."""


def _name_text(term: Term) -> str:
    """Return the name of an atom without quotes, and the text of any other term."""
    return shorten(term.name, MAX_MESSAGE_CHARACTERS) if term.__class__ is Atom else _term_text(term)


def _term_text(term: Term) -> str:
    return truncated_text(term, MAX_MESSAGE_CHARACTERS)


def _context_text(context: Term) -> str:
    """Return the text of an error's context: the predicate and the reason, as far as they are known."""
    if context.__class__ is Var:
        return ""
    if context.__class__ is tuple and context[0] is CONTEXT:
        place, message = deref(context[1]), deref(context[2])
        text = "" if place.__class__ is Var else f" (in {_term_text(place)})"
        if message.__class__ is Atom:
            text += f": {shorten(message.name, MAX_MESSAGE_CHARACTERS)}"
        elif message.__class__ is String:
            text += f": {shorten(message.text, MAX_MESSAGE_CHARACTERS)}"
        elif message.__class__ is not Var:
            text += f": {_term_text(message)}"
        return text
    if context.__class__ is tuple and context[0] in (SLASH, COLON):
        return f" (in {_term_text(context)})"
    return f": {_term_text(context)}"


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
    """An error of a goal, or any other term that ``throw/1`` threw.

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
        """The text of the error.

        >>> PrologError(atom("too_hot")).message
        'Unhandled exception: too_hot'
        """
        return describe(self.term)


class Halt(RetalisError):
    """Raised by ``halt/0,1``: a program cannot end the ROS node that runs it."""


def error(formal: Term, context: Optional[Term] = None) -> PrologError:
    """Return the exception for ``error(formal, context)``; the machine adds the context if it is None."""
    return PrologError((ERROR, formal, Var() if context is None else context))


def instantiation_error(reason: Optional[str] = None) -> PrologError:
    """Return the error for an unbound argument that must be bound."""
    return error(_INSTANTIATION_ERROR, _reason_context(reason))


def type_error(type_name: str, culprit: Term, reason: Optional[str] = None) -> PrologError:
    """Return the error for a term of the wrong type."""
    return error((_TYPE_ERROR, atom(type_name), culprit), _reason_context(reason))


def instantiation_or_type_error(type_name: str, culprit: Term, reason: Optional[str] = None) -> PrologError:
    """Return the error for an argument that does not have a type: an instantiation error if it is unbound."""
    return instantiation_error() if culprit.__class__ is Var else type_error(type_name, culprit, reason)


def domain_error(domain: str, culprit: Term, reason: Optional[str] = None) -> PrologError:
    """Return the error for a term of the right type whose value is not allowed."""
    return error((_DOMAIN_ERROR, atom(domain), culprit), _reason_context(reason))


def _reason_context(reason: Optional[str]) -> Optional[Term]:
    """Return the context of an error with a reason; the machine adds the predicate."""
    return None if reason is None else (CONTEXT, Var(), atom(reason))


def existence_error(
    object_type: str, culprit: Term, context: Optional[Term] = None, reason: Optional[str] = None
) -> PrologError:
    """Return the error for an object that does not exist; a reason is used instead of a context."""
    formal = (_EXISTENCE_ERROR, atom(object_type), culprit)
    return error(formal, _reason_context(reason) if reason else context)


def no_argument(number: int, term: Term) -> PrologError:
    """Return the error for an argument number that a compound term does not have."""
    return error((_NO_ARGUMENT, atom("argument"), number, term))


def no_matching_rule(module: str, goal: Term) -> PrologError:
    """Return the error for a goal that matches no single-sided rule (``=>``) of its predicate."""
    return existence_error("matching_rule", (_QUALIFIED, atom(module), goal))


def permission_error(
    action: str, object_type: str, culprit: Term, reason: Optional[str] = None
) -> PrologError:
    """Return the error for an operation that is not allowed."""
    return error((_PERMISSION_ERROR, atom(action), atom(object_type), culprit), _reason_context(reason))


def representation_error(limit: str, reason: Optional[str] = None) -> PrologError:
    """Return the error for a value that cannot be represented."""
    return error((_REPRESENTATION_ERROR, atom(limit)), _reason_context(reason))


def evaluation_error(reason: str) -> PrologError:
    """Return the error for an arithmetic function without a result."""
    return error((_EVALUATION_ERROR, atom(reason)))


def resource_error(resource: str, reason: Optional[str] = None) -> PrologError:
    """Return the error for a limit that has been reached."""
    return error((_RESOURCE_ERROR, atom(resource)), _reason_context(reason))


def syntax_error(message: str) -> PrologError:
    """Return the error for invalid syntax."""
    return error((_SYNTAX_ERROR, atom(message)))


def system_error(message: str) -> PrologError:
    """Return the error for a failure outside Prolog."""
    return error((_SYSTEM_ERROR, atom(message)))


def uninstantiation_error(culprit: Term) -> PrologError:
    """Return the error for a bound argument that must be unbound."""
    return error((_UNINSTANTIATION_ERROR, culprit))


def indicator(key: Functor) -> Term:
    """Return ``Name/Arity`` as a term."""
    return (SLASH, atom(key.name), key.arity)


_FIRST_GOAL_CONSTRUCTS = {COMMA, functor(";", 2), functor("->", 2), functor("*->", 2)}
"""Control constructs whose first goal runs first."""


def first_goal_functor(goal: Term) -> Optional[Functor]:
    """Return the functor of the goal that a body calls first, or None if the term is not callable."""
    goal = deref(goal)
    while goal.__class__ is tuple and goal[0] in _FIRST_GOAL_CONSTRUCTS:
        goal = deref(goal[1])
    return goal[0] if goal.__class__ is tuple else goal.functor if goal.__class__ is Atom else None


def from_python(exc: BaseException) -> Optional[PrologError]:
    """Return the Prolog error for a Python exception, or None if programs must not catch it."""
    if isinstance(exc, PrologError):
        return exc
    error: Optional[PrologError] = None
    if isinstance(exc, ZeroDivisionError):
        error = evaluation_error("zero_divisor")
    elif isinstance(exc, OverflowError):
        error = evaluation_error("float_overflow")
    elif isinstance(exc, MemoryError):
        error = resource_error("memory")
    elif isinstance(exc, (TermTooLarge, RecursionError)):
        error = resource_error("term_size")
    # `Halt` must reach the host, so no program may catch it. Other exceptions are defects of built-ins.
    elif isinstance(exc, RetalisError) and not isinstance(exc, Halt):
        error = system_error(exc.message)
    if error is not None:
        error.__cause__ = exc
    return error
