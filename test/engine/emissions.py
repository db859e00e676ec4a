"""Events and outputs of an engine as text, to compare an engine with the one that is restored from its snapshot."""

from typing import Any, List, Tuple

from retalis import Engine
from retalis.prolog.terms.term_traversal import variables


def show(engine: Engine, term: Any) -> str:
    """Return the text of a term, with names for variables, whose numbers differ between engines."""
    names = {var: f"V{number}" for number, var in enumerate(variables(term))}
    return engine.logic.show(term, names=names)


def record_emissions(engine: Engine) -> List[Tuple[Any, ...]]:
    """Return a list to which the events and outputs of an engine are added from now on.

    An event is the tuple of its text, its start and its end in ns; an output that of ``"out"``, its text, its topic
    and the text of the subscription's name.
    """
    emissions: List[Tuple[Any, ...]] = []
    engine.on_event(lambda term, start, end: emissions.append((show(engine, term), int(start), int(end))))
    engine.on_output(
        lambda term, topic, name: emissions.append(("out", show(engine, term), topic, show(engine, name)))
    )
    return emissions
