"""What users hand to an engine to be called."""

from typing import Protocol

from ..prolog.terms import Term


class OnOutput(Protocol):
    """What `Engine.on_output` takes: called with the term, the topic and the subscription's id of each output.

    >>> def tell(term: Term, topic: str, name: Term) -> None:
    ...     print(topic, engine.show(term), engine.show(name))
    >>> engine = Engine()
    >>> engine.on_output(tell)
    >>> engine.load(goals="subscribe(bark(Dog), [], Dog, dogs, first)")
    >>> engine.event("bark(rex)", 1)
    dogs rex first
    """

    def __call__(self, term: Term, topic: str, name: Term, /) -> object:
        """Take an output."""


class OnEvent(Protocol):
    """What `Engine.on_event` takes: called with the term, and start and end in nanoseconds, of each event.

    >>> def tell(term: Term, start: int, end: int) -> None:
    ...     print(engine.show(term), start, end)
    >>> engine = Engine()
    >>> engine.on_event(tell)
    >>> engine.load(rules="walk <- left seq right.")
    >>> engine.event("left", 1)
    left 1000000000 1000000000
    >>> engine.event("right", 2)
    right 2000000000 2000000000
    walk 1000000000 2000000000
    """

    def __call__(self, term: Term, start: int, end: int, /) -> object:
        """Take an event."""
