"""The rules that take events, in order, and found by label and by what they say."""

from typing import Dict, Hashable, Iterator, List

from ...prolog.terms import Term, atom, term_key
from ..network import Rule

_UNLABELED = atom("unlabeled")

_Groups = Dict[Hashable, Dict[Rule, None]]


class RuleTable:
    """The rules of a program, the oldest first."""

    def __init__(self) -> None:
        self._all: Dict[Rule, None] = {}
        self._by_label: _Groups = {}
        self._by_key: _Groups = {}

    def __iter__(self) -> Iterator[Rule]:
        return iter(self._all)

    def add(self, rule: Rule) -> None:
        """Take a rule in, after all others."""
        self._all[rule] = None
        self._file(rule)

    def take_out(self, rule: Rule) -> bool:
        """Take a rule out; returns whether it was there."""
        if self._all.pop(rule, 0) is not None:
            return False
        _take_out(self._by_label, term_key(label_of(rule)), rule)
        _take_out(self._by_key, rule.definition.key, rule)
        return True

    def labelled(self, label: Term) -> List[Rule]:
        """Return the rules that have a label."""
        return list(self._by_label.get(term_key(label), ()))

    def alike(self, key: Hashable) -> List[Rule]:
        """Return the rules that say the same, see `RuleDefinition.key`."""
        return list(self._by_key.get(key, ()))

    def mend(self) -> None:
        """Put right what an interrupt may have left half done: a rule is found in every way, or in none."""
        self._by_label, self._by_key = {}, {}
        for rule in self._all:
            self._file(rule)

    def _file(self, rule: Rule) -> None:
        self._by_label.setdefault(term_key(label_of(rule)), {})[rule] = None
        self._by_key.setdefault(rule.definition.key, {})[rule] = None


def label_of(rule: Rule) -> Term:
    """Return the label of a rule."""
    return _UNLABELED if rule.label is None else rule.label


def _take_out(groups: _Groups, key: Hashable, rule: Rule) -> None:
    """Take a rule out from among those of a key."""
    del groups[key][rule]
    if not groups[key]:
        del groups[key]
