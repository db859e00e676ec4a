"""Labels of rules and their properties, and the names of rules.

A label names a rule and sets its properties: ``L : R`` or ``L([property(Name, Value), ...]) : R``. A rule without a
label has its event as name: `rule_name`. Users meet rules as `rule_title`: by name and place.
"""

from math import inf
from typing import Any, Callable, Dict, NamedTuple, Optional, Tuple

from ...foundation.displayed_text import shorten
from ...foundation.errors import RuleError
from ...foundation.similar_names import did_you_mean
from ...prolog.terms.list_terms import list_items
from ...prolog.terms.types import COLON, Atom, CompoundTerm, Term, Var, atom, deref, functor
from .event_operators import ARROWS, OPERATOR_NAMES
from .pattern_parser import PlaceLookup
from .rule_heads import event_raised_by

RULE = functor("rule:", 2)
_NULL_EVENTS = (atom("null"), atom("null_event"))
_PROPERTY = functor("property", 2)
WORD_PROPERTIES: Dict[str, Tuple[str, ...]] = {
    "policy": ("recent", "recent_2", "chronological", "chronological_2", "unrestricted"),
    "out_of_order": ("off", "on"),
    "after_match": ("keep", "skip_past_last", "skip_to_next"),
}
"""Properties whose value is one of several words. If a property is set twice, the last value holds."""

WATERMARK_DELAY = "watermark_delay"
"""Name of the property, and of the flag, whose value is ``auto`` or a number of seconds."""

PROPERTY_READINGS: Dict[str, str] = {
    "event_rule_window": "a match takes at most V seconds",
    "window": "a match takes at most V seconds",
    "window_step": "old partial matches are removed every V seconds",
    "ttl": "partial matches and keys are dropped after V seconds without an event",
    WATERMARK_DELAY: "deadlines and windows wait V seconds for late events",
    "policy": "the consumption policy is V",
    "out_of_order": "waiting for late first events is V",
    "after_match": "after a match: V",
}
"""Words of the properties in readings of rules, with their value V."""

ZERO_READINGS: Dict[str, str] = {"ttl": "partial matches and keys are never dropped for their age"}
"""Words of properties with the value 0, if they differ."""

KNOWN_PROPERTIES = ("event_rule_window", "window", "window_step", "ttl", WATERMARK_DELAY, *WORD_PROPERTIES)
MAX_NAME_CHARACTERS = 60
"""Maximum length of the name of a rule; the rest is omitted."""

_LABEL_FORM = "a label is an atom, or Label([property(Name, Value), ...])"


class Property(NamedTuple):
    """Property of a label."""

    label: Term
    name: str
    value: Term

    @property
    def is_known(self) -> bool:
        """True if a property with this name exists."""
        return self.name in KNOWN_PROPERTIES

    @property
    def numeric_value(self) -> float:
        """The value of a valid numeric property."""
        value = self.value
        assert isinstance(value, (int, float))
        return value

    @property
    def word_value(self) -> Optional[str]:
        """The value of a valid property of `WORD_PROPERTIES`; None for a number."""
        return self.value.name if self.name in WORD_PROPERTIES and isinstance(self.value, Atom) else None

    @property
    def error_text(self) -> Optional[str]:
        """Error in the property, or None."""
        if not self.is_known:
            names = ", ".join(KNOWN_PROPERTIES)
            hint = did_you_mean(self.name, KNOWN_PROPERTIES)
            return f"there is no property {self.name}; the properties are {names}{hint}"
        words = WORD_PROPERTIES.get(self.name)
        if words is not None:
            value = self.value.name if isinstance(self.value, Atom) else ""
            return (
                None
                if value in words
                else f"property {self.name} is {_join_alternatives(words)}{did_you_mean(value, words)}"
            )
        if self.name == WATERMARK_DELAY and isinstance(self.value, Atom):
            is_auto = self.value.name == "auto"
            return None if is_auto else f"property {self.name} is auto or a number of seconds, 0 or more"
        if self.value.__class__ not in (int, float) or not 0 <= self.value < inf:
            return f"property {self.name} needs a number of seconds, 0 or more"
        return None


def _join_alternatives(words: Tuple[str, ...]) -> str:
    return f"{', '.join(words[:-1])} or {words[-1]}"


def is_rule(term: Term) -> bool:
    """Return whether a term is an event rule, with or without a label."""
    if term.__class__ is not tuple:
        return False
    if term[0] is RULE or term[0] is COLON:
        label, unlabelled = split_label(term)
        return label is not None and is_unlabelled_rule(unlabelled)
    return is_unlabelled_rule(term)


def is_unlabelled_rule(term: Term) -> bool:
    """Return whether a term is an event rule without a label."""
    return term.__class__ is tuple and (term[0] in ARROWS or OPERATOR_NAMES.get(term[0]) == "do")


def split_label(term: CompoundTerm) -> Tuple[Optional[Term], Term]:
    """Return label and rule; the label is None if it is missing or malformed."""
    if term[0] is not RULE and term[0] is not COLON:
        return None, term
    label = deref(term[1])
    if label.__class__ is tuple:
        items = list_items(label[1]) if len(label) == 2 else None
        if items is None or not all(_is_property(deref(item)) for item in items):
            return None, term
    elif label.__class__ is not Atom:
        return None, term
    return label, deref(term[2])


def label_error(term: CompoundTerm, place_of: PlaceLookup) -> Optional[RuleError]:
    """Return the error in the label of a rule, or None."""
    if not is_unlabelled_rule(deref(term[2])) or split_label(term)[0] is not None:
        return None
    label = deref(term[1])
    # A variable is a plausible mistake: a label in upper case.
    if label.__class__ is Var:
        return RuleError(f"{_LABEL_FORM}, not a variable", place_of(term, 1))
    if label.__class__ is tuple and len(label) == 2:
        for item in list_items(label[1]) or ():
            part = deref(item)
            if not _is_property(part):
                place = place_of(part) if part.__class__ is tuple else place_of(label)
                return RuleError(f"expected {_guess_property(part)}; {_LABEL_FORM}", place)
    return RuleError(_LABEL_FORM, place_of(term, 1))


def _guess_property(part: Term) -> str:
    """Return the property that was probably intended by an invalid item in the list of a label."""
    name: Any = None
    value: Any = None
    if part.__class__ is tuple and len(part) == 2:
        name, value = part[0].name, deref(part[1])
    # The infix forms that other configuration languages use.
    elif part.__class__ is tuple and len(part) == 3:  # window = 3, window-3
        name, value = getattr(deref(part[1]), "name", None), deref(part[2])
    if name in WORD_PROPERTIES and value.__class__ is Atom:
        value = value.name
    elif name not in KNOWN_PROPERTIES or value.__class__ not in (int, float):
        return "property(Name, Value)"
    return f"property({name}, {value})"


def _is_property(term: Term) -> bool:
    return term.__class__ is tuple and term[0] is _PROPERTY and deref(term[1]).__class__ is Atom


def rule_name(label: Optional[Term], head: Optional[Term], rule: Term, show: Callable[[Term], str]) -> str:
    """Return the name of a rule: its label, or else its event, as ``overheated(Room)``.

    A rule whose event is not used has the name of its goal: ``do g(X)`` for ``P do g(X)`` and ``null do g(X) <- P``.

    Args:
        label: the label, with or without properties; None for a rule without a label.
        head: the head, without its ``do`` goal; None for ``P do G``.
        rule: the rule without its label.
        show: returns the text of a term.

    Returns:
        The name, shortened to `MAX_NAME_CHARACTERS`.
    """
    name: Any = deref(label) if label is not None else None
    if name is not None:
        return shorten(show(atom(name[0].name) if name.__class__ is tuple else name), MAX_NAME_CHARACTERS)
    event: Any = event_raised_by(head)
    # The part ``H do G`` or ``P do G``, if there is one.
    action: Any = rule if event is None or rule.__class__ is not tuple else deref(rule[1])
    has_action = action.__class__ is tuple and OPERATOR_NAMES.get(action[0]) == "do"
    if has_action and (event is None or event in _NULL_EVENTS):
        return shorten(f"do {show(deref(action[2]))}", MAX_NAME_CHARACTERS)
    return "any event" if event.__class__ is Var else shorten(show(event), MAX_NAME_CHARACTERS)


def rule_title(name: str, line: str) -> str:
    """Return the name of a rule with its line, ``hot (rules.txt:3)``, by which a user finds the rule.

    Args:
        name: the name, see `rule_name`.
        line: file and line, see `line_of`; "" for a rule that was added at run time.
    """
    return f"{name} ({line or 'added at run time'})"
