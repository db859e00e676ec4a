"""The common case of a sliding window in one function: numbers that come in order, in a group that is there.

What a window means is said by `Sliding.take`, `WindowGroup` and the measures. What is written here does the same to
the same groups and items; whatever is not of the common kind goes the plain way before anything has changed.
"""

from heapq import heappush
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence

from ...foundation import shared_function
from ...prolog.terms import EventAction, term_key
from .items import PLAIN, StreamItem


class QuickForm(NamedTuple):
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


class _MeasureText(NamedTuple):
    """What a measure does: ``x`` is its value, ``m`` the measure of the group, each by number.

    Attributes:
        check: looks at the value, and leaves to the plain way what is not of the common kind.
        add: takes ``item`` in.
        remove: takes ``old`` out of the group ``left``.
        result: is what is measured of ``number`` items.
    """

    check: str
    add: str
    remove: str
    result: str


_SUM = _MeasureText(
    """
    s{at} = group.measures[{at}].sum
    if x{at}.__class__ is float:
        y{at} = x{at} * s{at}.factor
        if not y{at}.is_integer():
            return plain(term, values, start, end, after)
        y{at} = y{at}.__trunc__()
    elif x{at}.__class__ is int:
        y{at} = x{at} << s{at}.scale
    else:
        return plain(term, values, start, end, after)
""",
    """
    s{at}.total += y{at}
    if x{at}.__class__ is float:
        s{at}.floats += 1
""",
    """
        value = old.values[{place}]
        total = left.measures[{at}].sum
        if value.__class__ is float and (scaled := value * total.factor).is_integer():
            total.total -= scaled.__trunc__()
            total.floats -= 1
        else:
            total.change(value, -1)
""",
    "s{at}.over(1)",
)
_MEAN = "s{at}.total / (number << s{at}.scale) if s{at}.floats else s{at}.over(number)"
_MIN = _MeasureText(
    """
    if x{at}.__class__ is not float and x{at}.__class__ is not int or x{at} != x{at}:
        return plain(term, values, start, end, after)
""",
    """
    lowest{at} = group.measures[{at}].lowest
    lowest{at}.live += 1
    heappush(lowest{at}.heap, (x{at}, order, item))
""",
    """
        left.measures[{at}].lowest.remove()
""",
    "lowest{at}.top()[2].values[{place}]",
)
_LINES: Dict[str, _MeasureText] = {
    "count": _MeasureText("", "", "", "number"),
    "sum": _SUM,
    "avg": _SUM._replace(result=_MEAN),
    "min": _MIN,
    "max": _MIN._replace(add=_MIN.add.replace("(x{at},", "(-x{at},")),
}

_TAKE = """
def made(term, values, start, end, after):
    stream = node.stream
    queue = stream._queue
{by}
    groups = stream.states
    group = groups.get(key)
    if (
        group is None
        or group._starts is not None
        or stream._heap
        or not stream.clock <= end <= stream._until
        or (start is not end and end - start >= span)
        or start < queue[-1].start
        or end < (last := group.members[-1]).end
        or stream.number >= network.cap
    ):
        return plain(term, values, start, end, after)
{check}
    stream.clock = end
    before = end - span
    while queue and queue[0].start <= before:
        old = queue.popleft()
        if old.gone:
            continue
        left = groups[old.key]
        if left._starts is not None:
            stream._leave(old)
            continue
        old.gone = True
        left.members.popleft()
        left.number = number = left.number - 1
        stream.number -= 1
{remove}
        if not number:
            del groups[old.key]
    item = new(StreamItem)
    item.match = None
    item.start = start
    item.end = end
    item.by = last.by
    item.key = key
    item.values = {taken}
    item.order = stream._order = order = stream._order + 1
    item.gone = False
    if group.number:
        groups.move_to_end(key)
    else:
        groups[key] = group
    group.number = number = group.number + 1
    stream.number += 1
    members = group.members
    members.append(item)
{add}
    queue.append(item)
    try:
        found = {found}
    except OverflowError:
        return too_large(group, after)
{limit}
    return complete(None, found, members[0].start, end, after)
"""


def is_quick(kinds: Sequence[str]) -> bool:
    """Tell whether there is a quick way for measures of some kinds."""
    return all(kind in _LINES for kind in kinds)


def quick_sliding(
    form: QuickForm,
    limit: Optional[int],
    node: Any,
    plain: EventAction,
    complete: EventAction,
    too_large: Callable[[Any, Any], Any],
) -> EventAction:
    """Return what takes the values of matches of one event.

    Args:
        form: the window.
        limit: the longest interval that is given on, in ns; None for no bound.
        node: has the `Sliding` as ``stream``, and the rule's network, which says how many items it may hold.
        plain: the plain way, for what is not of the common kind.
        complete: takes the values of groups and the results.
        too_large: gives on the error of a group whose results are too large for a float.
    """
    names: Dict[str, Any] = {
        "node": node,
        "network": node.rule.network,
        "span": form.span,
        "limit": limit,
        "plain": plain,
        "complete": complete,
        "too_large": too_large,
        "new": object.__new__,
        "StreamItem": StreamItem,
        "PLAIN": PLAIN,
        "term_key": term_key,
        "heappush": heappush,
        "OverflowError": OverflowError,
    }
    made: EventAction = shared_function(_source(form, limit is not None), names, "window")
    return made


def _source(form: QuickForm, limited: bool) -> str:
    """Return the source: it has nothing of the program's in it but how many of what there are, and where."""
    by: List[str] = []
    keys = ["key"] if len(form.groups) == 1 else [f"key{at}" for at in range(len(form.groups))]
    for at, where in enumerate(form.groups):
        by += [f"    k{at} = {keys[at]} = values[{where}]"]
        by += [f"    if k{at}.__class__ not in PLAIN:", f"        {keys[at]} = term_key(k{at})"]
    if len(keys) != 1:
        by.append(f"    key = {_tuple(keys)}")
    parts: List[_MeasureText] = []
    taken: List[str] = []
    for at, (kind, place) in enumerate(zip(form.kinds, form.values)):
        parts.append(_MeasureText(*[one.format(at=at, place=len(taken)) for one in _LINES[kind]]))
        if place is not None:
            by.append(f"    x{at} = values[{place}]")
            taken.append(f"x{at}")
    group = [f"k{at}" for at in range(len(form.groups))]
    lines = _TAKE.format(
        by="\n".join(by),
        check="".join(one.check for one in parts),
        remove="".join(one.remove for one in parts),
        taken=_tuple(taken),
        add="".join(one.add for one in parts),
        found=_tuple(group + [one.result for one in parts]),
        limit="    if end - members[0].start > limit:\n        return after" if limited else "",
    ).splitlines(True)
    return "".join(line for line in lines if line.strip())


def _tuple(items: Sequence[str]) -> str:
    return f"({''.join(f'{item}, ' for item in items)})"
