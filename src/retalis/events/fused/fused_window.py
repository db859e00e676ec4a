"""Fused sliding windows: one generated function that adds a match to a time window and emits the results.

The general path is `SlidingTimeWindow.process` with a `KeyedWindow` and its accumulators. The function generated here
does the same to the same objects if elements arrive in order, their key has a window already, and all measured values
are plain numbers. All other cases (`_NEEDS_GENERAL_PATH`, and the checks of the measures) call the general
path before anything has changed.
"""

from heapq import heappush
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence

from ...foundation.codegen import Block, Statement, shared_function, source_of, tuple_source
from ...prolog.terms.term_traversal import SELF_KEYED, term_key
from ...prolog.terms.types import EventAction
from ..streams.running_statistics import LazyMinHeap
from ..streams.stream_operators import StreamElement
from ..streams.windows import KeyedWindow

_GENERAL_PATH = "return general_path(term, values, start, end, frame)"
_METERED_STEPS = 2
"""Pattern work that the general path counts per element, without that of the derived event."""

_NO_WINDOW = KeyedWindow(())
_NO_WINDOW.starts = LazyMinHeap()
"""Replacement for the window of a key without elements: one with heaps, for which `_NEEDS_GENERAL_PATH` is true."""


class FusedWindow(NamedTuple):
    """Window over the values of matches.

    Attributes:
        span: length of the window in ns.
        value_positions: position of the value of each measure; None for a measure without one.
    """

    span: int
    key_positions: Sequence[int]
    measure_names: Sequence[str]
    value_positions: Sequence[Optional[int]]


class _MeasureSource(NamedTuple):
    """Source of one measure; ``x`` with its number is the value of the new element.

    Attributes:
        check: tests the value; unusual values use the general path.
        add: adds the value of ``element`` to the accumulator of ``keyed_window``.
        remove: removes the value of ``old`` from the accumulator of ``old_window``.
        result: expression for the result of ``element_count`` elements.
        keeps_elements: whether the accumulator refers to elements, also to some that were removed.
    """

    check: Sequence[Statement]
    add: Sequence[Statement]
    remove: Sequence[Statement]
    result: str
    keeps_elements: bool = False


def _count_source(number: int, position: int) -> _MeasureSource:
    return _MeasureSource([], [], [], "element_count")


def _sum_source(number: int, position: int) -> _MeasureSource:
    x, total, scaled, is_integer = f"x{number}", f"s{number}", f"y{number}", f"i{number}"
    return _MeasureSource(
        [
            f"{total} = keyed_window.measures[{number}].sum",
            Block(
                f"if {x}.__class__ is float:",
                [
                    # See `ExactSum.factor`: the product is exact if it is an integer. Otherwise the scale must grow
                    # first, which is left to `ExactSum.add_multiple`.
                    f"{scaled} = {x} * {total}.factor",
                    Block(f"if not {scaled}.is_integer():", [_GENERAL_PATH]),
                    f"{scaled} = {scaled}.__trunc__()",
                    f"{is_integer} = False",
                ],
            ),
            Block(
                f"elif {x}.__class__ is int:", [f"{scaled} = {x} << {total}.scale", f"{is_integer} = True"]
            ),
            Block("else:", [_GENERAL_PATH]),
        ],
        [f"{total}.total += {scaled}", Block(f"if {is_integer}:", [f"{total}.integer_count += 1"])],
        [
            f"value = old.values[{position}]",
            f"total = old_window.measures[{number}].sum",
            Block(
                "if value.__class__ is float and (scaled := value * total.factor).is_integer():",
                ["total.total -= scaled.__trunc__()"],
            ),
            Block("else:", ["total.add_multiple(value, -1)"]),
        ],
        f"{total}.quotient(1, element_count)",
    )


def _mean_source(number: int, position: int) -> _MeasureSource:
    total = f"s{number}"
    # `ExactSum.quotient` without the call, for floats only, whose average is a float in any case.
    return _sum_source(number, position)._replace(
        result=(
            f"{total}.quotient(element_count, element_count) if {total}.integer_count "
            f"else {total}.total / (element_count << {total}.scale)"
        )
    )


def _min_source(number: int, position: int, sign: str = "") -> _MeasureSource:
    x, heap = f"x{number}", f"heap{number}"
    return _MeasureSource(
        [
            Block(
                f"if {x}.__class__ is not float and {x}.__class__ is not int or {x} != {x}:", [_GENERAL_PATH]
            )
        ],
        [
            f"{heap} = keyed_window.measures[{number}].heap",
            f"{heap}.count += 1",
            f"heappush({heap}.entries, ({sign}{x}, order, element))",
        ],
        [f"old_window.measures[{number}].heap.remove()"],
        f"{heap}.top()[2].values[{position}]",
        keeps_elements=True,
    )


def _max_source(number: int, position: int) -> _MeasureSource:
    return _min_source(number, position, "-")


_MEASURE_SOURCES: Dict[str, Callable[[int, int], _MeasureSource]] = {
    "count": _count_source,
    "sum": _sum_source,
    "avg": _mean_source,
    "min": _min_source,
    "max": _max_source,
}


def has_fused_measures(measure_names: Sequence[str]) -> bool:
    """Return whether all measures can be fused."""
    return all(name in _MEASURE_SOURCES for name in measure_names)


def compile_fused_window(
    window: FusedWindow,
    max_span: Optional[int],
    node: Any,
    general_path: EventAction,
    complete: EventAction,
    on_overflow: Callable[[Any, Any], Any],
    values_are_arguments: bool,
) -> EventAction:
    """Return the action that adds the values of an event to a sliding window.

    Args:
        window: the window.
        max_span: maximum interval of an output in ns; None for no limit.
        node: the stream node: its ``stream`` is the `SlidingTimeWindow`, its network limits the number of elements.
        general_path: the general path.
        complete: receives the values of the key and the results.
        on_overflow: reports a window whose results exceed the range of floats.
        values_are_arguments: whether the values are the arguments of the event, so that the action accepts None for
            them.
    """
    names: Dict[str, Any] = {
        "node": node,
        "network": node.rule.network,
        "span": window.span,
        "limit": max_span,
        "general_path": general_path,
        "complete": complete,
        "on_overflow": on_overflow,
        "new": object.__new__,
        "StreamElement": StreamElement,
        "SELF_KEYED": SELF_KEYED,
        "term_key": term_key,
        "heappush": heappush,
        "KeyError": KeyError,
        "NO_WINDOW": _NO_WINDOW,
        "OverflowError": OverflowError,
    }
    is_metered = node.rule.meter is not None
    if is_metered:
        names["pattern_steps"] = node.rule.network.logic.machine.budget.pattern_steps
    source = _window_source(window, values_are_arguments, max_span is not None, is_metered)
    action: EventAction = shared_function(source, names, "window")
    return action


def _window_source(window: FusedWindow, values_are_arguments: bool, has_limit: bool, is_metered: bool) -> str:
    """Return the source; of the program, it contains only numbers and indices."""
    measures = []
    for number, measure_name in enumerate(window.measure_names):
        # `StreamElement.values` contains the values of those measures that have one.
        position = sum(index is not None for index in window.value_positions[:number])
        measures.append(_MEASURE_SOURCES[measure_name](number, position))
    results = [
        *(f"k{number}" for number in range(len(window.key_positions))),
        *(measure.result for measure in measures),
    ]
    body: List[Statement] = [
        *_value_statements(window, values_are_arguments),
        "stream = node.stream",
        "queue = stream.queue",
        "keyed_windows = stream.states",
        Block("try:", ["keyed_window = keyed_windows[key]"]),
        # The general path must not run in the handler: errors of listeners would be logged with this one.
        Block("except KeyError:", ["keyed_window = NO_WINDOW"]),
        Block(f"if {_NEEDS_GENERAL_PATH}:", [_GENERAL_PATH]),
        *([Block(f"if pattern_steps[0] < {_METERED_STEPS}:", [_GENERAL_PATH])] if is_metered else []),
        *(statement for measure in measures for statement in measure.check),
        *([f"pattern_steps[0] -= {_METERED_STEPS}"] if is_metered else []),
        # All checks are done: from here on nothing calls the general path.
        "stream.clock = end",
        "elements = keyed_window.elements",
        "key_values = elements[-1].key_values",
        "min_start = end - span",
        "element = None",
        Block(
            "while queue and queue[0].start <= min_start:",
            [
                "old = queue.popleft()",
                Block("if old.is_removed:", ["continue"]),
                "old_window = keyed_windows[old.key]",
                # A window with elements out of order has heaps; removing from them is rare and left to the general
                # method.
                Block("if old_window.starts is not None:", ["stream.remove(old)", "continue"]),
                "old_window.elements.popleft()",
                *(statement for measure in measures for statement in measure.remove),
                Block("if not old_window.elements:", ["del keyed_windows[old.key]"]),
                *_release_statements(measures),
            ],
        ),
        Block(
            "if element is None:",
            [
                "element = new(StreamElement)",
                "element.is_removed = False",
                "stream.element_count += 1",
            ],
        ),
        # A reused element has a match if it entered while events were tracked.
        "element.match = None",
        "element.start = start",
        "element.end = end",
        "element.key_values = key_values",
        "element.key = key",
        f"element.values = {tuple_source(_value_names(window))}",
        "element.order = stream.last_order = order = stream.last_order + 1",
        Block("if elements:", ["keyed_windows.move_to_end(key)"]),
        Block("else:", ["keyed_windows[key] = keyed_window"]),
        "elements.append(element)",
        # The element is complete before results are computed, which may raise an error.
        "queue.append(element)",
        "element_count = len(elements)",
        *(statement for measure in measures for statement in measure.add),
        Block("try:", [f"results = {tuple_source(results)}"]),
        Block("except OverflowError:", ["return on_overflow(keyed_window, frame)"]),
        *([Block("if end - elements[0].start > limit:", ["return frame"])] if has_limit else []),
        "return complete(None, results, elements[0].start, end, frame)",
    ]
    source = source_of([Block("def generated(term, values, start, end, frame):", body)])
    # The general path expects the values also if they are the arguments of the event.
    return (
        source.replace(_GENERAL_PATH, _GENERAL_PATH.replace("values", "term[1:]"))
        if values_are_arguments
        else source
    )


_NEEDS_GENERAL_PATH = " or ".join(
    [
        # A window without elements out of order contains no removed elements, so its deque has the element count.
        "keyed_window.starts is not None",
        "stream.out_of_order",
        # All elements of the queue started by the clock, so this one is the newest if it is an instant.
        "not stream.clock <= end <= stream.max_timestamp",
        "(start is not end and (end - start >= span or start < queue[-1].start))",
        # The queue contains at least all elements that are counted.
        "len(queue) >= network.max_stored",
    ]
)


def _release_statements(measures: Sequence[_MeasureSource]) -> List[Statement]:
    """Return statements for a removed element ``old``; ``element`` is the one removed before it, or None."""
    if any(measure.keeps_elements for measure in measures):
        return ["old.is_removed = True", "stream.element_count -= 1"]
    # Nothing refers to the element, so it becomes the new one: creating an object takes a twentieth of an event.
    return [Block("if element is not None:", ["stream.element_count -= 1"]), "element = old"]


def _value_names(window: FusedWindow) -> List[str]:
    """Return the names of the values of those measures that have one."""
    return [f"x{number}" for number, position in enumerate(window.value_positions) if position is not None]


def _value_statements(window: FusedWindow, values_are_arguments: bool) -> List[Statement]:
    """Return statements that read the values of the measures and compute the key."""

    def value(position: int) -> str:
        return f"term[{position + 1}]" if values_are_arguments else f"values[{position}]"

    keys = (
        ["key"]
        if len(window.key_positions) == 1
        else [f"key{number}" for number in range(len(window.key_positions))]
    )
    statements: List[Statement] = []
    for number, (key, position) in enumerate(zip(keys, window.key_positions)):
        statements += [
            f"k{number} = {key} = {value(position)}",
            Block(f"if k{number}.__class__ not in SELF_KEYED:", [f"{key} = term_key(k{number})"]),
        ]
    if len(keys) != 1:
        statements.append(f"key = {tuple_source(keys)}")
    return [
        *statements,
        *(
            f"x{number} = {value(position)}"
            for number, position in enumerate(window.value_positions)
            if position is not None
        ),
    ]
