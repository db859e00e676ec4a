"""Explanations of outputs: the event for which a subscription published an output, or why there was none.

An output is a term that a subscription has created from its template. Its reason is therefore the explanation of the
event that the subscription selects, with the values of the output.
"""

from typing import Any, Iterator, List, NamedTuple, Optional

from ..engine.engine import Engine
from ..events.language.stream_parser import subscription_event
from ..events.network.lineage_graph import Occurrence
from ..foundation.ros_name_checks import strip_slashes
from ..prolog.terms.term_traversal import copy, is_ground
from ..prolog.terms.types import Term, Var, deref
from ..prolog.terms.unification import may_unify, unify
from .event_explanations import event_request, explain_briefly

MAX_EXPLAINED_SUBSCRIPTIONS = 2
"""Maximum number of subscriptions in the explanation of an output."""


class ExplainedOutput(NamedTuple):
    """An output that was published, or that was expected.

    Attributes:
        topic: its topic; None for any.
        term: its term, with variables for parts of any value; None for any.
        time: its time in nanoseconds since the epoch; None if it is unknown.
    """

    topic: Optional[str]
    term: Optional[Term]
    time: Optional[int]


class _SelectedEvent(NamedTuple):
    """Event of a subscription, as request of an explanation.

    Attributes:
        text: the subscription, and the pattern that it selects with the values of the output.
        request: the event nearest to the time of the output, with its interval; the pattern if there is none.
    """

    text: str
    request: Term


def explain_output_briefly(engine: Engine, output: ExplainedOutput, origin: int) -> List[str]:
    """Return the first lines of the explanation of an output, for a report.

    Args:
        engine: engine that has run with the recording of lineage (`record_origins`).
        output: the output.
        origin: time to which the times in the lines are relative, in nanoseconds since the epoch.
    """
    # Executed between events: the recorded events do not change meanwhile.
    selected_events = engine.do(lambda: list(_find_selected_events(engine, output)))
    lines = []
    for selected in selected_events[:MAX_EXPLAINED_SUBSCRIPTIONS]:
        lines.append(selected.text)
        lines += [f"  {line}" for line in explain_briefly(engine, selected.request, origin)]
    if lines:
        return lines
    topic = "" if output.topic is None else f" of topic {output.topic}"
    return [f"no subscription{topic} publishes such a term"]


def _find_selected_events(engine: Engine, output: ExplainedOutput) -> Iterator[_SelectedEvent]:
    """Yield the event of each subscription that can publish an output."""
    program = engine.program
    occurrences = program.rules.network.tracker.remembered_events()
    for (topic, _), subscription in program.knowledge.subscriptions.items():
        if output.topic is not None and strip_slashes(topic) != strip_slashes(output.topic):
            continue
        # A copy, whose variables are bound to the values of the output.
        definition: Any = copy(subscription.definition)
        _, pattern, _, template, *_ = definition
        event = subscription_event(pattern)
        # Without a template, the event itself is published.
        published = event if deref(template).__class__ is Var else template
        if output.term is not None and not unify(published, copy(output.term), []):
            continue
        candidates = [occurrence for occurrence in occurrences if may_unify(occurrence.term, event)]
        request, note = copy(event), ""
        if candidates:
            nearest = min(candidates, key=lambda event: _distance(event, output.time))
            request = event_request(nearest.term, nearest.start, nearest.end)
            # An output is published at the end of its event, or later if its rate is limited.
            if output.time is not None and nearest.end != output.time:
                note = ", which ended at another time" if is_ground(event) else "; the nearest event is"
        name = program.logic.brief(subscription.id)
        text = f"subscription {name} of topic {topic} publishes it for {program.logic.brief(event)}{note}"
        yield _SelectedEvent(text, request)


def _distance(event: Occurrence, time: Optional[int]) -> int:
    """Return the time between the end of an event and an output; the first event is the nearest without time."""
    return 0 if time is None else abs(event.end - time)
