"""What an event does that is one side of a pair, in one function: with a plain key, and where one partner is enough.

What a side means is said by `waiting_only`, `taking_one` and `taking_all`, by `MatchBuffer` and by `Joining`. What is
written here does the same to the same matches; whatever is not of the common kind goes the plain way before anything
has changed.
"""

from typing import Any, Callable, Dict, NamedTuple, Optional, Sequence, Tuple

from ...foundation import shared_function
from ...prolog.machine import Frame
from ...prolog.syntax import EventOperator
from ...prolog.terms import Atom, EventAction, String
from ..matches import Absence, Emit, Found, Match, MatchBuffer, Side
from .conditions import Test

_PLAIN = frozenset((Atom, int, String))
"""The kinds of terms that are their own keys."""
SPARE = 1000


class QuickPair(NamedTuple):
    """A two-sided node, as its quick sides see it.

    Attributes:
        whole: whether the matches of its left and of its right side are events whose arguments are the values.
        operator: which pairs fit, and their interval.
        span: the longest interval of a pair, in ns; None for no bound.
        taken: the sources of the values of a pair: of ``lv[0]``, the first value of the left match, and the like.
        blocks: what tells for each absence whether it is in the way.
        tests: of a pair.
        found: takes the values that the tests have found and that are not carried on; None where they find none.
        complete: takes the values of a whole match; None where pairs are given on as matches.
    """

    whole: Tuple[bool, bool]
    operator: EventOperator
    span: Optional[int]
    taken: Sequence[str]
    blocks: Sequence[Callable[..., bool]]
    tests: Sequence[Test]
    found: Optional[Callable[..., Any]]
    complete: Optional[EventAction]


class Taking(NamedTuple):
    """What a side does about partners; None in its place for a side that only waits.

    Attributes:
        newest: whether it looks at the newest first; else at the oldest.
        uses: whether it takes one partner and uses it up; else it takes all.
        among: gives a match one of the partners but one that does not fit; see `among_others`.
    """

    newest: bool
    uses: bool
    among: Callable[..., Frame]


_HEAD = "def made(term, values, s, e, after):\n"
_UNIFIED = """
    if None in partners:
        return plain(term, {values}, s, e, after)
"""
_ABSENT = """
    if key in waiting or None in waiting:
        return plain(term, {values}, s, e, after)
    if absence.borders:
        absence.borders.pop(key, None)
"""
_TICK = """
    if e > rule.clock:
        if e > rule.allowed:
            rule.tick(e)
        else:
            rule.clock = e
            before = e - {main}
            while queue and queue[0].start < before:
                gone = queue.popleft()
                if gone.buffer is not None:
                    gone.leave()
            if expiries.heap or expiries.others:
                expiries.expire(e)
"""
_OUT_OF_ORDER = """
        if s is not e and s + {span} < e:
            return plain(term, {values}, s, e, after)
    elif s + {span} < rule.clock:
        return plain(term, {values}, s, e, after)
{file}
    if file and file[-1].start > s:
        return plain(term, {values}, s, e, after)
"""
_WAIT = """
    match = new(Match)
{keep}
    match.start = s
    match.end = e
    match.term = term
    match.key = key
    rule.order = match.order = rule.order + 1
    if key not in waiting:
        match.buffer = own
        match.older = match.newer = waiting[key] = match
    else:
        own.join(match)
    rule.waiting = number = rule.waiting + 1
    arrivals.append(match)
{file}
    if number > network.cap or len(arrivals) > 2 * number + SPARE:
        rule.look_through()
"""
_FILE = "    file.append(match)"
_FILE_ANEW = "    expiries.add({span}, match, number)"
"""Where conditions were tested since, which may have led to other events of the rule."""
_KEEP = "    match.values = values\n"
_UNNAMED = "    match.identity = None"
"""Where others mostly wait under the same key, and ask."""
_PAIR = """
    start = {start}
    end = {end}
    if {fits}:
        met = {met}
"""
_ONE = """
    last = partners.get(key)
    if last is not None:
        partner = {partner}
{pair}
{tests}
            {found}:
                if partner.older is partner and not (other.indices or other.names):
                    partner.buffer = None
                    rule.waiting -= 1
                    del partners[key]
                    partner.older = partner.newer = None
                else:
                    other.remove(partner)
{stays}
{give}
            if last.older is not last:
                return among(Match({values}, s, e, None, term, None), key, partner, after)
        elif last.older is not last:
            return plain(term, {values}, s, e, after)
{waits}
    return after
"""
_ALL = """
    partner = partners.get(key)
    if partner is not None and partner.older is not partner:
        return plain(term, {values}, s, e, after)
{waits}
    if partner is None or partner.buffer is None:
        return after
{pair}
{tests}
        {found}:
{give}
    return after
"""
_COMPLETE = "return complete(None, met, start, end, after)"
_EMIT = """
match = Match({values}, s, e, None, term, None)
return emit(Match(met, start, end, None, None, {parts}), after)
"""


def quick_side(
    side: Side, pair: QuickPair, taking: Optional[Taking], rule: Any, plain: EventAction, emit: Emit
) -> EventAction:
    """Return what takes the values of an event that is a side of a pair.

    Args:
        side: the side.
        pair: the node.
        taking: what it does about partners; None where it only waits.
        rule: the rule.
        plain: the plain way, for what is not of the common kind.
        emit: takes pairs as matches, where they are no whole ones.
    """
    names: Dict[str, Any] = {
        "rule": rule,
        "network": rule.network,
        "own": side.own,
        "other": side.other,
        "waiting": side.own.newest,
        "partners": side.other.newest,
        "arrivals": rule.arrivals,
        "expiries": rule.expiries,
        "queue": rule.expiries.queue,
        "plain": plain,
        "emit": emit,
        "complete": pair.complete,
        "found": pair.found,
        "among": None if taking is None else taking.among,
        "new": object.__new__,
        "Match": Match,
        "Found": Found,
        "PLAIN": _PLAIN,
        "SPARE": SPARE,
    }
    names.update((f"absence{at}", one) for at, one in enumerate(pair.blocks))
    names.update((f"test{at}", one) for at, one in enumerate(pair.tests))
    made: EventAction = shared_function(_source(side, pair, taking, rule), names, "side of a pair")
    return made


def quick_absent(absence: Absence, rule: Any, whole: bool, plain: EventAction) -> EventAction:
    """Return what takes the values of an event that must not happen, where no other waits under its key.

    Args:
        absence: where it waits.
        rule: the rule.
        whole: whether its values are its arguments.
        plain: the plain way, for all else.
    """
    buffer = absence.buffer
    names: Dict[str, Any] = {
        "rule": rule,
        "network": rule.network,
        "absence": absence,
        "own": buffer,
        "waiting": buffer.newest,
        "arrivals": rule.arrivals,
        "expiries": rule.expiries,
        "queue": rule.expiries.queue,
        "plain": plain,
        "new": object.__new__,
        "Match": Match,
        "PLAIN": _PLAIN,
        "SPARE": SPARE,
    }
    source = _text(
        _HEAD + _key([one for one, _ in absence.shared], whole) + _ABSENT + _before(buffer, rule, True),
        _waiting(buffer, whole, False) + "    return after",
        whole,
    )
    made: EventAction = shared_function(source, names, "absent event")
    return made


def _source(side: Side, pair: QuickPair, taking: Optional[Taking], rule: Any) -> str:
    """Return the source: it has nothing of the program's in it but spans, and how many of what there are."""
    whole = pair.whole[0 if side.left else 1]
    begin = _HEAD + _key([one for one, _ in side.shared], whole)
    begin += _UNIFIED if taking is not None else ""
    begin += _before(side.own, rule, side.waits or side.stays)
    tested = bool(pair.blocks or pair.tests)
    wait = _waiting(side.own, whole, taking is not None and tested, bool(side.shared))
    waits = wait if side.waits else ""
    if taking is None:
        rest = wait + "    return after"
    elif taking.uses:
        rest = _ONE.format(
            values="{values}",
            partner="last" if taking.newest else "last.newer",
            pair=_indented(_pair(side, pair), 1),
            tests=_indented(_tests(side, pair), 3),
            found="if met is not None and partner.buffer is not None" if tested else "if True",
            stays=_indented(wait, 3) if side.stays else "",
            give=_indented(_give(side, pair), 4),
            waits=waits,
        )
    else:
        rest = _ALL.format(
            values="{values}",
            pair=_pair(side, pair),
            tests=_indented(_tests(side, pair), 2),
            found="if met is not None" if tested else "if True",
            give=_indented(_give(side, pair), 3),
            waits=waits,
        )
    return _text(begin, rest, whole)


def _text(begin: str, rest: str, whole: bool) -> str:
    lines = (begin + rest).replace("{values}", "term[1:]" if whole else "values").splitlines(True)
    return "".join(line for line in lines if line.strip()) + "\n"


def _before(own: MatchBuffer, rule: Any, waits: bool) -> str:
    """Return the lines that move the rule's clock, and leave what is out of order to the plain way."""
    main, span = rule.expiries.span, own.span
    found = _TICK.replace("{main}", str(main or 0)) if rule.timed else ""
    if waits and span is not None:
        file = "    file = queue" if span == main else f"    file = expiries.of({span})"
        found += _OUT_OF_ORDER.replace("{file}", file).replace("{span}", str(span))
    return found


def _waiting(own: MatchBuffer, whole: bool, anew: bool, keyed: bool = True) -> str:
    """Return the lines by which a match begins to wait."""
    keep = "" if whole else _KEEP
    keep += "" if own.name is None or keyed else _UNNAMED
    file = _FILE_ANEW.replace("{span}", str(own.span)) if anew else _FILE
    return _WAIT.format(keep=keep, file="" if own.span is None else file)


def _key(places: Sequence[int], whole: bool) -> str:
    lines = []
    for at, place in enumerate(places):
        lines += [
            f"    k{at} = term[{place + 1}]" if whole else f"    k{at} = values[{place}]",
            f"    if k{at}.__class__ not in PLAIN:",
            "        return plain(term, {values}, s, e, after)",
        ]
    keys = [f"k{at}" for at in range(len(places))]
    return "\n".join([*lines, f"    key = {keys[0] if len(keys) == 1 else _tuple(keys)}", ""])


def _pair(side: Side, pair: QuickPair) -> str:
    """Return the lines that tell whether a partner fits, and what the values of the pair are."""
    one, two = ("1", "2") if side.left else ("2", "1")
    times = {f"s{one}": "s", f"e{one}": "e", f"s{two}": "partner.start", f"e{two}": "partner.end"}

    def said(source: str) -> str:
        for name, here in times.items():
            source = source.replace(name, here)
        return source

    fits = [f"({said(one)})" for one in pair.operator.comparisons]
    fits += [] if pair.span is None else [f"end - start <= {pair.span}"]
    return _PAIR.format(
        start=said(pair.operator.start),
        end=said(pair.operator.end),
        fits=" and ".join(fits) or "True",
        met=_tuple([said(_value(one, side, pair)) for one in pair.taken]),
    )


def _value(source: str, side: Side, pair: QuickPair) -> str:
    """Return the source of a value of a pair: the functor is the first item of an event."""
    if source[:3] not in ("lv[", "rv["):
        return source
    left, at = source[0] == "l", int(source[3:-1])
    of = "" if left == side.left else "partner."
    return f"{of}term[{at + 1}]" if pair.whole[0 if left else 1] else f"{of}values[{at}]"


def _tests(side: Side, pair: QuickPair) -> str:
    """Return the lines of absences and conditions: ``met`` is None after them where one fails."""
    ended, began = ("e", "partner.start") if side.left else ("partner.end", "s")
    lines = []
    for at in range(len(pair.blocks)):
        lines += ["if met is not None:"] if at else []
        lines += [
            f"{'    ' if at else ''}if absence{at}(met, {ended}, {began}):",
            f"{'    ' if at else ''}    met = None",
        ]
    for at in range(len(pair.tests)):
        given = at or pair.blocks
        lines += ["if met is not None:"] if given else []
        lines += [f"{'    ' if given else ''}met = test{at}(met, start, end)"]
    return "\n".join(lines)


def _give(side: Side, pair: QuickPair) -> str:
    if pair.complete is not None:
        return _COMPLETE
    parts = ["match", "partner"] if side.left else ["partner", "match"]
    parts += [] if pair.found is None else ["Found(found(met))"]
    return _EMIT.replace("{parts}", _tuple(parts))


def _indented(text: str, by: int) -> str:
    """Return lines further to the right: by so many steps."""
    return "".join("    " * by + line + "\n" for line in text.splitlines())


def _tuple(items: Sequence[str]) -> str:
    return f"({''.join(f'{item}, ' for item in items)})"
