"""An item of a sliding window, served by one function: numbers that come in order, in a group that is there.

The plain way is `Sliding.take` with `WindowGroup` and the measures. The function generated here does the same to the
same groups and items; everything else goes the plain way before anything has changed.
"""

from heapq import heappush
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence

from ...foundation.codegen import Block, Statement, shared_function, source_of, tuple_source
from ...prolog.terms.term_traversal import PLAIN, term_key
from ...prolog.terms.types import EventAction
from ..streams.stream_elements import StreamElement

_PLAIN_WAY = "return plain(term, values, start, end, after)"
_STEPS = 2
"""Steps of pattern work that the plain way counts for an item, without those of the event that is derived."""


class FusedWindow(NamedTuple):
    """A window over the values of matches.

    Attributes:
        span: of the window, in ns.
        groups: where those values are that say to which group an item belongs.
        kinds: the kinds of its measures.
        values: where that is what each of them measures; None for one that takes no value.
    """

    span: int
    groups: Sequence[int]
    kinds: Sequence[str]
    values: Sequence[Optional[int]]


class _MeasureSource(NamedTuple):
    """The source of one measure of a window; ``x`` with its number is the value of the new item.

    Attributes:
        check: tests the value; leaves unusual ones to the plain way.
        add: adds the value of ``item`` to the measure of ``group``.
        remove: removes the value of ``old`` from the measure of the group ``left``.
        result: the expression of the result for ``number`` items.
    """

    check: Sequence[Statement]
    add: Sequence[Statement]
    remove: Sequence[Statement]
    result: str


def _count(at: int, place: int) -> _MeasureSource:
    return _MeasureSource([], [], [], "number")


def _sum(at: int, place: int) -> _MeasureSource:
    x, total, scaled = f"x{at}", f"s{at}", f"y{at}"
    return _MeasureSource(
        [
            f"{total} = group.measures[{at}].sum",
            Block(
                f"if {x}.__class__ is float:",
                [
                    f"{scaled} = {x} * {total}.factor",
                    Block(f"if not {scaled}.is_integer():", [_PLAIN_WAY]),
                    f"{scaled} = {scaled}.__trunc__()",
                ],
            ),
            Block(f"elif {x}.__class__ is int:", [f"{scaled} = {x} << {total}.scale"]),
            Block("else:", [_PLAIN_WAY]),
        ],
        [f"{total}.total += {scaled}", Block(f"if {x}.__class__ is float:", [f"{total}.floats += 1"])],
        [
            f"value = old.values[{place}]",
            f"total = left.measures[{at}].sum",
            Block(
                "if value.__class__ is float and (scaled := value * total.factor).is_integer():",
                ["total.total -= scaled.__trunc__()", "total.floats -= 1"],
            ),
            Block("else:", ["total.change(value, -1)"]),
        ],
        f"{total}.over(1)",
    )


def _mean(at: int, place: int) -> _MeasureSource:
    total = f"s{at}"
    exact = f"{total}.total / (number << {total}.scale)"
    return _sum(at, place)._replace(result=f"{exact} if {total}.floats else {total}.over(number)")


def _lowest(at: int, place: int, sign: str = "") -> _MeasureSource:
    x, heap = f"x{at}", f"lowest{at}"
    return _MeasureSource(
        [Block(f"if {x}.__class__ is not float and {x}.__class__ is not int or {x} != {x}:", [_PLAIN_WAY])],
        [
            f"{heap} = group.measures[{at}].lowest",
            f"{heap}.live += 1",
            f"heappush({heap}.heap, ({sign}{x}, order, item))",
        ],
        [f"left.measures[{at}].lowest.remove()"],
        f"{heap}.top()[2].values[{place}]",
    )


def _highest(at: int, place: int) -> _MeasureSource:
    return _lowest(at, place, "-")


_MEASURES: Dict[str, Callable[[int, int], _MeasureSource]] = {
    "count": _count,
    "sum": _sum,
    "avg": _mean,
    "min": _lowest,
    "max": _highest,
}


def has_fused_measures(kinds: Sequence[str]) -> bool:
    """Return whether all measures can be fused."""
    return all(kind in _MEASURES for kind in kinds)


def fused_window(
    window: FusedWindow,
    limit: Optional[int],
    node: Any,
    plain: EventAction,
    complete: EventAction,
    too_large: Callable[[Any, Any], Any],
) -> EventAction:
    """Return the action that adds the values of an event to a sliding window.

    Args:
        window: the window.
        limit: the longest interval of an output, in ns; None for no bound.
        node: has the `Sliding` as ``stream``, and the rule's network, which says how many items it may hold.
        plain: the plain way.
        complete: takes the values of groups and the results.
        too_large: reports a group whose results are too large for a float.
    """
    names: Dict[str, Any] = {
        "node": node,
        "network": node.rule.network,
        "span": window.span,
        "limit": limit,
        "plain": plain,
        "complete": complete,
        "too_large": too_large,
        "new": object.__new__,
        "StreamItem": StreamElement,
        "PLAIN": PLAIN,
        "term_key": term_key,
        "heappush": heappush,
        "OverflowError": OverflowError,
    }
    metered = node.rule.meter is not None
    if metered:
        names["pattern_steps"] = node.rule.network.logic.machine.budget.pattern_steps
    made: EventAction = shared_function(_source(window, limit is not None, metered), names, "window")
    return made


def _source(window: FusedWindow, limited: bool, metered: bool) -> str:
    """Return the source: it has nothing of the program in it but numbers and places of groups and measures."""
    read = [f"x{at} = values[{place}]" for at, place in enumerate(window.values) if place is not None]
    taken = [f"x{at}" for at, place in enumerate(window.values) if place is not None]
    measures = []
    for at, kind in enumerate(window.kinds):
        place = sum(one is not None for one in window.values[:at])  # in the values of an item
        measures.append(_MEASURES[kind](at, place))
    results = [*(f"k{at}" for at in range(len(window.groups))), *(one.result for one in measures)]
    body: List[Statement] = [
        "stream = node.stream",
        "queue = stream.queue",
        *_key(window.groups),
        *read,
        "groups = stream.states",
        "group = groups.get(key)",
        Block(f"if {_UNCOMMON}:", [_PLAIN_WAY]),
        *([Block(f"if pattern_steps[0] < {_STEPS}:", [_PLAIN_WAY])] if metered else []),
        *(statement for one in measures for statement in one.check),
        *([f"pattern_steps[0] -= {_STEPS}"] if metered else []),
        "stream.clock = end",
        "before = end - span",
        Block(
            "while queue and queue[0].start <= before:",
            [
                "old = queue.popleft()",
                Block("if old.gone:", ["continue"]),
                "left = groups[old.key]",
                Block("if left.starts is not None:", ["stream.remove(old)", "continue"]),
                "old.gone = True",
                "left.members.popleft()",
                "left.number = number = left.number - 1",
                "stream.number -= 1",
                *(statement for one in measures for statement in one.remove),
                Block("if not number:", ["del groups[old.key]"]),
            ],
        ),
        "item = new(StreamItem)",
        "item.match = None",
        "item.start = start",
        "item.end = end",
        "item.by = last.by",
        "item.key = key",
        f"item.values = {tuple_source(taken)}",
        "item.order = stream.last_order = order = stream.last_order + 1",
        "item.gone = False",
        Block("if group.number:", ["groups.move_to_end(key)"]),
        Block("else:", ["groups[key] = group"]),
        "group.number = number = group.number + 1",
        "stream.number += 1",
        "members = group.members",
        "members.append(item)",
        *(statement for one in measures for statement in one.add),
        "queue.append(item)",
        Block("try:", [f"found = {tuple_source(results)}"]),
        Block("except OverflowError:", ["return too_large(group, after)"]),
        *([Block("if end - members[0].start > limit:", ["return after"])] if limited else []),
        "return complete(None, found, members[0].start, end, after)",
    ]
    return source_of([Block("def made(term, values, start, end, after):", body)])


_UNCOMMON = " or ".join(
    [
        "group is None",
        "group.starts is not None",
        "stream.disordered",
        "not stream.clock <= end <= stream.newest_allowed",
        "(start is not end and end - start >= span)",
        "start < queue[-1].start",
        "end < (last := group.members[-1]).end",
        "stream.number >= network.cap",
    ]
)


def _key(groups: Sequence[int]) -> List[Statement]:
    """Return the statements that take the key of a group from values at some places."""
    keys = ["key"] if len(groups) == 1 else [f"key{at}" for at in range(len(groups))]
    found: List[Statement] = []
    for at, (key, place) in enumerate(zip(keys, groups)):
        found += [
            f"k{at} = {key} = values[{place}]",
            Block(f"if k{at}.__class__ not in PLAIN:", [f"{key} = term_key(k{at})"]),
        ]
    return found if len(keys) == 1 else [*found, f"key = {tuple_source(keys)}"]
