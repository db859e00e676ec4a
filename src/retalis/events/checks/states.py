"""States that are asked for and not declared."""

from typing import Iterator

from ...foundation import RuleError
from ..language import asked_state
from .near import NearFunctors
from .overview import Overview


def unknown_states(program: Overview) -> Iterator[RuleError]:
    """Yield the states that goals ask for and nothing declares."""
    known = [one.form.functor for one in program.states]
    nearby = NearFunctors()
    for inner in program.called():
        key = asked_state(inner.term)
        if key is None or key in known or not program.logic.is_of_system(inner.term[0]):
            continue
        nearest = nearby.of(key, known)
        hint = (
            f"; did you mean {nearest}?" if nearest else ": state(S, from(Event), until(Event)) declares one"
        )
        yield RuleError(f"there is no state {key}{hint}", inner.place)
