"""Labels of rules and their properties: ``L : R`` and ``L([property(Name, Value), ...]) : R``."""

from math import isfinite
from typing import Any, Dict, NamedTuple, Optional, Tuple

from ...foundation import RuleError
from ...prolog.terms import COLON, Atom, CompoundTerm, Term, Var, deref, functor, list_items
from .meant import near
from .operators import ARROWS, SPELLINGS
from .reading import Spot

RULE = functor("rule:", 2)
_PROPERTY = functor("property", 2)
WORDS: Dict[str, Tuple[str, ...]] = {
    "policy": ("recent", "recent_2", "chronological", "chronological_2", "unrestricted"),
    "out_of_order": ("off", "on"),
    "after_match": ("keep", "skip_past_last", "skip_to_next"),
}
"""The properties whose values are words, with these; of those of one name, what was said last holds."""
KNOWN_PROPERTIES = ("event_rule_window", "window", "window_step", "ttl", *WORDS)
_FORMS = "a label is an atom, or Label([property(Name, Value), ...])"


class Property(NamedTuple):
    """A property of a label."""

    label: Term
    name: str
    value: Term

    @property
    def known(self) -> bool:
        """Whether there is such a property."""
        return self.name in KNOWN_PROPERTIES

    @property
    def number(self) -> float:
        """Its value, where that is a number and no problem."""
        value = self.value
        assert isinstance(value, (int, float))
        return value

    @property
    def word(self) -> Optional[str]:
        """Its value, where that is a word and no problem; None for a number."""
        return self.value.name if self.name in WORDS and isinstance(self.value, Atom) else None

    @property
    def problem(self) -> Optional[str]:
        """What is wrong with it, or None."""
        if not self.known:
            known = ", ".join(KNOWN_PROPERTIES)
            return f"there is no property {self.name}; the properties are {known}{near(self.name, KNOWN_PROPERTIES)}"
        words = WORDS.get(self.name)
        if words is not None:
            said = self.value.name if isinstance(self.value, Atom) else ""
            return None if said in words else f"property {self.name} is {_one_of(words)}{near(said, words)}"
        if self.value.__class__ not in (int, float) or not (self.value >= 0 and isfinite(self.value)):
            return f"property {self.name} needs a number of seconds, 0 or more"
        return None


def _one_of(words: Tuple[str, ...]) -> str:
    return f"{', '.join(words[:-1])} or {words[-1]}"


def is_rule(term: Term) -> bool:
    """Tell whether a term is an event rule, labelled or not."""
    if term.__class__ is not tuple:
        return False
    if term[0] is RULE or term[0] is COLON:
        label, rule = labelled(term)
        return label is not None and is_plain_rule(rule)
    return is_plain_rule(term)


def is_plain_rule(term: Term) -> bool:
    """Tell whether a term is an event rule without a label."""
    return term.__class__ is tuple and (term[0] in ARROWS or SPELLINGS.get(term[0]) == "do")


def labelled(term: CompoundTerm) -> Tuple[Optional[Term], Term]:
    """Return label and rule; the label is None where there is none or it is malformed."""
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


def label_error(term: CompoundTerm, spot: Spot) -> Optional[RuleError]:
    """Return what is wrong with the label of a rule; None for what is none."""
    if not is_plain_rule(deref(term[2])) or labelled(term)[0] is not None:
        return None
    label = deref(term[1])
    if label.__class__ is Var:
        return RuleError(f"{_FORMS}, not a variable", spot(term, 1))
    if label.__class__ is tuple and len(label) == 2:
        for item in list_items(label[1]) or ():
            part = deref(item)
            if not _is_property(part):
                at = spot(part) if part.__class__ is tuple else spot(label)
                return RuleError(f"expected {_property_meant(part)}; {_FORMS}", at)
    return RuleError(_FORMS, spot(term, 1))


def _property_meant(part: Term) -> str:
    """Return the property that something in the list of a label was probably meant as."""
    name: Any = None
    value: Any = None
    if part.__class__ is tuple and len(part) == 2:
        name, value = part[0].name, deref(part[1])
    elif part.__class__ is tuple and len(part) == 3:  # window = 3, window-3
        name, value = getattr(deref(part[1]), "name", None), deref(part[2])
    if name in WORDS and value.__class__ is Atom:
        value = value.name
    elif name not in KNOWN_PROPERTIES or value.__class__ not in (int, float):
        return "property(Name, Value)"
    return f"property({name}, {value})"


def _is_property(term: Term) -> bool:
    return term.__class__ is tuple and term[0] is _PROPERTY and deref(term[1]).__class__ is Atom
