"""Knowledge base of a program: memories, transforms, pending queries, subscriptions, and event states.

`KnowledgeBase` creates these parts, connects them to each other, and defines the predicates ``memorize``,
``subscribe`` and their counterparts. The engine uses it to clear and inspect all of them.
"""

from operator import attrgetter
from typing import Any, Callable, Iterator, Optional, Sequence, Tuple

from ...foundation.errors import UsageError
from ...prolog.builtins.argument_checks import bound
from ...prolog.machine.errors import type_error
from ...prolog.machine.machine import Machine
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms.term_traversal import variables
from ...prolog.terms.types import Frame, Functor, Term, deref, functor, functor_of
from ..clock.clock import Clock
from ..dispatch.dispatcher import Dispatcher
from ..language.stream_parser import subscription_event
from ..rules.rule_base import RuleBase
from .event_states import StateRegistry
from .memory import UPDATED, MemoryInstance, Warn, key_of
from .memory_interpolation import MemoryGaps, TransformChains
from .memory_registry import (
    CREATED,
    DELETED,
    MemoryInstances,
    define_pattern_access,
    define_read_access,
    enumerate_records,
)
from .pending_queries import TIMEOUT_EVENT, MissingSources, PendingQueries
from .subscriptions import Deliver, Subscriptions
from .transform_buffer import TransformBuffer
from .transform_predicates import Transforms

MEMORIZE = functor("memorize", 5)
SUBSCRIBE = functor("subscribe", 5)
DELETE_MEMORY = functor("delete_memory", 1)

MEMORY_EVENTS = frozenset((CREATED, UPDATED, DELETED))
"""Events about memories."""

SERVICE_CALL = functor("service_call", 3)
SERVICE_REPLY = functor("service_reply", 3)
SERVICE_FAILED = functor("service_failed", 3)

OWN_EVENTS = MEMORY_EVENTS | {TIMEOUT_EVENT, SERVICE_CALL, SERVICE_REPLY, SERVICE_FAILED}
"""All events that the package makes by itself, without a rule, goal or topic."""


class KnowledgeBase:
    """Memories, transforms, pending queries, subscriptions and states of a program.

    Attributes:
        gaps: limits for interpolation.

    Args:
        logic: the system in which the predicates are defined.
        dispatcher: dispatcher of the events that are recorded and delivered.
        clock: stamps events of the clock, and calls alarms for timeouts.
        deliver: receives the events of subscriptions.
        warn: receives warnings as text.
        rules: rules of the program; they check patterns, and call subscriptions that send later.
        warn_unknown_calls: warns of unknown predicates in conditions; takes these and the name of their owner.
    """

    def __init__(
        self,
        logic: PrologSystem,
        dispatcher: Dispatcher,
        clock: Clock,
        deliver: Deliver,
        warn: Warn,
        rules: RuleBase,
        warn_unknown_calls: Callable[[Term, str], None],
        buffer: TransformBuffer,
    ):
        self._logic = logic
        self._dispatcher = dispatcher
        self._rules = rules
        self._warn_unknown_calls = warn_unknown_calls
        self._warn = warn
        # Checked before a memory, subscription or state is made.
        self._check_pattern = rules.declared_events.require_declared
        self.gaps = MemoryGaps(logic.brief, warn)
        self.memories = MemoryInstances(logic, dispatcher, clock.stamp, warn, self.gaps.note_gap)
        self.transforms = Transforms(logic, dispatcher, buffer, self.gaps, warn)
        self.pending_queries = PendingQueries(
            logic, dispatcher, self.memories, self.transforms, warn, clock, rules.network.watermarks
        )
        self.subscriptions = Subscriptions(logic, dispatcher, deliver, warn, rules.network)
        self.states = StateRegistry(
            logic, dispatcher, clock, rules.network.watermarks, warn, self._check_pattern
        )
        self._define_predicates()
        rules.on_reset.add(self.reset)
        logic.undefined_procedures.other_uses.add(self._describe_other_use)

    def _describe_other_use(self, key: Functor) -> str:
        """Return that a name is a state or an event, and how to ask for it; an empty text for other names."""
        for declaration in self.states:
            state = declaration.form.state
            if functor_of(state) is key:
                shown_state = self._logic.brief(state, dict.fromkeys(variables(state), "_"))
                return f"{key} is a state: call holds({shown_state})"
        heads = (functor_of(rule.definition.head) for rule in self._rules.rules if rule.definition.head)
        events = dict.fromkeys([*self._dispatcher.listened_functors(), *heads])
        # Also with another number of arguments: a predicate with a similar name is less probable.
        event = (
            key
            if key in events
            else next((other for other in events if other and other.name == key.name), None)
        )
        if event is None:
            return ""
        advice = "record it by memorize/5 and call access_mem/3, or declare a state and call holds/1"
        for instance in self.memories:
            definition: Any = instance.definition
            if functor_of(definition[1]) is event:
                name = self._logic.brief(instance.id)
                advice = f"memory {name} records it, so call access_mem({name},Record,[T1,T2])"
                break
        return f"{event} is an event, and events are not facts: {advice}"

    def clear(self) -> None:
        """Remove records, pending queries and states, because the clock went back; definitions remain."""
        self.memories.clear()
        self.gaps.clear()
        self.transforms.clear()
        self.pending_queries.clear()
        self.subscriptions.clear()
        self.states.clear()

    def return_to(self, instant: int) -> None:
        """Remove what is ahead of an instant, because the clock had followed a wrong timestamp."""
        max_timestamp = self._rules.network.compute_max_timestamp()
        self.memories.drop_after(max_timestamp)
        self.states.drop_after(max_timestamp)
        self.subscriptions.return_to(instant)

    def reset(self, includes_past: bool) -> None:
        """Remove what has begun and not ended, as rules remove partial matches, and on request past states."""
        self.subscriptions.clear()
        self.states.close(includes_past)

    def find_missing_memories(self, names: Sequence[Term], instant: int) -> MissingSources:
        """Return the memories that have received no event that ends at an instant or later.

        A name ``tf(Target, Source)`` stands for a transform.

        Raises:
            UsageError: if there is no such memory.
        """
        missing = {}
        for name in names:
            instance = self.memories.find(name) or self.transforms.awaited_transform(name)
            if instance is None:
                raise UsageError(f"there is no memory {self._logic.brief(name)}")
            if not instance.has_reached(instant):
                missing[instance] = instant
        return list(missing.items())

    def patterns(self) -> Iterator[Tuple[Term, str]]:
        """Yield the pattern of each memory, subscription and state, and its name for reports."""
        for instance in self.memories:
            yield instance.recorder.pattern, f"memory {self._logic.show(instance.id)}"
        for pattern, (topic, _) in self.subscriptions.patterns():
            yield pattern, f"a subscription of topic {topic}"
        for state in self.states:
            yield state.form.begin_event, state.name
            yield state.form.end_event, state.name

    def _define_predicates(self) -> None:
        logic = self._logic
        define_read_access(logic, self.memories)
        define_pattern_access(logic, self.memories)
        self.gaps.define_predicates(logic, self.memories)
        TransformChains(self.memories, self.gaps).define_predicates(logic)
        logic.define_nondeterministic("access_mem", 3, enumerate_records(self.memories))
        self._define_size_predicate("memory_size", attrgetter("memory.size"))
        self._define_size_predicate("memory_counter", attrgetter("memory.added_count"))
        logic.define_control("memorize", 5, self._memorize_action(True))
        logic.define_control("memorize_diactive", 5, self._memorize_action(False))
        logic.define_control("memorize", 6, self._memorize_by_flag)
        logic.define_control("delete_memory", 1, self._delete_memory)
        logic.define("subscribe", 5, self._subscribe)
        logic.define("delete_subscription", 2, self._delete_subscription)

    def _memorize_action(self, active: bool) -> Callable[[Machine, Sequence[Term], Frame], Frame]:
        def memorize(machine: Machine, arguments: Sequence[Term], frame: Frame) -> Frame:
            return self._create_memory(arguments, active, frame)

        return memorize

    def _create_memory(self, arguments: Sequence[Term], active: bool, frame: Frame) -> Frame:
        # Checks run before the memory is created, so an error leaves no memory behind.
        self._check_pattern(arguments[0])
        next_frame = self.memories.create((MEMORIZE, *arguments), active, frame)
        self._warn_unknown_calls(arguments[1], f"memory {self._logic.brief(arguments[3])}")
        return next_frame

    def _memorize_by_flag(self, machine: Machine, arguments: Sequence[Term], frame: Frame) -> Frame:
        active = bound(arguments[5])
        if active not in (0, 1):
            raise type_error("boolean", active)
        return self._create_memory(arguments[:5], active == 1, frame)

    def _delete_memory(self, machine: Machine, arguments: Sequence[Term], frame: Frame) -> Frame:
        key_of(arguments[0])
        try:
            return self.memories.delete(arguments[0], frame)
        except UsageError as error:  # the goal succeeds, as in the original Retalis
            self._warn(str(error))
            return frame

    def _subscribe(self, machine: Machine, *arguments: Term) -> bool:
        self._check_pattern(subscription_event(arguments[0]))
        self.subscriptions.create((SUBSCRIBE, *arguments))
        self._warn_unknown_calls(arguments[1], f"subscription {self._logic.brief(arguments[4])}")
        return True

    def _delete_subscription(self, machine: Machine, topic: Term, name: Term) -> bool:
        if not self.subscriptions.delete(topic, name):
            show = self._logic.brief
            self._warn(f"there is no subscription {show(deref(name))} of topic {show(deref(topic))}")
        return True

    def _define_size_predicate(self, name: str, get_size: Callable[[MemoryInstance], int]) -> None:
        """Define a predicate of a memory's id and a number."""
        find, read_all = self.memories.find, self.memories.read_all

        def read_size(name: Term) -> Optional[int]:
            instance = find(name)
            return None if instance is None else get_size(instance)

        def enumerate_sizes(machine: Machine, name: Term, value: Term) -> Iterator[bool]:
            for instance in read_all():
                if machine.unify_all((name, instance.id), (value, get_size(instance))):
                    yield True

        self._logic.define_nondeterministic(name, 2, enumerate_sizes, read_size)
