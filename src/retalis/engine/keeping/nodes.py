"""Checks of what nodes of rules and shapes of subscriptions know, against the program that they belong to."""

from typing import Any, Callable, List, Optional, Sequence, Tuple

from ...events.matches import Match, Run
from ...events.network import Joining, Never, Repeating, Rule, RuleState, Running, Streaming
from ...events.streams import (
    Awaiting,
    Changing,
    FromFirst,
    Hopping,
    Settled,
    Spaced,
    SteppedWindow,
    StreamItem,
    StreamOperator,
)
from ...foundation import UsageError
from .graph import GraphReader
from .schema import (
    Decoded,
    ValueCheck,
    anything,
    boolean,
    count,
    each,
    fixed,
    instant,
    integer,
    items,
    key,
    named,
    nothing,
    optional,
    record,
    term,
    text,
    wrong,
)

_NEVER = -(1 << 63)


class StreamCheck:
    """Checks what an operator on a stream knows.

    Args:
        graph: has the items.
        stream: an operator that was made for the same part of a program.
        widths: how many values an item has by which it is grouped, and how many that are looked at.
        of_terms: whether items are made of terms (those of a subscription), not of matches.
        needs: whether each item has a match.
    """

    def __init__(
        self,
        graph: GraphReader,
        stream: StreamOperator,
        widths: Tuple[int, int],
        of_terms: bool = False,
        needs: bool = False,
    ):
        self._refer = graph.ref("item")
        self._stream = stream
        self._widths = widths
        self._of_terms = of_terms
        self._needs = needs
        make: Callable[[], Sequence[Any]] = getattr(stream, "make", lambda: ())
        scopes = getattr(stream, "scopes", None)
        self._checks = [one.check for one in make() if one.picky] if scopes is None else []

    def item(self, value: Decoded) -> StreamItem:
        """Check an item."""
        item: StreamItem = self._refer(value)
        by, values = self._widths
        if len(item.by) != by or len(item.values) != values:
            raise wrong((item.by, item.values), f"an item with {by} and {values} values")
        of_match = isinstance(item.match, Match)
        if item.match is None:
            right = not self._needs
        else:
            right = not of_match if self._of_terms else of_match
        if not right or item.start > item.end:
            raise wrong(item.match, "an item of another kind")
        if not self._of_terms and any(one is None for one in item.values):
            raise wrong(item.values, "values")
        for check in self._checks:
            check(item)
        item.file()
        return item

    def _once(self, found: Sequence[StreamItem], order: int) -> None:
        """Check that items are there once each, with orders of their own."""
        orders = {item.order for item in found}
        if len(orders) != len(found) or not all(1 <= one <= order for one in orders):
            raise wrong(sorted(item.order for item in found), "items with orders of their own")

    def known(self, value: Decoded) -> Decoded:
        """Check all that the operator knows; see `StreamOperator.kept`."""
        stream = self._stream
        one = each(self.item)
        if isinstance(stream, SteppedWindow):
            return self._stepped(stream, value)
        if isinstance(stream, Spaced):
            return fixed(instant, one)(value)
        if isinstance(stream, Changing):
            found = fixed(each(instant), one)(value)
            if len(found[0]) != len(found[1]):
                raise wrong(len(found[0]), f"{len(found[1])} instants")
            return found
        if isinstance(stream, Settled):
            found = fixed(count, instant, one)(value)
            self._once(found[2], found[0])
            return found
        if isinstance(stream, Awaiting):
            found = fixed(count, instant, one, one)(value)
            self._once([*found[2], *found[3]], found[0])
            return found
        further: List[ValueCheck] = [instant] if isinstance(stream, (FromFirst, Hopping)) else []
        ahead: List[ValueCheck] = [one] if isinstance(stream, Hopping) else []
        group = fixed(instant, one)
        found = fixed(instant, optional(instant), count, count, each(group), *further, *ahead)(value)
        self._groups([members for _, members in found[4]], sum((list(f) for f in found[6:]), []), found[3])
        return found

    def _groups(self, groups: List[List[StreamItem]], ahead: List[StreamItem], order: int) -> None:
        self._once([item for members in groups for item in members] + ahead, order)
        keys = [{item.key for item in members} for members in groups]
        if any(len(one) != 1 for one in keys) or len(set().union(*keys)) != len(keys):
            raise wrong(len(keys), "groups of items with the same values, and one of them each")

    def _stepped(self, stream: SteppedWindow, value: Decoded) -> Decoded:
        step = integer(0, len(stream.plan.steps) - 1)
        steps = each(step, tuple)
        pairs = each(fixed(count, step), tuple)
        way = fixed(
            integer(-1, len(stream.plan.steps) - 1),
            count,
            optional(steps),
            each(optional(count), tuple),
            pairs,
            count,
        )
        group = fixed(instant, each(self.item), each(way, tuple), each(pairs, tuple))
        found = fixed(count, count, instant, each(group))(value)
        self._groups([one[1] for one in found[3]], [], found[1])
        for _, members, ways, whole in found[3]:
            known = [item.order for item in members]
            named_ones = [order for one in ways for order in one[3] if order is not None]
            taken = [order for one in ways for order, _ in one[4]] + [
                order for one in whole for order, _ in one
            ]
            after = [one[5] for one in ways]
            if (
                not ways
                or not all(whole)
                or known != sorted(known)
                or not {*named_ones, *taken} <= set(known)
                or any(len(one[3]) != len(stream.plan.marks) for one in ways)
                or any(bool(one[4]) != (one[0] >= 0) for one in ways)
                or any(one[2] is not None and not one[2] for one in ways)
                or any(list(one[4]) != sorted(one[4], key=lambda pair: pair[0]) for one in ways)
                or after != sorted(after)
                or len(whole) != after[-1] - after[0]
            ):
                raise wrong(ways, "ways through the steps")
        return found


def rule_state(graph: GraphReader, rule: Rule, value: Decoded) -> RuleState:
    """Check what a rule knows; see `Rule.state`."""
    nodes = [node for node, _, _ in rule.nodes]
    kinds = each(fixed(text, anything))(items(value)[2]) if len(items(value)) == 7 else []
    if [kind for kind, _ in kinds] != [type(node).__name__ for node in nodes]:
        raise UsageError(f"{rule.name}: it is made of other parts than it was")
    known = [(kind, named(kind, _node_check(graph, node))(kept)) for node, (kind, kept) in zip(nodes, kinds)]
    found = [(node, width) for node, (_, kept) in zip(nodes, known) for width in _widths(node, kept)]
    owners, widths = [node for node, _ in found], [width for _, width in found]
    place = integer(0, len(widths) - 1)
    state: RuleState = record(
        RuleState,
        counts=fixed(count, optional(instant), count, count, count, count, count),
        times=fixed(instant, count, optional(instant)),
        nodes=lambda _: known,
        arrivals=each(fixed(graph.match, integer(-1, len(widths) - 1), count)),
        later=each(fixed(place, graph.match)),
        later_event=graph.token,
        skipped=optional(fixed(instant, each(instant, tuple))),
    )(value)
    _check_waiting(rule, state, owners, widths)
    return state


def _check_waiting(
    rule: Rule, state: RuleState, owners: List[Any], widths: List[Tuple[type, Optional[int]]]
) -> None:
    """Check that what waits fits the buffers where it waits."""
    orders = [order for _, _, order in state.arrivals]
    if len({id(match) for match, _, _ in state.arrivals}) != len(orders) or len(set(orders)) != len(orders):
        raise UsageError(f"{rule.name}: something waits twice")
    if any(order > state.times[1] for order in orders):
        raise UsageError(f"{rule.name}: something waits that has not come")
    waiting = [(match, place) for match, place, _ in state.arrivals]
    for match, place in (*waiting, *((match, place) for place, match in state.later)):
        if place < 0:
            if match.buffer is None:
                raise UsageError(f"{rule.name}: a sequence waits that goes on nowhere")
            continue
        kind, width = widths[place]
        if (
            match.__class__ is not kind
            or (width is not None and min(len(match.filed_by), len(match.values)) < width)
            or match.start > match.end
            or (kind is Run and not _is_run_of(owners[place], match))
        ):
            raise wrong(match.values, f"{rule.name}: a match with {width} values at least")


def _is_run_of(node: Running, run: Any) -> bool:
    """Tell whether a run has what a node of repetitions or of an aggregate gives one."""
    return (
        (run.fixed is None or len(run.fixed) == len(node.fixed))
        and len(run.open) == len(node.open_vars)
        and len(run.taken) == len(run.steps)
        and run.sound <= len(run.taken)
        and (run.state is None if node.collector is None else node.collector.is_state(run.state))
    )


def _widths(node: Any, kept: Any) -> List[Tuple[type, Optional[int]]]:
    """Return of each buffer of a node of which class what waits there is, and how many values it has."""
    number = node.number_of_buffers(kept) if isinstance(node, Repeating) else len(node.buffers())
    found: List[Tuple[type, Optional[int]]] = [(Match, None)] * number
    if isinstance(node, Joining):
        known = [node.left, node.right, *node.negated]
    elif isinstance(node, Running):
        known = [node.first, node.repeated]
    elif isinstance(node, Never):
        known = [node.negated]
    else:
        known = []
    carried = any(absence.carried for absence in getattr(node, "absences", ()))
    for at, below in enumerate(known[: 2 if carried else None]):
        kind = Run if isinstance(node, Running) and not at else Match
        found[at] = (kind, len(below.vars))
    return found


def _node_check(graph: GraphReader, node: Any) -> ValueCheck:
    """Return a check of what a node itself knows; see `NetworkNode.kept`."""
    if isinstance(node, Joining):
        return fixed(each(graph.token_key), each(graph.match))
    if isinstance(node, Running):
        return each(graph.match)
    if isinstance(node, Repeating):
        return _repeating(graph, node)
    if isinstance(node, Streaming):
        return _streaming(graph, node)
    return nothing


def _repeating(graph: GraphReader, node: Repeating) -> ValueCheck:
    number = integer(1, node.times)
    train = graph.ref("train")

    def own(value: Decoded) -> Decoded:
        found = train(value)
        tokens = [token for token in found.tokens if token is not None and token.buffer is found]
        if found.node is not node or len(found.tokens) >= node.times:
            raise wrong(value, "sequences of this node")
        if not tokens or any(len(token.values) != len(node.child.vars) for token in tokens):
            raise wrong(value, "sequences with values")
        return found

    return fixed(boolean, each(number), each(own), each(fixed(key, each(number))))


def _streaming(graph: GraphReader, node: Streaming) -> ValueCheck:
    child = node.children[0]
    by, values = node.making.item((1,) * len(child.vars))
    needs = node.making.result is None and not isinstance(node.stream, (Spaced, Changing))
    stream = StreamCheck(graph, node.stream, (len(by), len(values)), False, needs)
    channel = integer(0, len(node.children) - 1)
    taken = fixed(channel, stream.item, instant)
    output = fixed(each(stream.item), instant, instant, each(term, tuple), nothing)
    given = fixed(lambda value: output(value) if items(value) else None, graph.ref("held"))

    def base(value: Decoded) -> Decoded:
        return stream.known(value) if items(value) else ()

    replay = fixed(base, each(taken), each(given))
    return fixed(stream.known, count, optional(replay))
