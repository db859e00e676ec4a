"""What a load that fails or is interrupted has done so far is taken back."""

from pathlib import Path
from typing import Set

from .owners import Loaded


class Beginning:
    """What there was before a load, of what costs little to note."""

    def __init__(self, rules: Loaded, loaded: Set[Path]):
        self._rules = rules
        self._loaded = loaded
        self._serial = rules.serial
        self._properties = rules.all_properties()

    def restore(self) -> None:
        """Take back what has come since."""
        rules = self._rules
        for rule in list(rules.rules):
            if rule.serial > self._serial:
                rules.remove(rule)
        rules.restore_properties(self._properties)
        rules.files.loaded = self._loaded


class Snapshot:
    """What the program was before a file was loaded: clauses, rules, properties and operators."""

    def __init__(self, rules: Loaded):
        self._rules = rules
        self._active = set(rules.rules)
        found = list(rules.logic.database.predicates.values())
        self._library = [predicate for predicate in found if predicate.library]
        self._clauses = {predicate: set(predicate.live()) for predicate in found if predicate.kind == "user"}
        self._properties = rules.all_properties()
        self._operators = rules.logic.operators.copy()

    def restore(self) -> None:
        """Take back what has come since."""
        rules = self._rules
        rules.logic.operators.become(self._operators)
        for rule in list(rules.rules):
            if rule not in self._active:
                rules.remove(rule)
        for predicate in self._library:
            rules.logic.database.give_back(predicate)
        for predicate in list(rules.logic.database.predicates.values()):
            if predicate.kind == "user":
                kept = self._clauses.get(predicate, ())
                for clause in list(predicate.live()):
                    if clause not in kept:
                        predicate.remove(clause)
                if not predicate.clauses and predicate not in self._clauses and not predicate.dynamic:
                    predicate.kind = "undefined"
        rules.restore_properties(self._properties)
