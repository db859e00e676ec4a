"""Messages shown with slots by name, where a program has written them like that."""

from typing import Any, Callable, Collection, Dict, List, Optional, Sequence, Set

from ...foundation import RetalisError
from ..terms import CompoundTerm, Functor, Term, Var, deref, is_ground, term_key
from .atoms import atom_text
from .floats import as_integers
from .operators import Operators
from .slots import MessageSlot, NamedForm, made_in, parts_in
from .writer import write_term

Portray = Callable[[Term], Optional[str]]


DEEPEST = 50
"""How deep messages that are shown by name may lie in each other: as deep as types."""


def by_name(
    term: Term, operators: Operators, named: Collection[Var] = (), made: bool = False, **options: Any
) -> Optional[Portray]:
    """Return what gives the text of messages in a term as they were written; None where none was by name.

    Args:
        term: what is shown.
        operators: by which it is shown.
        named: variables that have names of their own: what they stand for was named.
        made: whether all of it is made, as the head of a rule.
        **options: how values are shown; see `WriteOptions`.
    """
    if operators.slots is None or not operators.slots.forms:
        return None
    shower = _NamedShower(term, operators, named, made, options)
    return shower.text if shower.forms else None


class _NamedShower:
    def __init__(
        self, term: Term, operators: Operators, named: Collection[Var], made: bool, options: Dict[str, Any]
    ):
        self.depth = 0
        self.operators = operators
        self.options = options
        self.forms: Dict[Functor, List[NamedForm]] = {}
        assert operators.slots is not None
        self.find = operators.slots.find
        known: Dict[Functor, List[NamedForm]] = {}
        for form in list(operators.slots.forms):
            known.setdefault(form.functor, []).append(form)
        for part in parts_in(term):
            if part[0] in known:
                self.forms[part[0]] = known[part[0]]
        if self.forms:
            self.open = _alone(term, named)
            whole = [term] if made else made_in(term)
            self.made: Set[int] = {id(part) for one in whole for part in parts_in(one)}

    def text(self, term: Term) -> Optional[str]:
        """Return the text of a message that was written by name; None for anything else."""
        if term.__class__ is not tuple or term[0] not in self.forms or self.depth > DEEPEST:
            return None
        slots = self.slots(term[0])
        fitting = [one for one in self.forms[term[0]] if slots and self.fits(term, one, slots)]
        if slots is None or not fitting:
            return None
        form = min(fitting, key=lambda one: (self.in_vain(term, one), len(one.named), -len(one.whole)))
        self.depth += 1
        values = [self.slot(slots[at - 1], term[at], at in form.whole) for at in form.named]
        self.depth -= 1
        return f"{atom_text(term[0].name)}{{{', '.join(values)}}}"

    def slots(self, key: Functor) -> Optional[Sequence[MessageSlot]]:
        try:
            slots = self.find(key.name)
        except RetalisError:  # no longer known: it is shown with all slots
            return None
        return slots if slots is not None and len(slots) == key.arity else None

    def in_vain(self, term: CompoundTerm, form: NamedForm) -> int:
        """Return how many slots a form names without need."""
        return sum(deref(term[at]) in self.open for at in form.named)

    def fits(self, term: CompoundTerm, form: NamedForm, slots: Sequence[MessageSlot]) -> bool:
        """Tell whether a message reads back from a form."""
        if form.made is not (id(term) in self.made):
            return False
        others = [at for at in range(1, len(term)) if at not in form.named]
        if not form.made:
            return all(deref(term[at]) in self.open for at in others)
        return all(
            is_ground(term[at]) and term_key(term[at]) == term_key(slots[at - 1].zero) for at in others
        )

    def slot(self, slot: MessageSlot, value: Term, whole: bool) -> str:
        value = as_integers(deref(value), slot.array) if whole else deref(value)
        text = self.text(value) if slot.message and not slot.array else None
        if text is None:
            text = write_term(value, self.operators, portray=self.text, priority=999, **self.options)
        elif value[0].name == slot.message:  # type: ignore[index]
            text = text[text.index("{") :]
        return f"{slot.name}: {text}"


def _alone(term: Term, named: Collection[Var]) -> Set[Var]:
    """Return the variables that stand in a term once and have no name."""
    once: Set[Var] = set()
    again: Set[Var] = set(named)
    stack: List[Any] = [term]
    while stack:
        part = deref(stack.pop())
        if part.__class__ is tuple:
            stack += part[1:]
        elif part.__class__ is Var:
            (again if part in once else once).add(part)
    return once - again
