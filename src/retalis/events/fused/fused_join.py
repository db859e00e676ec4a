"""An event that is a side of a pair, or that must not happen, served by one function.

The plain way is `waiting_only`, `taking_one` and `taking_all` on a `MatchBuffer`, for a `Joining` node. The functions
generated here do the same to the same matches if the key is an atom, an integer or a string and one partner is
enough. Everything else goes the plain way before a match is added or removed; the clock of the rule may have moved.
"""

from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple

from ...foundation.codegen import Block, Statement, shared_function, source_of, tuple_source
from ...prolog.syntax.event_operators import EventOperator
from ...prolog.terms.term_traversal import PLAIN
from ...prolog.terms.types import EventAction, Frame, Var
from ..matches.consumption_policy import Emit, MatchSide
from ..matches.match_buffer import MatchBuffer
from ..matches.negation import NegationBuffer
from ..matches.partial_matches import EventMatch, Found, PartialMatch
from .fused_actions import Continuation

SPARE = 1000
"""Matches that may have left a rule's arrivals before these are looked through."""

_RETURN = "return after"
_COMPLETE = "return complete(None, met, start, end, after)"


class FusedPair(NamedTuple):
    """A two-sided node, as its fused sides see it.

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
    complete: Optional[Continuation]


class PartnerChoice(NamedTuple):
    """The choice of partners by a side; None in its place for a side that only waits.

    Attributes:
        newest: whether it looks at the newest first; else at the oldest.
        consumes: whether it takes one partner and consumes it; else it takes all.
        among: gives a match one of the partners but one that does not fit; see `among_others`.
    """

    newest: bool
    consumes: bool
    among: Callable[..., Frame]


def fused_side(
    side: MatchSide,
    pair: FusedPair,
    choice: Optional[PartnerChoice],
    rule: Any,
    plain: EventAction,
    emit: Emit,
) -> EventAction:
    """Return the action of an event that is a side of a pair.

    Args:
        side: the side.
        pair: the node.
        choice: how it chooses partners; None where it only waits.
        rule: the rule.
        plain: the plain way.
        emit: takes pairs as matches, where they are no whole ones.
    """
    names = {
        **_common_names(rule, side.own, plain),
        "other": side.other,
        "partners": side.other.newest,
        "emit": emit,
        "complete": None if pair.complete is None else pair.complete.action,
        "found": pair.found,
        "among": None if choice is None else choice.among,
        "Found": Found,
    }
    names.update((f"absence{at}", one) for at, one in enumerate(pair.blocks))
    names.update((f"test{at}", one) for at, one in enumerate(pair.tests))
    return _SideWriter(side, pair, rule).action(choice, names)


def fused_absence(absence: NegationBuffer, rule: Any, whole: bool, plain: EventAction) -> EventAction:
    """Return the action of an event that must not happen, where no other waits under its key; see `fused_side`.

    Args:
        absence: where it waits.
        rule: the rule.
        whole: whether its values are its arguments.
        plain: the plain way.
    """
    writer = _Writer(absence.buffer, rule, whole)
    names = {**_common_names(rule, absence.buffer, plain), "absence": absence}
    return writer.made(
        [
            *writer.key([one for one, _ in absence.shared]),
            Block("if key in waiting or None in waiting:", [writer.plain]),
            Block("if absence.borders:", ["absence.borders.pop(key, None)"]),
            *writer.clock(True),
            *writer.wait(False),
            _RETURN,
        ],
        names,
        "absent event",
    )


def _common_names(rule: Any, own: MatchBuffer, plain: EventAction) -> Dict[str, Any]:
    """Return what the functions of all sides may name."""
    return {
        "rule": rule,
        "network": rule.network,
        "own": own,
        "waiting": own.newest,
        "arrivals": rule.arrivals,
        "expiries": rule.expiries,
        "queue": rule.expiries.queue,
        "late": rule.expiries.late,
        "plain": plain,
        "new": object.__new__,
        "EventMatch": EventMatch,
        "Match": PartialMatch,
        "PLAIN": PLAIN,
        "SPARE": SPARE,
    }


class _Writer:
    """Generates the action of an event that may wait. The source contains only spans and sizes of the program.

    Args:
        own: where it waits.
        rule: its rule.
        whole: whether its values are its arguments.
    """

    def __init__(self, own: MatchBuffer, rule: Any, whole: bool) -> None:
        self.own = own
        self.rule = rule
        self.whole = whole
        self.values = "term[1:]" if whole else "values"
        self.plain = f"return plain(term, {self.values}, s, e, after)"
        self.queue = "queue" if own.span == rule.expiries.span else "queued"

    def made(self, body: Sequence[Statement], names: Dict[str, Any], title: str) -> EventAction:
        """Return the action of a body."""
        source = source_of([Block("def made(term, values, s, e, after):", body)])
        action: EventAction = shared_function(source, names, title)
        return action

    def key(self, places: Sequence[int]) -> List[Statement]:
        """Return the statements that take the key from values at some places."""
        names = ["key"] if len(places) == 1 else [f"x{at}" for at in range(len(places))]
        found: List[Statement] = []
        for name, place in zip(names, places):
            found += [
                f"{name} = term[{place + 1}]" if self.whole else f"{name} = values[{place}]",
                Block(f"if {name}.__class__ not in PLAIN:", [self.plain]),
            ]
        return found if len(places) == 1 else [*found, f"key = {tuple_source(names)}"]

    def clock(self, waits: bool) -> List[Statement]:
        """Return the statements that move the rule's clock, and leave what is out of order to the plain way."""
        span, queue = self.own.span, self.queue
        late: List[Statement] = []
        if waits and span is not None:
            late = [Block(f"if s is not e and s + {span} < e:", [self.plain])]
        found: List[Statement] = []
        if self.rule.timed:
            found.append(Block("if e > rule.clock:", [*self._tick(), *late]))
        if late:
            found += [
                Block(f"elif s + {span} < rule.clock:", [self.plain]),
                *([] if queue == "queue" else [f"{queue} = expiries.of({span})"]),
                Block(f"if {queue} and {queue}[-1].start > s:", [self.plain]),
            ]
        return found

    def _tick(self) -> List[Statement]:
        """Return the statements that move the clock to the end of the event, and drop what has expired."""
        return [
            Block("if e > rule.allowed:", ["rule.tick(e)"]),
            Block(
                "else:",
                [
                    "rule.clock = e",
                    f"before = e - {self.rule.expiries.span or 0}",
                    Block(
                        "while queue and queue[0].start < before:",
                        [
                            "gone = queue.popleft()",
                            "place = gone.buffer",
                            Block("if place is not None:", ["place.remove(gone)"]),
                        ],
                    ),
                    Block("if late.heap or late.rest or expiries.others:", ["expiries.expire(e)"]),
                ],
            ),
        ]

    def wait(self, anew: bool, keyed: bool = True) -> List[Statement]:
        """Return the statements by which a match begins to wait.

        Args:
            anew: whether conditions were tested since the clock was moved, which may have led to other events.
            keyed: whether it has a key.
        """
        own = self.own
        keep = [] if self.whole else ["match.values = values"]
        if own.name is not None and not keyed:  # others mostly wait under the same key, and ask for its name
            keep.append("match.identity = match.parts = None")
        file = []
        if own.span is not None:
            file = [f"expiries.add({own.span}, match, number)" if anew else f"{self.queue}.append(match)"]
        sweep = "number > rule.sweep_at or " if self.rule.sweeps_ruled_out else ""
        return [
            "alone = key not in waiting",
            "match = new(Match)" if keep else "match = new(EventMatch if alone else Match)",
            *keep,
            "match.start = s",
            "match.end = e",
            "match.term = term",
            "match.key = key",
            "rule.order = match.order = rule.order + 1",
            Block(
                "if alone:",
                ["match.buffer = own", "match.older = match.newer = waiting[key] = match"],
            ),
            Block("else:", ["own.join(match)"]),
            "rule.waiting = number = rule.waiting + 1",
            "arrivals.append(match)",
            *file,
            Block(
                f"if {sweep}number > network.cap or len(arrivals) > 2 * number + SPARE:",
                ["rule.look_through()"],
            ),
        ]


class _SideWriter(_Writer):
    """Generates the action of a side of a pair.

    Args:
        side: the side.
        pair: the node.
        rule: its rule.
    """

    def __init__(self, side: MatchSide, pair: FusedPair, rule: Any) -> None:
        super().__init__(side.own, rule, pair.whole[0 if side.left else 1])
        self.side = side
        self.pair = pair
        self.tested = bool(pair.blocks or pair.tests)

    def action(self, choice: Optional[PartnerChoice], names: Dict[str, Any]) -> EventAction:
        """Return the action."""
        side = self.side
        begin = self.key([one for one, _ in side.shared])
        if choice is not None:
            begin.append(Block("if None in partners:", [self.plain]))
        begin += self.clock(side.waits or side.stays)
        wait = self.wait(choice is not None and self.tested, bool(side.shared))
        if choice is None:
            rest = wait
        elif choice.consumes:
            rest = self._use_one(wait, choice.newest)
        else:
            rest = self._take_all(wait)
        return self.made([*begin, *rest, _RETURN], names, "side of a pair")

    def _use_one(self, wait: List[Statement], newest: bool) -> List[Statement]:
        """Return the statements that use up the newest or the oldest partner."""
        last = "partner" if newest else "last"
        give = [
            "other.remove(partner)",
            *(wait if self.side.stays else []),
            *self._give(),
        ]
        found = [Block("if met is not None and partner.buffer is not None:", give)] if self.tested else give
        others = [
            Block(
                f"if {last}.older is not {last}:",
                [f"return among(Match({self.values}, s, e, None, term, None), key, partner, after)"],
            )
        ]
        return [
            f"{last} = partners.get(key)",
            Block(
                f"if {last} is not None:",
                [
                    *([] if newest else ["partner = last.newer"]),
                    *self._interval(),
                    Block(
                        f"if {self._fits()}:",
                        [self._met(), *self._tests(), *found, *(others if self.tested else [])],
                    ),
                    Block(f"elif {last}.older is not {last}:", [self.plain]),
                ],
            ),
            *(wait if self.side.waits else []),
        ]

    def _take_all(self, wait: List[Statement]) -> List[Statement]:
        """Return the statements that take all partners, of which there may be one."""
        give = self._give()
        return [
            "partner = partners.get(key)",
            Block("if partner is not None and partner.older is not partner:", [self.plain]),
            *(wait if self.side.waits else []),
            Block("if partner is None or partner.buffer is None:", [_RETURN]),
            *self._interval(),
            Block(
                f"if {self._fits()}:",
                [
                    self._met(),
                    *self._tests(),
                    *([Block("if met is not None:", give)] if self.tested else give),
                ],
            ),
        ]

    def _interval(self) -> List[str]:
        """Return the statements that give the interval of a pair."""
        operator = self.pair.operator
        return [f"start = {self._instants(operator.start)}", f"end = {self._instants(operator.end)}"]

    def _fits(self) -> str:
        """Return the condition that a partner fits by time."""
        fits = [f"({self._instants(one)})" for one in self.pair.operator.comparisons]
        fits += [] if self.pair.span is None else [f"end - start <= {self.pair.span}"]
        return " and ".join(fits) or "True"

    def _met(self) -> str:
        """Return the statement that takes the values of the pair."""
        return f"met = {tuple_source([self._value(source) for _, source in self.pair.taken])}"

    def _instants(self, source: str) -> str:
        """Return the source of an operator with the instants of the side that has come and of its partner."""
        one, two = ("1", "2") if self.side.left else ("2", "1")
        times = {f"s{one}": "s", f"e{one}": "e", f"s{two}": "partner.start", f"e{two}": "partner.end"}
        for name, here in times.items():
            source = source.replace(name, here)
        return source

    def _value(self, source: str) -> str:
        """Return the source of a value of the pair: the functor is the first item of an event."""
        if source[:3] not in ("lv[", "rv["):
            return self._instants(source)
        left, at = source[0] == "l", int(source[3:-1])
        of = "" if left == self.side.left else "partner."
        return f"{of}term[{at + 1}]" if self.pair.whole[0 if left else 1] else f"{of}values[{at}]"

    def _tests(self) -> List[Statement]:
        """Return the statements of absences and conditions: ``met`` is None after them where one fails."""
        ended, began = ("e", "partner.start") if self.side.left else ("partner.end", "s")
        steps: List[Statement] = [
            Block(f"if absence{at}(met, {ended}, {began}):", ["met = None"])
            for at in range(len(self.pair.blocks))
        ]
        steps += [f"met = test{at}(met, start, end)" for at in range(len(self.pair.tests))]
        return [step if at == 0 else Block("if met is not None:", [step]) for at, step in enumerate(steps)]

    def _give(self) -> List[Statement]:
        """Return the statements that give a pair on."""
        if self.pair.complete is not None:
            return [_COMPLETE]
        parts = ["match", "partner"] if self.side.left else ["partner", "match"]
        parts += ["Found(found(met))"] if self.pair.tested else []
        return [
            f"match = Match({self.values}, s, e, None, term, None)",
            f"return emit(Match(met, start, end, None, None, {tuple_source(parts)}), after)",
        ]
