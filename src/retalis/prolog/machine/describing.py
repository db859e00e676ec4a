"""Text of error terms, for logs and exceptions."""

from ...foundation import LONGEST, beginning
from ..syntax import beginning_of
from ..terms import COLON, SLASH, Atom, String, Term, Var, deref, functor

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
    return beginning(text, LONGEST)


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
    return beginning(term.name, LONGEST) if term.__class__ is Atom else _shown(term)


def _shown(term: Term) -> str:
    return beginning_of(term, LONGEST)


def _context(context: Term) -> str:
    if context.__class__ is Var:
        return ""
    if context.__class__ is tuple and context[0] is CONTEXT:
        where, message = deref(context[1]), deref(context[2])
        text = "" if where.__class__ is Var else f" (in {_shown(where)})"
        if message.__class__ is Atom:
            text += f": {beginning(message.name, LONGEST)}"
        elif message.__class__ is String:
            text += f": {beginning(message.text, LONGEST)}"
        elif message.__class__ is not Var:
            text += f": {_shown(message)}"
        return text
    if context.__class__ is tuple and context[0] in (SLASH, COLON):
        return f" (in {_shown(context)})"
    return f": {_shown(context)}"
