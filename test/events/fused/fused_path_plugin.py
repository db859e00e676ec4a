"""pytest plugin that switches fused paths off: ``-p events.fused.fused_path_plugin --without-fused goals sides``.

All events are then processed by the plain nodes. Tests marked ``fused`` concern the fused paths themselves.
"""

from typing import Any

from retalis.events.dispatch import discrimination_tree, dispatcher
from retalis.events.dispatch.dispatcher import Dispatcher
from retalis.events.knowledge import pending_queries
from retalis.events.network import goal_evaluation, join_node, stream_node


class OpenFilter(discrimination_tree.PushdownFilter):
    """A filter whose plan is never known, so that it passes all events."""

    __slots__ = ()
    plan = property(lambda event_filter: None, lambda event_filter, plan: None)


def plain_action(plain: Any) -> Any:
    """Return an action that calls the plain action for any event, also for an event without values."""
    return lambda term, values, *rest: plain(term, term[1:] if values is None else values, *rest)


def listening_unfused(listen: Any) -> Any:
    """Return a replacement of `Dispatcher.listen` whose actions are never called without values."""
    return lambda self, stage, pattern, action, rank=(), is_fused=False, **rest: listen(
        self, stage, pattern, action, rank, **rest
    )


PATHS = {
    "incoming": (Dispatcher, "listen", listening_unfused(Dispatcher.listen)),
    "gates": (dispatcher, "PushdownFilter", OpenFilter),
    "goals": (
        goal_evaluation,
        "compile_goal_action",
        lambda goal, inputs, rule, failed, plain, completion: plain_action(plain),
    ),
    "questions": (pending_queries, "compile_query_action", lambda *arguments: None),
    "sides": (
        join_node,
        "compile_fused_operand",
        lambda side, pair, choice, rule, plain, emit: plain_action(plain),
    ),
    "negations": (
        join_node,
        "compile_fused_negation",
        lambda negation, rule, whole, plain: plain_action(plain),
    ),
    "windows": (
        stream_node,
        "compile_fused_window",
        lambda window, limit, node, plain, *rest: plain_action(plain),
    ),
}
"""By path: owner, attribute, and the replacement that switches the path off."""


def pytest_addoption(parser: Any) -> None:
    parser.addoption("--without-fused", nargs="+", choices=[*PATHS], default=[], metavar="PATH")


def pytest_configure(config: Any) -> None:
    for path in config.getoption("--without-fused"):
        setattr(*PATHS[path])
