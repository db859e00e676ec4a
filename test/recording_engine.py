"""An engine for tests that records its events and outputs."""

from typing import Any, List, Optional

from retalis import Engine, Reports, Settings


class RecordingEngine(Engine):
    """An engine with a program, whose events and outputs are recorded as text.

    Attributes:
        events: Tuples of an event's text, its start and its end in ns.
        outputs: Tuples of an output's text, its topic and the text of the subscription's name.
    """

    def __init__(
        self,
        rules: str = "",
        goals: str = "",
        clock: Any = None,
        reports: Optional[Reports] = None,
        **settings: Any,
    ) -> None:
        super().__init__(clock, Settings(**settings), reports)
        self.outputs: List[Any] = []
        self.events: List[Any] = []
        self.on_output(
            lambda term, topic, name: self.outputs.append((self.show(term), topic, self.show(name)))
        )
        self.on_event(lambda term, start, end: self.events.append((self.show(term), int(start), int(end))))
        self.load(rules=rules, goals=goals)

    @property
    def event_texts(self) -> List[Any]:
        """The texts of the events alone."""
        return [text for text, _, _ in self.events]
