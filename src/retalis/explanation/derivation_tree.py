"""Why-provenance of events: trees of the rules and events that an event was derived from."""

from typing import Dict, List, Optional, Sequence, Set

from ..events.knowledge.event_states import StateRegistry
from ..events.network.lineage_graph import Occurrence
from .explanation_lines import ExplanationLine, ExplanationTexts

MAX_DEPTH = 50
"""Maximum length of a chain of derived events that is shown."""


class DerivationTrees:
    """Derivation trees of the occurrences of one explanation; each occurrence is expanded once.

    Args:
        occurrences: the recorded events.
        states: the declared states of the program, whose ends are events without a rule.
        texts: formats events and rules.
    """

    def __init__(self, occurrences: Sequence[Occurrence], states: StateRegistry, texts: ExplanationTexts):
        self._occurrences = occurrences
        self._states = states
        self._texts = texts
        self._expanded_ids: Set[int] = set()
        """Ids of the occurrences whose causes have been shown."""
        self._causes_by_id: Optional[Dict[int, List[Occurrence]]] = None

    def explain(self, occurrence: Occurrence, depth: int = 0) -> ExplanationLine:
        """Return the derivation tree of an occurrence.

        A subtree that was shown before is replaced by "see above", one that is too deep by "...".
        """
        text = self._texts.format_event(occurrence)
        if occurrence.retracts is not None:
            retracted = [
                ExplanationLine(self._texts.format_event(event), []) for event in occurrence.retracts
            ]
            return ExplanationLine(f"{text} retracts", retracted)
        causes = occurrence.sources() or self._causes_of(occurrence)
        if occurrence.match is None and not causes:
            return ExplanationLine(f"{text} {self._describe_missing_causes(occurrence)}", [])
        if depth > MAX_DEPTH:
            return ExplanationLine(f"{text} ...", [])
        # Shared causes would make the tree grow exponentially, so each occurrence is expanded once.
        if id(occurrence) in self._expanded_ids:
            return ExplanationLine(f"{text}, see above", [])
        self._expanded_ids.add(id(occurrence))
        below = [self.explain(cause, depth + 1) for cause in causes]
        return ExplanationLine(f"{text} {self._describe_derivation(occurrence)}", below)

    def _causes_of(self, occurrence: Occurrence) -> List[Occurrence]:
        """Return the occurrences from which an occurrence without a match was derived."""
        if self._causes_by_id is None:
            # Occurrences only refer to what they were derived into, so the opposite direction is built once.
            self._causes_by_id = {}
            for cause in self._occurrences:
                for derived in cause.derived:
                    if derived.match is None:
                        self._causes_by_id.setdefault(id(derived), []).append(cause)
        return self._causes_by_id.get(id(occurrence), [])

    def _describe_missing_causes(self, occurrence: Occurrence) -> str:
        if occurrence.rule is None:
            return "came from outside"
        return f"by {self._texts.format_rule(occurrence.rule)}: what it came from is no longer recorded"

    def _describe_derivation(self, occurrence: Occurrence) -> str:
        if occurrence.rule is not None:
            return f"by {self._texts.format_rule(occurrence.rule)}"
        is_state = bool(self._states.declarations_with_functor_of(occurrence.term))
        return "has ended; it began and ended with" if is_state else "was released by"
