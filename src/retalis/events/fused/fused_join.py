"""Fused join inputs: one generated function per operand of a join, and per negated event.

The general path is `store_only`, `join_one_partner` and `join_all_partners` on a `MatchBuffer`, called by a join
node. The functions generated here do the same to the same matches if the key is an atom, an integer or a string, and
at most one partner is needed. All other cases call the general path before a match is added or removed; only the
clock of the rule may have advanced.

A generated function performs these steps: compute the join key, advance the clock and expire matches, look up the
partner, compare intervals, run conditions and negations, then emit the pair or store the match.

Names in the generated source: ``term`` is the event with the interval from ``event_start`` to ``event_end``,
``match`` its match, ``partner`` the stored match of the other operand, and ``pair_values`` the values of both with
the interval from ``start`` to ``end``. ``own_newest`` and ``other_newest`` map a join key to the newest stored match
of this operand and of the other one; the matches of a key form a ring (see `MatchBuffer`), so ``newest.newer`` is the
oldest one, and a match is the only one of its key if it is its own ``older``.
"""

from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple

from ...foundation.codegen import Block, Statement, shared_function, source_of, tuple_source
from ...prolog.terms.term_traversal import SELF_KEYED
from ...prolog.terms.types import EventAction, Frame, Var
from ..language.event_operators import EventOperator
from ..matches.consumption_policy import Emit, MatchSide
from ..matches.match_buffer import MatchBuffer
from ..matches.match_limit import STALE_ARRIVALS_TOLERANCE
from ..matches.match_types import (
    ComputedValues,
    EventMatch,
    IdentifiedEventMatch,
    OrderedEventMatch,
    PartialMatch,
)
from ..matches.negation import NegationBuffer
from .fused_single_event import Continuation

_SET_ORDER = "rule.order = match.order = event_end if event_end > rule.order else rule.order + 1"
_RETURN_FRAME = "return frame"
_RETURN_COMPLETE = "return complete(None, pair_values, start, end, frame)"


class FusedPair(NamedTuple):
    """Properties of a join node that its fused operands need.

    Attributes:
        values_are_arguments: for the left and the right operand, whether the values of a match are the arguments of
            the event.
        operator: the operator; it determines which intervals fit, and the interval of a pair.
        span: maximum interval of a pair in ns; None for no limit.
        value_sources: variables of a pair, each with the source of its value: ``lv[0]`` is the first value of the
            left match.
        negation_tests: for each negation a function that returns whether it prevents the pair.
        tests: conditions of a pair.
        condition_vars: additional variables that the conditions bind.
        computed_values: returns the values of a pair that belong to its identity but are not passed on; see
            `ComputedValues`.
        complete: action for the values of a complete match; None if pairs are emitted as partial matches.
    """

    values_are_arguments: Tuple[bool, bool]
    operator: EventOperator
    span: Optional[int]
    value_sources: Sequence[Tuple[Var, str]]
    negation_tests: Sequence[Callable[..., bool]]
    tests: Sequence[Callable[..., Any]]
    condition_vars: Sequence[Var]
    computed_values: Callable[..., Any]
    complete: Optional[Continuation]


class PartnerChoice(NamedTuple):
    """Selection of partners by an operand, from the consumption policy.

    Attributes:
        newest: whether the newest partner is tried first, otherwise the oldest one.
        consumes: whether one partner is joined and consumed; otherwise all partners are joined.
        join_other: joins a match with one of the partners other than the one that was tried; see
            `join_one_of_others`.
    """

    newest: bool
    consumes: bool
    join_other: Callable[..., Frame]


def compile_fused_operand(
    side: MatchSide,
    pair: FusedPair,
    choice: Optional[PartnerChoice],
    rule: Any,
    general_path: EventAction,
    emit: Emit,
) -> EventAction:
    """Return the action for an event that is an operand of a join.

    Args:
        side: the operand.
        pair: the node.
        choice: selection of partners; None for an operand whose matches are only stored.
        rule: the rule.
        general_path: action of the general path, for any event.
        emit: receives pairs as matches, if these are not complete.
    """
    names = {
        **_common_names(rule, side.own_buffer, general_path),
        "other_buffer": side.other_buffer,
        "other_newest": side.other_buffer.newest,
        "emit": emit,
        "complete": None if pair.complete is None else pair.complete.action,
        "computed_values": pair.computed_values,
        "join_other": None if choice is None else choice.join_other,
        "ComputedValues": ComputedValues,
    }
    names.update((f"negation{index}", function) for index, function in enumerate(pair.negation_tests))
    names.update((f"test{index}", function) for index, function in enumerate(pair.tests))
    return _OperandGenerator(side, pair, rule).action(choice, names)


def compile_fused_negation(
    negation: NegationBuffer, rule: Any, values_are_arguments: bool, general_path: EventAction
) -> EventAction:
    """Return the action for a negated event; it is fused if no negated event is stored under its key."""
    generator = _ActionGenerator(negation.buffer, rule, values_are_arguments)
    names = {**_common_names(rule, negation.buffer, general_path), "negation": negation}
    return generator.compile_action(
        [
            *generator.key_statements([index for index, _ in negation.shared]),
            # A stored event without a key may be a duplicate of this one or may dominate it; the general path
            # compares them.
            Block("if key in own_newest or None in own_newest:", [generator.general_path]),
            Block("if negation.frontiers:", ["negation.frontiers.pop(key, None)"]),
            *generator.clock_statements(True),
            *generator.store_statements(False),
            _RETURN_FRAME,
        ],
        names,
        "absent event",
    )


def _common_names(rule: Any, buffer: MatchBuffer, general_path: EventAction) -> Dict[str, Any]:
    """Return the objects that all generated functions refer to."""
    return {
        "rule": rule,
        "network": rule.network,
        "own_buffer": buffer,
        "own_newest": buffer.newest,
        "arrivals": rule.arrivals,
        "expiration_queue": rule.expiration_queue,
        "main_queue": rule.expiration_queue.queue,
        "late_heap": rule.expiration_queue.late_heap,
        "general_path": general_path,
        "new": object.__new__,
        "EventMatch": EventMatch,
        "IdentifiedEventMatch": IdentifiedEventMatch,
        "OrderedEventMatch": OrderedEventMatch,
        "Match": PartialMatch,
        "SELF_KEYED": SELF_KEYED,
        "STALE_ARRIVALS_TOLERANCE": STALE_ARRIVALS_TOLERANCE,
    }


class _ActionGenerator:
    """Generator for the action of an event that may be stored as a match.

    The generated source contains time limits and sizes of the program, but none of its names and texts.
    """

    def __init__(self, own_buffer: MatchBuffer, rule: Any, values_are_arguments: bool) -> None:
        self.own_buffer = own_buffer
        self.rule = rule
        self.values_are_arguments = values_are_arguments
        self.values = "term[1:]" if values_are_arguments else "values"
        self.general_path = f"return general_path(term, {self.values}, event_start, event_end, frame)"
        self.queue = (
            "main_queue" if own_buffer.retention == rule.expiration_queue.retention else "retention_queue"
        )

    def compile_action(self, body: Sequence[Statement], names: Dict[str, Any], title: str) -> EventAction:
        """Return the compiled action."""
        source = source_of([Block("def generated(term, values, event_start, event_end, frame):", body)])
        action: EventAction = shared_function(source, names, title)
        return action

    def key_statements(self, indices: Sequence[int]) -> List[Statement]:
        """Return statements that compute the key from the values at some indices."""
        names = ["key"] if len(indices) == 1 else [f"x{number}" for number in range(len(indices))]
        statements: List[Statement] = []
        for name, index in zip(names, indices):
            statements += [
                f"{name} = term[{index + 1}]" if self.values_are_arguments else f"{name} = values[{index}]",
                Block(f"if {name}.__class__ not in SELF_KEYED:", [self.general_path]),
            ]
        return statements if len(indices) == 1 else [*statements, f"key = {tuple_source(names)}"]

    def clock_statements(self, stores_event: bool) -> List[Statement]:
        """Return statements that advance the clock of the rule.

        An event that is stored takes the general path if it has expired already or is out of the order of its queue.
        """
        span, queue = self.own_buffer.retention, self.queue
        long_event_test: List[Statement] = []
        if stores_event and span is not None:
            # An event longer than the retention time expires at once, which the general path handles.
            long_event_test = [
                Block(
                    f"if event_start is not event_end and event_start + {span} < event_end:",
                    [self.general_path],
                )
            ]
        statements: List[Statement] = []
        if self.rule.maintains_clock:
            statements.append(Block("if event_end > rule.clock:", [*self._advance_clock(), *long_event_test]))
        if long_event_test:
            statements += [
                Block(f"elif event_start + {span} < rule.clock:", [self.general_path]),
                *([] if queue == "main_queue" else [f"{queue} = expiration_queue.queue_for({span})"]),
                Block(f"if {queue} and {queue}[-1].start > event_start:", [self.general_path]),
            ]
        return statements

    def _advance_clock(self) -> List[Statement]:
        """Return statements that set the clock to the end of the event, and drop expired matches."""
        return [
            # A timestamp too far in the future does not advance the clock; ``max_timestamp`` is the last limit. The
            # general path reports it.
            Block("if event_end > rule.max_timestamp and rule.is_ahead(event_end):", [self.general_path]),
            Block(
                "else:",
                [
                    "rule.clock = event_end",
                    f"oldest_start = event_end - {self.rule.expiration_queue.retention or 0}",
                    Block(
                        "while main_queue and main_queue[0].start < oldest_start:",
                        [
                            "expired = main_queue.popleft()",
                            "holder = expired.buffer",
                            Block("if holder is not None:", ["holder.remove(expired)"]),
                        ],
                    ),
                    Block(
                        "if late_heap.heap or late_heap.unmoved or expiration_queue.other_queues:",
                        ["expiration_queue.expire(event_end)"],
                    ),
                ],
            ),
        ]

    def store_statements(self, conditions_ran: bool) -> List[Statement]:
        """Return statements that store a match in its buffer.

        Args:
            conditions_ran: whether conditions ran after the clock was advanced; they may have caused other events.
        """
        buffer = self.own_buffer
        times: List[Statement] = ["match.start = event_start", "match.end = event_end", _SET_ORDER]
        creation: List[Statement] = [
            "match = new(Match)",
            "match.values = values",
            "match.event = match.parts = match.identity = match.consumed_by = None",
            *times,
        ]
        if self.values_are_arguments:
            # The short classes save memory and time. A match that is compared with others of its key stores its
            # identity; most keys have one stored match, which is compared with nothing.
            only_match_test = "" if buffer.identity_of is None else "is_only_match and "
            creation = [
                Block(
                    f"if {only_match_test}event_start is event_end and event_end > rule.order:",
                    ["match = new(EventMatch)", "match.start = rule.order = event_end"],
                ),
                Block(
                    "else:",
                    [
                        "match = new(OrderedEventMatch)"
                        if buffer.identity_of is None
                        else "match = new(OrderedEventMatch if is_only_match else IdentifiedEventMatch)",
                        *times,
                    ],
                ),
            ]
        expiration_statements = []
        if buffer.retention is not None:
            expiration_statements = [
                f"expiration_queue.add({buffer.retention}, match, stored_count)"
                if conditions_ran
                else f"{self.queue}.append(match)"
            ]
        sweep_test = "stored_count > rule.sweep_threshold or " if self.rule.sweeps_ruled_out else ""
        return [
            "is_only_match = key not in own_newest",
            *creation,
            "match.term = term",
            "match.key = key",
            Block(
                "if is_only_match:",
                ["match.buffer = own_buffer", "match.older = match.newer = own_newest[key] = match"],
            ),
            Block("else:", ["own_buffer.add_to_ring(match)"]),
            "rule.stored_match_count = stored_count = rule.stored_match_count + 1",
            "arrivals.append(match)",
            *expiration_statements,
            Block(
                f"if {sweep_test}stored_count > rule.max_stored"
                " or len(arrivals) > 2 * stored_count + STALE_ARRIVALS_TOLERANCE:",
                ["rule.remove_excess()"],
            ),
        ]


class _OperandGenerator(_ActionGenerator):
    """Generator for the action of an operand of a join."""

    def __init__(self, side: MatchSide, pair: FusedPair, rule: Any) -> None:
        super().__init__(side.own_buffer, rule, pair.values_are_arguments[0 if side.is_left else 1])
        self.side = side
        self.pair = pair
        self.has_tests = bool(pair.negation_tests or pair.tests)

    def action(self, choice: Optional[PartnerChoice], names: Dict[str, Any]) -> EventAction:
        """Return the action."""
        side = self.side
        prologue = self.key_statements([index for index, _ in side.shared])
        if choice is not None:
            # Partners under the key None have variables in their keys, and may unify with any key.
            prologue.append(Block("if None in other_newest:", [self.general_path]))
        prologue += self.clock_statements(side.stores_unmatched or side.stores_matched)
        storing = self.store_statements(choice is not None and self.has_tests)
        if choice is None:
            body = storing
        elif choice.consumes:
            body = self._consume_partner(storing, choice.newest)
        else:
            body = self._join_all(storing)
        return self.compile_action([*prologue, *body, _RETURN_FRAME], names, "side of a pair")

    def _consume_partner(self, storing: List[Statement], newest: bool) -> List[Statement]:
        """Return statements that consume the newest or the oldest partner."""
        candidate = "partner" if newest else "newest"
        emission_statements = [
            # The partner leaves before the pair is emitted: an event that the pair causes must not find it again.
            "other_buffer.remove(partner)",
            *(storing if self.side.stores_matched else []),
            *self._emit_statements(),
        ]
        checked_emission = (
            [Block("if pair_values is not None and partner.buffer is not None:", emission_statements)]
            if self.has_tests
            else emission_statements
        )
        # The conditions reject the only partner that was tried; `join_other` tries the other ones.
        retry = [
            Block(
                f"if {candidate}.older is not {candidate}:",
                [
                    f"match = Match({self.values}, event_start, event_end, None, term, None)",
                    "return join_other(match, key, partner, frame)",
                ],
            )
        ]
        return [
            f"{candidate} = other_newest.get(key)",
            Block(
                f"if {candidate} is not None:",
                [
                    *([] if newest else ["partner = newest.newer"]),
                    *self._interval_assignments(),
                    Block(
                        f"if {self._interval_condition()}:",
                        [
                            self._value_assignment(),
                            *self._test_statements(),
                            *checked_emission,
                            *(retry if self.has_tests else []),
                        ],
                    ),
                    Block(f"elif {candidate}.older is not {candidate}:", [self.general_path]),
                ],
            ),
            *(storing if self.side.stores_unmatched else []),
        ]

    def _join_all(self, storing: List[Statement]) -> List[Statement]:
        """Return statements that take all partners, if there is at most one."""
        emission_statements = self._emit_statements()
        return [
            "partner = other_newest.get(key)",
            Block("if partner is not None and partner.older is not partner:", [self.general_path]),
            *(storing if self.side.stores_unmatched else []),
            Block("if partner is None or partner.buffer is None:", [_RETURN_FRAME]),
            *self._interval_assignments(),
            Block(
                f"if {self._interval_condition()}:",
                [
                    self._value_assignment(),
                    *self._test_statements(),
                    *(
                        [Block("if pair_values is not None:", emission_statements)]
                        if self.has_tests
                        else emission_statements
                    ),
                ],
            ),
        ]

    def _interval_assignments(self) -> List[str]:
        """Return statements that compute the interval of a pair."""
        operator = self.pair.operator
        return [
            f"start = {self._with_instants(operator.start)}",
            f"end = {self._with_instants(operator.end)}",
        ]

    def _interval_condition(self) -> str:
        interval_tests = [
            f"({self._with_instants(comparison)})" for comparison in self.pair.operator.comparisons
        ]
        interval_tests += [] if self.pair.span is None else [f"end - start <= {self.pair.span}"]
        return " and ".join(interval_tests) or "True"

    def _value_assignment(self) -> str:
        """Return the statement that collects the values of the pair."""
        return f"pair_values = {tuple_source([self._value_source(source) for _, source in self.pair.value_sources])}"

    def _with_instants(self, source: str) -> str:
        """Return the source of an operator, with its instants replaced by those of the event and its partner."""
        this_side, other_side = ("1", "2") if self.side.is_left else ("2", "1")
        times = {
            f"s{this_side}": "event_start",
            f"e{this_side}": "event_end",
            f"s{other_side}": "partner.start",
            f"e{other_side}": "partner.end",
        }
        # The names s1, e1, s2 and e2 do not occur in the replacements, so the order is irrelevant.
        for name, expression in times.items():
            source = source.replace(name, expression)
        return source

    def _value_source(self, source: str) -> str:
        """Return the source of a value of the pair; item 0 of an event is its functor."""
        if source[:3] not in ("lv[", "rv["):
            return self._with_instants(source)
        is_left, index = source[0] == "l", int(source[3:-1])
        prefix = "" if is_left == self.side.is_left else "partner."
        return (
            f"{prefix}term[{index + 1}]"
            if self.pair.values_are_arguments[0 if is_left else 1]
            else f"{prefix}values[{index}]"
        )

    def _test_statements(self) -> List[Statement]:
        """Return statements for negations and conditions; they set ``pair_values`` to None if one fails."""
        end_of_first, start_of_second = (
            ("event_end", "partner.start") if self.side.is_left else ("partner.end", "event_start")
        )
        steps: List[Statement] = [
            Block(
                f"if negation{index}(pair_values, {end_of_first}, {start_of_second}):", ["pair_values = None"]
            )
            for index in range(len(self.pair.negation_tests))
        ]
        steps += [
            f"pair_values = test{index}(pair_values, start, end)" for index in range(len(self.pair.tests))
        ]
        return [
            step if index == 0 else Block("if pair_values is not None:", [step])
            for index, step in enumerate(steps)
        ]

    def _emit_statements(self) -> List[Statement]:
        if self.pair.complete is not None:
            return [_RETURN_COMPLETE]
        operands = ["match", "partner"] if self.side.is_left else ["partner", "match"]
        operands += ["ComputedValues(computed_values(pair_values))"] if self.pair.condition_vars else []
        creation = [f"match = Match({self.values}, event_start, event_end, None, term, None)"]
        if self.values_are_arguments:
            creation = ["match = new(EventMatch if event_start is event_end else OrderedEventMatch)"]
            creation += [
                "match.start = event_start",
                "match.end = event_end",
                "match.term = term",
                "match.buffer = None",
            ]
        return [
            *creation,
            f"return emit(Match(pair_values, start, end, None, None, {tuple_source(operands)}), frame)",
        ]
