"""What an event does that is one side of a pair, in one function: with a plain key, and where one partner is enough.

What a side means is said by `waiting_only`, `taking_one` and `taking_all`, by `MatchBuffer` and by `Joining`. What is
written here does the same to the same matches; whatever is not of the common kind goes the plain way before anything
has changed.
"""

from typing import Any, Callable, Dict, NamedTuple, Optional, Sequence, Tuple

from ...foundation import shared_function
from ...prolog.machine import Frame
from ...prolog.syntax import EventOperator
from ...prolog.terms import Atom, EventAction, String, Var
from ..dispatch import MakeAction
from ..matches import Absence, Emit, Found, Match, MatchBuffer, Side
from .heads import Completion

_PLAIN = frozenset((Atom, int, String))
"""The kinds of terms that are their own keys."""
SPARE = 1000


class QuickPair(NamedTuple):
    """A two-sided node, as its quick sides see it.

    Attributes:
        whole: whether the matches of its left and of its right side are events whose arguments are the values.
        operator: which pairs fit, and their interval.
        span: the longest interval of a pair, in ns; None for no bound.
        taken: the variables of the values of a pair, and the sources of these: of ``lv[0]``, the first value of the
            left match, and the like.
        blocks: what tells for each absence whether it is in the way.
        tests: of a pair.
        tested: the further variables to which the tests give values.
        found: takes those of these values that are not carried on.
        complete: takes the values of a whole match; None where pairs are given on as matches.
    """

    whole: Tuple[bool, bool]
    operator: EventOperator
    span: Optional[int]
    taken: Sequence[Tuple[Var, str]]
    blocks: Sequence[Callable[..., bool]]
    tests: Sequence[Callable[..., Any]]
    tested: Sequence[Var]
    found: Callable[..., Any]
    complete: Optional[Completion]


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
                place = gone.buffer
                if place is own or place is other:
{leave}
                elif place is not None:
                    gone.leave()
            if late.heap or late.rest or expiries.others:
                expiries.expire(e)
"""
_OUT_OF_ORDER = """
        if s is not e and s + {span} < e:
            return plain(term, {values}, s, e, after)
    elif s + {span} < rule.clock:
        return plain(term, {values}, s, e, after)
{find}
    if {queue} and {queue}[-1].start > s:
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
    if {sweep}number > network.cap or len(arrivals) > 2 * number + SPARE:
        rule.look_through()
"""
_FILE = "    {queue}.append(match)"
_FILE_ANEW = "    expiries.add({span}, match, number)"
"""Where conditions were tested since, which may have led to other events of the rule."""
_KEEP = "    match.values = values\n"
_UNNAMED = "    match.identity = match.parts = None"
"""Where others mostly wait under the same key, and ask."""
_LEAVE = """
if {one}.older is {one} and not ({place}.indices or {place}.names):
    {one}.buffer = None
    rule.waiting -= 1
    del {newest}[{key}]
    {one}.older = {one}.newer = None
else:
    {place}.remove({one})
"""
"""As `MatchBuffer.remove`: mostly it is alone under its key."""
_PAIR = """
    start = {start}
    end = {end}
    if {fits}:
{met}
"""
_ONE = """
    {last} = partners.get(key)
    if {last} is not None:
{oldest}
{pair}
{tests}
            {found}:
{leave}
{stays}
{give}
            if {last}.older is not {last}:
                return among(Match({values}, s, e, None, term, None), key, partner, after)
        elif {last}.older is not {last}:
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
) -> Tuple[EventAction, Optional[MakeAction]]:
    """Return what takes the values of an event that is a side of a pair, and what makes its fused action.

    Args:
        side: the side.
        pair: the node.
        taking: what it does about partners; None where it only waits.
        rule: the rule.
        plain: the plain way, for what is not of the common kind.
        emit: takes pairs as matches, where they are no whole ones.
    """
    given = {
        **_common(rule, side.own, plain),
        "other": side.other,
        "partners": side.other.newest,
        "emit": emit,
        "complete": None if pair.complete is None else pair.complete.action,
        "found": pair.found,
        "among": None if taking is None else taking.among,
        "Found": Found,
    }
    given.update((f"absence{at}", one) for at, one in enumerate(pair.blocks))
    given.update((f"test{at}", one) for at, one in enumerate(pair.tests))

    return _actions(
        _source(side, pair, taking, rule), given, pair.whole[0 if side.left else 1], "side of a pair"
    )


def _actions(
    body: str, names: Dict[str, Any], whole: bool, title: str
) -> Tuple[EventAction, Optional[MakeAction]]:
    """Return the action of a body, and what gives it as a fused one where it reads the event itself."""
    filled = body.replace("{values}", "term[1:]" if whole else "values")
    lines = [line for line in filled.splitlines() if line.strip()]
    source = "\n".join(["def made(term, values, s, e, after):", *lines, ""])
    action: EventAction = shared_function(source, names, title)
    return action, (lambda: action) if whole else None


def _common(rule: Any, own: MatchBuffer, plain: EventAction) -> Dict[str, Any]:
    """Return what the sources of all sides may name."""
    network = rule.network
    return {
        "rule": rule,
        "network": network,
        "own": own,
        "waiting": own.newest,
        "arrivals": rule.arrivals,
        "expiries": rule.expiries,
        "queue": rule.expiries.queue,
        "late": rule.expiries.late,
        "plain": plain,
        "new": object.__new__,
        "Match": Match,
        "PLAIN": _PLAIN,
        "SPARE": SPARE,
    }


def quick_absent(
    absence: Absence, rule: Any, whole: bool, plain: EventAction
) -> Tuple[EventAction, Optional[MakeAction]]:
    """Return what takes the values of an event that must not happen, where no other waits under its key.

    Args:
        absence: where it waits.
        rule: the rule.
        whole: whether its values are its arguments; it may be fused then.
        plain: the plain way, for all else.
    """
    buffer = absence.buffer
    names = {**_common(rule, buffer, plain), "other": buffer, "absence": absence}
    body = _key([one for one, _ in absence.shared], whole) + _ABSENT + _before(buffer, rule, True)
    body += _waiting(buffer, rule, whole, False) + "    return after"
    return _actions(body, names, whole, "absent event")


def _source(side: Side, pair: QuickPair, taking: Optional[Taking], rule: Any) -> str:
    """Return the body: it has nothing of the program's in it but spans, and how many of what there are."""
    whole = pair.whole[0 if side.left else 1]
    begin = _key([one for one, _ in side.shared], whole)
    begin += _UNIFIED if taking is not None else ""
    begin += _before(side.own, rule, side.waits or side.stays)
    tested = bool(pair.blocks or pair.tests)
    wait = _waiting(side.own, rule, whole, taking is not None and tested, bool(side.shared))
    waits = wait if side.waits else ""
    if taking is None:
        rest = wait + "    return after"
    elif taking.uses:
        rest = _ONE.format(
            values="{values}",
            last="partner" if taking.newest else "last",
            oldest="" if taking.newest else "        partner = last.newer",
            pair=_indented(_pair(side, pair), 1),
            tests=_indented(_tests(side, pair), 3),
            found="if met is not None and partner.buffer is not None" if tested else "if True",
            leave=_indented(_LEAVE.format(one="partner", place="other", newest="partners", key="key"), 4),
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
    return begin + rest


def _before(own: MatchBuffer, rule: Any, waits: bool) -> str:
    """Return the lines that move the rule's clock, and leave what is out of order to the plain way."""
    span = own.span
    leave = _indented(_LEAVE.format(one="gone", place="place", newest="place.newest", key="gone.key"), 5)
    found = _TICK.format(main=rule.expiries.span or 0, leave=leave) if rule.timed else ""
    if waits and span is not None:
        queue = _queue(own, rule)
        find = "" if queue == "queue" else f"    {queue} = expiries.of({span})"
        found += _OUT_OF_ORDER.replace("{find}", find).replace("{queue}", queue).replace("{span}", str(span))
    return found


def _queue(own: MatchBuffer, rule: Any) -> str:
    """Return what the queue of those that wait here is called."""
    return "queue" if own.span == rule.expiries.span else "queued"


def _waiting(own: MatchBuffer, rule: Any, whole: bool, anew: bool, keyed: bool = True) -> str:
    """Return the lines by which a match begins to wait."""
    keep = "" if whole else _KEEP
    keep += "" if own.name is None or keyed else _UNNAMED
    file = _FILE_ANEW.format(span=own.span) if anew else _FILE.format(queue=_queue(own, rule))
    sweep = "number > rule.sweep_at or " if rule.sweeps_ruled_out else ""
    return _WAIT.format(keep=keep, file="" if own.span is None else file, sweep=sweep)


def _key(places: Sequence[int], whole: bool) -> str:
    """Return the lines that take the key."""
    names = ["key"] if len(places) == 1 else [f"x{at}" for at in range(len(places))]
    lines = []
    for name, place in zip(names, places):
        lines += [
            f"    {name} = term[{place + 1}]" if whole else f"    {name} = values[{place}]",
            f"    if {name}.__class__ not in PLAIN:",
            "        return plain(term, {values}, s, e, after)",
        ]
    lines += [] if len(places) == 1 else [f"    key = {_tuple(names)}"]
    return "\n".join([*lines, ""])


def _pair(side: Side, pair: QuickPair) -> str:
    """Return the lines that tell whether a partner fits, and what the values of the pair are."""
    fits = [f"({_said(one, side)})" for one in pair.operator.comparisons]
    fits += [] if pair.span is None else [f"end - start <= {pair.span}"]
    values = _tuple([_value(source, side, pair) for _, source in pair.taken])
    return _PAIR.format(
        start=_said(pair.operator.start, side),
        end=_said(pair.operator.end, side),
        fits=" and ".join(fits) or "True",
        met=f"        met = {values}",
    )


def _said(source: str, side: Side) -> str:
    """Return the source of an operator with the instants of a side that has come and of its partner."""
    one, two = ("1", "2") if side.left else ("2", "1")
    times = {f"s{one}": "s", f"e{one}": "e", f"s{two}": "partner.start", f"e{two}": "partner.end"}
    for name, here in times.items():
        source = source.replace(name, here)
    return source


def _value(source: str, side: Side, pair: QuickPair) -> str:
    """Return the source of a value of a pair: the functor is the first item of an event."""
    if source[:3] not in ("lv[", "rv["):
        return _said(source, side)
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
    """Return the lines that give a pair on."""
    if pair.complete is None:
        parts = ["match", "partner"] if side.left else ["partner", "match"]
        parts += ["Found(found(met))"] if pair.tested else []
        return _EMIT.replace("{parts}", _tuple(parts))
    return _COMPLETE


def _indented(text: str, by: int) -> str:
    """Return lines further to the right: by so many steps."""
    return "".join("    " * by + line + "\n" for line in text.splitlines())


def _tuple(items: Sequence[str]) -> str:
    return f"({''.join(f'{item}, ' for item in items)})"
