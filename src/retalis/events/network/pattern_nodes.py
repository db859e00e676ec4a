"""What tells the matches of a node apart, beside the events that they are made of.

A value that a goal, a repetition or an aggregate has given may still be open when it is found, and get its value
from an event further up: two matches are of the same term only if it is the same in the end.

Nodes of the network: what runs for each part of a rule's pattern.

A node takes matches from the nodes below it and emits its own to ``out``; both take a match and the next
frame and return the frame to go on with. `NetworkNode.bind` connects them for a policy, from the root down.
"""

from operator import itemgetter
from typing import (
    TYPE_CHECKING,
    AbstractSet,
    Any,
    Callable,
    Dict,
    FrozenSet,
    Hashable,
    List,
    Optional,
    Sequence,
    Set,
    Tuple,
    Union,
)

from ...prolog.terms.term_traversal import positions, term_key, variables
from ...prolog.terms.types import EventAction, Frame, Term, Values, Var
from ..dispatch.discrimination_tree import takes_all
from ..fused.fused_actions import Continuation
from ..language.pattern_tree import Aggregate, Either, Pattern, Star, Windowed, children, own_terms
from ..matches.consumption_policy import Emit
from ..matches.negation import NegationBuffer, RuledOutSweep
from ..matches.partial_matches import Found, Named, NetworkOptions, PartialMatch, identity
from .goal_evaluation import Buffer, RuleGoal, Test

if TYPE_CHECKING:
    from .event_rule import EventRule


Name = Callable[[PartialMatch], Hashable]


class MatchKeys:
    """Names the matches of the patterns of one rule.

    Args:
        shared: the variables that stand in the rule more than once.

    Attributes:
        carried: the variables of the rule that are carried on from node to node.
    """

    def __init__(self, shared: AbstractSet[Var]):
        self.carried: Set[Var] = set(shared)
        self._given: Dict[int, FrozenSet[Var]] = {}

    def name(self, names: Sequence[Var], pattern: Pattern) -> Name:
        """Return what names the matches of a pattern, given the variables whose values they carry."""
        carried = [(at, var) for at, var in enumerate(names) if var in self.carried]
        return naming([at for at, var in carried if var not in self._by_events(pattern)])

    def _by_events(self, pattern: Pattern) -> FrozenSet[Var]:
        """Return the variables that the events of a match always give values to; those of a part are kept."""
        found = self._given.get(id(pattern))
        if found is None:
            found = self._given[id(pattern)] = self._given_by(pattern)
        return found

    def _given_by(self, pattern: Pattern) -> FrozenSet[Var]:
        if isinstance(pattern, (Star, Aggregate)):
            return self._by_events(pattern.first)
        if isinstance(pattern, Windowed):
            return frozenset()
        below = [self._by_events(child) for child in children(pattern, False)]
        if isinstance(pattern, Either):
            return frozenset.intersection(*below)
        if not below:
            return frozenset(var for term in own_terms(pattern) for var in variables(term))
        return frozenset().union(*below)


def naming(positions: List[int]) -> Name:
    """Return what names matches by their events and by their values at some positions."""
    if not positions:
        return identity
    return lambda match: Named(identity(match), tuple([term_key(match.values[at]) for at in positions]))


def found_here(names: Sequence[Var], known: int, carried: AbstractSet[Var]) -> Callable[[Values], Values]:
    """Return what takes the values that a node has found itself and does not carry on; see `Found`.

    Args:
        names: the variables of its values.
        known: how many of them it was given.
        carried: the variables that are carried on, and named where a match waits.
    """
    at = [place for place in range(known, len(names)) if names[place] not in carried]
    if len(at) == len(names) - known:
        return itemgetter(slice(known, None))
    return lambda values: tuple([values[place] for place in at])


Fuse = Callable[[EventAction], EventAction]
"""Makes a fused action of the plain one; see `Audience.listen`."""


class NetworkNode:
    """One part of a rule's pattern.

    Attributes:
        place: among the nodes of the rule: it is after those below it.
        vars: whose values its matches carry, in their order.
        limit: how many nanoseconds a match below can be a part of; None for no bound.
    """

    vars: List[Var]
    place = 0
    windowed = True
    """Whether the window of a label is tested here."""
    alone = False
    """Whether the pattern is one event, with conditions and goals: it needs no matches, only values."""
    forbids = False
    """Whether it is part of what must not happen: no match skips that."""

    def bind(self, out: Emit, mode: NetworkOptions) -> None:
        """Send matches to ``out`` from now on, by the policy and flags of ``mode``; what waits stays."""
        raise NotImplementedError

    def bind_alone(self, completion: Continuation) -> None:
        """Send values to ``completion`` from now on, without making matches; for nodes that are `alone`."""
        raise NotImplementedError

    def buffers(self) -> Sequence[Buffer]:
        """Return where matches wait in this node itself."""
        return ()

    def set_span(self, span: Optional[int], limit: Optional[int]) -> None:
        """Set the longest interval of this node's matches, and how long those that wait can be of use."""

    def sweeps(self, mode: NetworkOptions) -> Sequence[RuledOutSweep]:
        """Return what drops matches of the node that can hardly complete, when there are many."""
        return ()

    def clear(self) -> None:
        """Forget what the node itself knows of the past."""

    def mend(self) -> None:
        """Put right what an interrupt may have left half done in the node itself."""

    def held(self) -> int:
        """Return how many matches are held in the node itself, beside those that wait in buffers."""
        return 0

    def keys(self) -> int:
        """Return the number of keys that have a state in the node itself."""
        return 0

    def bytes(self) -> int:
        """Return an estimate of the memory of what is held in the node itself."""
        return 0

    def kept(self) -> Any:
        """Return what the node itself knows beside what waits in its buffers; see `restore`."""

    def restore(self, kept: Any) -> None:
        """Know, newly connected, what another node knew that is the same; what waits is put back after that."""


class EventNode(NetworkNode):
    """Waits for events that unify with a term.

    Attributes:
        whole: whether all events of its functor do, and the values are their arguments.
    """

    def __init__(self, rule: "EventRule", term: Term):
        self.rule = rule
        self.term = term
        self.alone = True
        self.whole = takes_all(term)
        self.rank = 0
        self.vars = variables(term)

    def bind(self, out: Emit, mode: NetworkOptions, fuse: Optional[Fuse] = None) -> None:
        """Listen; the token of an event is asked for only where something looks at it.

        Args:
            out: where its matches go.
            mode: how the network runs.
            fuse: makes a fused action of the plain one; None where there is none.
        """
        rule = self.rule
        token = rule.network.dispatcher.token

        def arrive(term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
            return out(PartialMatch(values, start, end, None, term, None), after)

        def arrive_timed(term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
            rule.tick(end)
            return out(PartialMatch(values, start, end, None, term, None), after)

        def arrive_known(term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
            event = token()
            if rule.later:
                rule.add_those_of_other_events(event)
            if rule.timed:
                rule.tick(end)
            return out(PartialMatch(values, start, end, event, term, None), after)

        def arrive_unskipped(term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
            event = token()
            rule.add_those_of_other_events(event)
            if rule.timed:
                rule.tick(end)
            return out(PartialMatch(values, start, end, event, term, None), after) if takes(start) else after

        known = rule.double or mode.tracked
        if rule.skipping is None:
            plain = arrive_known if known else arrive_timed if rule.timed else arrive
            if fuse is None:
                rule.listen(self, plain)
            else:
                rule.listen(self, fuse(plain), fused=True)
        else:
            takes = (lambda start: True) if self.forbids else rule.skipping.takes
            rule.listen(self, arrive_unskipped)

    def bind_alone(self, completion: Continuation) -> None:
        """Listen for a rule whose pattern is one event; see `NetworkNode.alone`."""
        self.rule.listen(self, completion.action, completion.fused)


class FilterNode(NetworkNode):
    """Lets through what passes tests: conditions on an event, an ``or``, or what an action has left."""

    def __init__(
        self, child: NetworkNode, names: Sequence[Var], tests: Sequence[Test], keep: AbstractSet[Var]
    ):
        self.child = child
        self.keep = keep
        self.alone = child.alone
        self.windowed = False
        self.vars = list(names)
        self.tests = list(tests)
        self.span: Optional[int] = None

    def set_span(self, span: Optional[int], limit: Optional[int]) -> None:
        """Set the bounds; see `NetworkNode.set_span`."""
        self.span = span

    def bind(self, out: Emit, mode: NetworkOptions) -> None:
        """Connect the node; see `NetworkNode.bind`."""
        tests = self.tests
        span = self.span
        own = found_here(self.vars, len(self.child.vars), self.keep)

        def arrive(match: PartialMatch, after: Frame) -> Frame:
            start = match.start
            end = match.end
            if span is not None and end - start > span:
                return after
            values: Any = match.values
            for test in tests:
                values = test(values, start, end)
                if values is None:
                    return after
            if values is not match.values:
                match = PartialMatch(values, start, end, match.event, None, (match, Found(own(values))))
            return out(match, after)

        self.child.bind(arrive, mode)

    def bind_alone(self, completion: Continuation) -> None:
        """Connect the node; see `NetworkNode.bind_alone`."""
        complete = completion.action
        tests = self.tests
        span = self.span

        def arrive(term: Term, values: Any, start: int, end: int, after: Frame) -> Frame:
            if span is not None and end - start > span:
                return after
            for test in tests:
                values = test(values, start, end)
                if values is None:
                    return after
            return complete(term, values, start, end, after)

        self.child.bind_alone(Continuation(arrive))


class BindNode(NetworkNode):
    """Adds the interval of a match to its values, for a condition that is tested further up."""

    def __init__(self, child: NetworkNode, start: Var, end: Var):
        self.child = child
        self.vars = [*child.vars, start, end]

    def bind(self, out: Emit, mode: NetworkOptions) -> None:
        """Connect the node; see `NetworkNode.bind`."""

        def arrive(match: PartialMatch, after: Frame) -> Frame:
            values = (*match.values, match.start, match.end)
            return out(PartialMatch(values, match.start, match.end, match.event, None, (match,)), after)

        self.child.bind(arrive, mode)


class OrNode(NetworkNode):
    """Emits what any of its branches emits; variables of the other branches are left open."""

    def __init__(self, children: Sequence[NetworkNode], keep: AbstractSet[Var]):
        self.children = children
        found: Dict[Var, None] = {}
        for child in children:
            for var in child.vars:
                if var in keep:
                    found.setdefault(var)
        self.vars = list(found)

    def bind(self, out: Emit, mode: NetworkOptions) -> None:
        """Connect the node; see `NetworkNode.bind`."""
        for index, child in enumerate(self.children):
            child.bind(self._branch(index, child, out), mode)

    def _branch(self, index: int, child: NetworkNode, out: Emit) -> Emit:
        places = positions(child.vars)
        layout = [places.get(var) for var in self.vars]

        def arrive(match: PartialMatch, after: Frame) -> Frame:
            values = match.values
            laid = tuple([Var() if at is None else values[at] for at in layout])
            return out(PartialMatch(laid, match.start, match.end, match.event, None, (index, match)), after)

        return arrive


class ActionNode(NetworkNode):
    """Calls a goal for each match: once, or for all of its solutions.

    Attributes:
        lets: tells by its start whether a match may fire, for the first that is called when all is matched; or None.
    """

    def __init__(self, child: NetworkNode, call: RuleGoal, every: bool, keep: AbstractSet[Var]):
        self.child = child
        self.keep = keep
        self.alone = child.alone
        self.windowed = False
        self.call = call
        self.every = every
        self.lets: Optional[Callable[[int], bool]] = None
        self.vars = list(call.result_vars)
        self.span: Optional[int] = None

    def set_span(self, span: Optional[int], limit: Optional[int]) -> None:
        """Set the bounds; see `NetworkNode.set_span`."""
        self.span = span

    def bind(self, out: Emit, mode: NetworkOptions) -> None:
        """Connect the node; see `NetworkNode.bind`."""
        call = self.call
        act = call.act_on_all if self.every else call.act
        tracked = mode.tracked
        span = self.span
        own = found_here(self.vars, len(self.child.vars), self.keep)
        is_of_ground = call.rule.network.dispatcher.is_of_ground

        def arrive(match: PartialMatch, after: Frame) -> Frame:
            if span is not None and match.end - match.start > span:
                return after

            def solved(term: Term, values: Values, start: int, end: int, then: Frame) -> Frame:
                return out(
                    PartialMatch(values, start, end, match.event, None, (match, Found(own(values)))), then
                )

            done = call.noting_cause(match, solved, after) if tracked else (solved, after)
            return act(match.term, match.values, match.start, match.end, is_of_ground(match), *done)

        lets = self.lets
        self.child.bind(
            arrive
            if lets is None
            else lambda match, after: arrive(match, after) if lets(match.start) else after,
            mode,
        )

    def bind_alone(self, completion: Continuation) -> None:
        """Connect the node; see `NetworkNode.bind_alone`."""
        call = self.call
        act = call.act_on_all if self.every else call.act
        complete = completion.action
        span = self.span
        # Values of conditions and goals below may have variables where the event has none.
        only_of_event = isinstance(self.child, EventNode)
        dispatcher = call.rule.network.dispatcher

        def arrive(term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
            return act(term, values, start, end, only_of_event and dispatcher.ground(), complete, after)

        done = call.alone(completion) if only_of_event and not self.every else Continuation(arrive)
        once = done.action

        def arrive_in_span(term: Term, values: Values, start: int, end: int, after: Frame) -> Frame:
            if span is not None and end - start > span:
                return after
            return once(term, values, start, end, after)

        self.child.bind_alone(done if span is None else Continuation(arrive_in_span))


class NotNode(NetworkNode):
    """Lets a match through if no event of another kind ended before it started."""

    def __init__(self, rule: "EventRule", child: NetworkNode, negated: NetworkNode, absence: NegationBuffer):
        self.child = child
        self.negated = negated
        self.absence = absence
        self.rule = rule
        self.vars = child.vars

    def bind(self, out: Emit, mode: NetworkOptions) -> None:
        """Connect the node; see `NetworkNode.bind`."""
        absence = self.absence
        tracker = self.rule.network.tracker
        tracked = mode.tracked

        def arrive(match: PartialMatch, after: Frame) -> Frame:
            if absence.blocks(match.values, match.start, match.start):
                if tracked:
                    tracker.suppressed(self, match)
                return after
            return out(match, after)

        self.retry = _unskipped(self, arrive)
        self.child.bind(arrive, mode)
        absence.bind(self.negated, mode)

    def buffers(self) -> Sequence[Buffer]:
        """Return where matches wait."""
        return self.absence.buffers()


class EarlyTestNode(NetworkNode):
    """Tests an absence above a match for which all is known that it looks at; others go on, to be tested further up.

    Attributes:
        test: the test; see `early_test`.
        carried: the absences that are looked at, with the nodes of what they negate.
    """

    test: Test

    def __init__(self, rule: "EventRule", child: NetworkNode):
        self.rule = rule
        self.child = child
        self.carried: List[Tuple[NegationBuffer, NetworkNode]] = []
        self.vars = child.vars

    def bind(self, out: Emit, mode: NetworkOptions) -> None:
        """Connect the node; see `NetworkNode.bind`."""
        tracker, tracked, test = self.rule.network.tracker, mode.tracked, self.test

        def arrive(match: PartialMatch, after: Frame) -> Frame:
            values = test(match.values, match.start, match.end)
            if values is None:
                if tracked:
                    tracker.suppressed(self, match)
                return after
            tested = match
            if values is not match.values:
                tested = PartialMatch(values, match.start, match.end, match.event, None, (match,))
            return out(tested, after)

        self.retry = _unskipped(self, arrive)
        self.child.bind(arrive, mode)
        for absence, negated in self.carried:
            absence.bind(negated, mode)

    def buffers(self) -> Sequence[Buffer]:
        """Return where matches wait."""
        return [buffer for absence, _ in self.carried for buffer in absence.buffers()]


def _unskipped(node: Union[NotNode, EarlyTestNode], emit: Emit) -> Emit:
    """Return what takes those matches of a node that were suppressed and that no other has skipped since."""
    skipping = node.rule.skipping
    if skipping is None or node.forbids:
        return emit
    return lambda match, after: emit(match, after) if skipping.takes(match.start) else after
