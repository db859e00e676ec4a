"""Transforms of a program: predicates that read the transform buffer, and queries that wait for transforms.

``tf_lookup/4`` and ``tf_transform/5`` return the transform between any two frames of the tree, and fail if it is not
available; ``tf_missing/4`` returns the reason. The flag ``max_gap`` limits the distance of samples that are
interpolated.

The condition ``[tf(Target, Source), Time]`` of a synchronized query is an `AwaitedTransform`. It is fulfilled as soon
as each frame of the path between the two frames in the tree has a sample at the instant or later. Until then it is
registered with one frame that has none (`TransformBuffer.find_blocking`), so a transform costs one comparison for any
number of pending queries. When that frame gets the sample, the condition is registered with the next frame of the
path. If a frame gets its first sample or another parent, all conditions are registered again.

The engine does not know topics. The node or the bag player passes a function that subscribes to the transform topics
to `Transforms.add_feed`. It is called when the program first uses transforms; other programs do not receive these
topics.
"""

from typing import Any, Callable, Dict, Hashable, Iterable, List, Optional, Sequence, Set, Tuple

from ...foundation.callbacks import CallbackList
from ...foundation.errors import UsageError
from ...foundation.similar_names import closest_name
from ...prolog.builtins.pose_predicates import compose, lazy_pose_term, parse_pose
from ...prolog.builtins.tabling import tables_of
from ...prolog.builtins.time_predicates import instant_of
from ...prolog.machine.errors import instantiation_error, permission_error, type_error
from ...prolog.machine.machine import Machine
from ...prolog.system.prolog_system import PrologSystem
from ...prolog.terms import timestamps
from ...prolog.terms.list_terms import list_items
from ...prolog.terms.timestamps import SECOND
from ...prolog.terms.types import CONS, NIL, Atom, Frame, Functor, String, Term, Var, atom, deref, functor
from ..dispatch.dispatcher import Dispatcher
from ..language.rule_heads import SYNCHRONIZED
from .memory import QueryEntry, Warn
from .memory_interpolation import UNLIMITED_GAP, MemoryGaps
from .transform_buffer import REPEATED, CoordinateFrame, Numbers, Transform, TransformBuffer

TF: Functor = functor("tf", 2)
"""Functor of a condition's transform, ``tf(Target, Source)``."""

TRANSFORM_PREDICATES = frozenset(
    (functor("tf_lookup", 4), functor("tf_transform", 5), functor("tf_missing", 4))
)
"""Predicates that read transforms."""

_MAX_CACHED_NAMES = 10_000
_MAX_REPORTED_FRAMES = 100
_UNKNOWN, _INVALID, _LOOP = functor("unknown", 1), functor("invalid", 1), functor("loop", 1)
_UNCONNECTED, _BEFORE, _AFTER, _GAP = (functor(name, 2) for name in ("unconnected", "before", "after", "gap"))
_REASON_FUNCTORS = {
    "unknown": _UNKNOWN,
    "invalid": _INVALID,
    "loop": _LOOP,
    "before": _BEFORE,
    "after": _AFTER,
}


class AwaitedTransform:
    """The transform of a condition ``[tf(Target, Source), Time]``, with the queries that wait for it.

    Attributes:
        id: the term ``tf(Target, Source)``.
        target: name of the target frame.
        source: name of the source frame.
        queries: pending queries by instant and order.
        frames: the frames whose next samples the queries wait for, by instant.
    """

    __slots__ = ("id", "target", "source", "queries", "frames", "_transforms")

    def __init__(self, transforms: "Transforms", transform_term: Term, target: str, source: str):
        self._transforms = transforms
        self.id = transform_term
        self.target = target
        self.source = source
        self.queries: Dict[int, Dict[Any, QueryEntry]] = {}
        self.frames: Dict[int, CoordinateFrame] = {}

    def has_reached(self, instant: int) -> bool:
        """Return whether all frames of the path between the two have samples at an instant or later."""
        return self._transforms.buffer.find_blocking(self.target, self.source, instant) is None

    @property
    def latest_end(self) -> Optional[int]:
        """The newest instant that all frames of the path have reached; None if they are not connected."""
        latest = self._transforms.buffer.latest_common(self.target, self.source)
        return latest if isinstance(latest, int) else None

    def blocking_frame(self, instant: int) -> str:
        """Return the name of the frame whose next sample the query awaits; "" without a path between the two."""
        frame = self._transforms.buffer.find_blocking(self.target, self.source, instant)
        return "" if frame is None else frame.name

    def add_query(self, instant: int, order: int, query: QueryEntry) -> None:
        """Store a query under its order until the instant is reached."""
        queries_by_order = self.queries.setdefault(instant, {})
        queries_by_order[order] = query
        if instant not in self.frames:
            self._transforms.register(self, instant)

    def remove_query(self, instant: int, order: int) -> None:
        """Remove a query."""
        queries_by_order = self.queries[instant]
        del queries_by_order[order]
        if not queries_by_order:
            del self.queries[instant]
            self._transforms.unregister(self, instant)

    def pop_queries(self, instant: int) -> List[QueryEntry]:
        """Remove and return the queries that wait for an instant, which has been reached."""
        return list(self.queries.pop(instant, {}).values())


AwaitedCondition = Tuple[AwaitedTransform, int]
"""A transform that queries wait for, and its instant; the entry of a frame's queue."""

ReachedTransforms = List[AwaitedCondition]
"""Transforms that have become available, with their instants."""


class Transforms:
    """The transform buffer of a program, with its predicates and waiting queries.

    Args:
        logic: the system in which the predicates are defined.
        dispatcher: dispatcher of the events that waiting queries trigger.
        gaps: limit for the time between two samples.
        warn: receives warnings about refused transforms and unknown frames.

    Attributes:
        is_required: whether the program reads transforms.
        on_reached: called with the transforms that have become available and the next frame; each returns the frame
            that calls the queries first.
    """

    def __init__(
        self,
        logic: PrologSystem,
        dispatcher: Dispatcher,
        buffer: TransformBuffer,
        gaps: MemoryGaps,
        warn: Warn,
    ):
        self._logic = logic
        self._dispatcher = dispatcher
        self.buffer = buffer
        self._gaps = gaps
        self._warn = warn
        self.is_required = False
        self._feeds: CallbackList[Callable[[], object]] = CallbackList()
        self._frame_names: Dict[Term, str] = {}
        self._reported_frames: Set[str] = set()
        self._transforms_by_frames: Dict[Tuple[str, str], AwaitedTransform] = {}
        self._awaited_transforms: Dict[AwaitedTransform, None] = {}
        self._seen_topology_version = 0
        self._tables = tables_of(logic.machine)
        self._active_tables = self._tables.active
        self.on_reached: CallbackList[Callable[[ReachedTransforms, Frame], Frame]] = CallbackList()
        self._define_lookups()
        logic.define_function("tf_missing", 4, self._find_missing_reason)
        logic.define_control("tf_add", 4, self._add_dynamic)
        logic.define_control("tf_add_static", 3, self._add_static)

    # ---- topics --------------------------------------------------------------------------------------

    def add_feed(self, start_feed: Callable[[], object]) -> None:
        """Add a function that starts to feed the buffer; it is called once, when the program needs transforms."""
        self._feeds.add(start_feed)
        if self.is_required:
            start_feed()

    def require(self) -> None:
        """Record that the program reads transforms, and start the feed."""
        if not self.is_required:
            self.is_required = True
            for start_feed in self._feeds:
                start_feed()

    def require_if_mentioned(self, terms: Iterable[Term]) -> None:
        """Start the feed if one of the given terms refers to transforms."""
        if not self.is_required and _mentions_transforms(terms):
            self.require()

    # ---- input ---------------------------------------------------------------------------------------

    def store_message(self, transforms: Sequence[Transform], is_static: bool) -> None:
        """Store the transforms of a message, and call the queries that waited for them."""
        reached = self._store(transforms, is_static)
        if reached:
            machine = self._logic.machine
            # The queries are not caused by the current event, if there is one.
            self._dispatcher.run_without_context(
                lambda: machine.run(self._process_reached(reached, machine.done))
            )

    def _store(self, transforms: Iterable[Transform], is_static: bool) -> ReachedTransforms:
        """Store transforms; return those that queries wait for and that are available now."""
        reached: ReachedTransforms = []
        store = self.buffer.store
        for parent, child, instant, numbers in transforms:
            result: Any = store(parent, child, instant, numbers, is_static)
            if result.__class__ is not str:
                if result.next_instant <= instant:
                    reached += self._advance_conditions(result.pop_reached(instant))
            elif result is not REPEATED:
                self._warn(f"the transform of frame '{child[:80]}' is refused: {result}", ("tf", child))
        if self.buffer.topology_version != self._seen_topology_version:
            self._seen_topology_version = self.buffer.topology_version
            if self._awaited_transforms:
                reached += self._register_all_again()
        return reached

    def _advance_conditions(self, entries: Iterable[AwaitedCondition]) -> ReachedTransforms:
        """Register conditions with the next frame of their path; return those that are fulfilled."""
        reached: ReachedTransforms = []
        for awaited, instant in entries:
            frame = self.buffer.find_blocking(awaited.target, awaited.source, instant)
            if frame is not None:
                frame.add_query(instant, awaited, (awaited, instant))
                awaited.frames[instant] = frame
            else:
                self._drop_registration(awaited, instant)
                reached.append((awaited, instant))
        return reached

    def _register_all_again(self) -> ReachedTransforms:
        """Register all conditions again, because the tree has changed; return those that are fulfilled."""
        entries: List[AwaitedCondition] = []
        for awaited in self._awaited_transforms:
            for instant, frame in awaited.frames.items():
                frame.remove_query(instant, awaited)
                entries.append((awaited, instant))
        return self._advance_conditions(entries)

    def register(self, awaited: AwaitedTransform, instant: int) -> None:
        """Register a condition with a frame that has not reached the instant."""
        frame = self.buffer.find_blocking(awaited.target, awaited.source, instant)
        if frame is None:
            # All frames have reached the instant: the next transform calls the queries.
            frame = self.buffer.topology
            self._seen_topology_version = -1
        frame.add_query(instant, awaited, (awaited, instant))
        awaited.frames[instant] = frame
        self._awaited_transforms[awaited] = None

    def unregister(self, awaited: AwaitedTransform, instant: int) -> None:
        """Remove the registration of a condition."""
        awaited.frames[instant].remove_query(instant, awaited)
        self._drop_registration(awaited, instant)

    def _drop_registration(self, awaited: AwaitedTransform, instant: int) -> None:
        del awaited.frames[instant]
        if not awaited.frames:
            del self._awaited_transforms[awaited]

    def clear(self) -> None:
        """Drop the samples, because the clock went back; static transforms remain."""
        self.buffer.clear()
        self.clear_queries()

    def clear_queries(self) -> None:
        """Remove all waiting queries."""
        for awaited in self._awaited_transforms:
            awaited.queries.clear()
            awaited.frames.clear()
        self._awaited_transforms.clear()
        self.buffer.topology.clear_queries()
        for frame in self.buffer.frames():
            frame.clear_queries()

    # ---- conditions ----------------------------------------------------------------------------------

    def awaited_transform(self, term: Term) -> Optional[AwaitedTransform]:
        """Return the transform of a term ``tf(Target, Source)``; None for other terms.

        Raises:
            UsageError: if a frame is neither an atom nor a string.
        """
        transform_term: Any = deref(term)
        if transform_term.__class__ is not tuple or transform_term[0] is not TF:
            return None
        self.require()
        try:
            target, source = self._frame_name(transform_term[1]), self._frame_name(transform_term[2])
        except Exception as error:
            raise UsageError(f"expected tf(Target, Source) with names of frames: {error}") from None
        awaited = self._transforms_by_frames.get((target, source))
        if awaited is None:
            if len(self._transforms_by_frames) >= _MAX_CACHED_NAMES:
                self._transforms_by_frames.clear()
            awaited = self._transforms_by_frames[target, source] = AwaitedTransform(
                self, (TF, atom(target), atom(source)), target, source
            )
        return awaited

    # ---- predicates ----------------------------------------------------------------------------------

    def version(self, part: Hashable) -> int:
        """Return a value that changes with the transforms, for incremental tables; ``part`` is ignored."""
        return self.buffer.version

    def _define_lookups(self) -> None:  # noqa: C901 - the closures
        """Define ``tf_lookup/4`` and ``tf_transform/5``.

        They are closures, because attributes and further calls would take a fifth of the time of a look-up.
        """
        frame_names, lookup, gaps, active_tables = (
            self._frame_names,
            self.buffer.lookup,
            self._gaps,
            self._active_tables,
        )

        def find_pose(target: Term, source: Term, time: Any) -> Any:
            try:
                target_name, source_name = frame_names[target], frame_names[source]
                # A time of a message, ``[Sec,NSec]``.
                first_functor, seconds, (second_functor, nanoseconds, end) = time
            except (KeyError, TypeError, ValueError):
                target_name, source_name = self._frame_name(target), self._frame_name(source)
                instant = instant_of(time)
            else:
                is_ros_time = first_functor is second_functor is CONS and end is NIL
                if is_ros_time and seconds.__class__ is nanoseconds.__class__ is int:
                    instant = seconds * SECOND + nanoseconds
                else:
                    instant = instant_of(time)
            if not self.is_required:
                self.require()
            if active_tables:
                self._tables.record_read(self.version, None)
            pose_in_target = lookup(target_name, source_name, instant)
            if pose_in_target is None:
                self._report_unknown(target_name, source_name)
            elif gaps.max_distance != UNLIMITED_GAP and self._find_gap_reason(
                target_name, source_name, instant
            ):
                return None
            return pose_in_target

        def look_up_pose(target: Term, source: Term, time: Term) -> Optional[Term]:
            """Return the pose of the source frame in the target frame."""
            source_pose = find_pose(target, source, time)
            return None if source_pose is None else lazy_pose_term(source_pose)

        def transform_pose(pose_term: Term, source: Term, target: Term, time: Term) -> Optional[Term]:
            """Return a pose, given in the source frame, in the target frame."""
            source_pose = find_pose(target, source, time)
            return (
                None if source_pose is None else lazy_pose_term(compose(source_pose, parse_pose(pose_term)))
            )

        self._logic.define_function("tf_lookup", 4, look_up_pose)
        self._logic.define_function("tf_transform", 5, transform_pose)

    def _find_missing_reason(self, target: Term, source: Term, time: Term) -> Optional[Term]:
        """Return the reason why there is no pose; None if there is one."""
        target_name, source_name = self._frame_name(target), self._frame_name(source)
        self.require()
        if self._active_tables:
            self._tables.record_read(self.version, None)
        instant = int(instant_of(time))
        fault = self.buffer.find_fault(target_name, source_name, instant)
        if fault is None:
            return self._find_gap_reason(target_name, source_name, instant)
        if fault.kind == "unconnected":
            return (_UNCONNECTED, atom(fault.frame), atom(fault.other_frame))
        key = _REASON_FUNCTORS[fault.kind]
        if key.arity == 1:
            return (key, atom(fault.frame))
        return (
            key,
            atom(fault.frame),
            atom("none") if fault.instant is None else timestamps.lazy_term(fault.instant),
        )

    def _find_gap_reason(self, target: str, source: str, instant: int) -> Optional[Term]:
        """Return ``gap(Frame, Seconds)`` if the samples of a frame are further apart than is allowed."""
        distance, frame = self.buffer.widest_gap(target, source, instant)
        return (_GAP, atom(frame), distance / SECOND) if distance > self._gaps.max_distance else None

    def _add_dynamic(self, machine: Machine, arguments: Sequence[Term], next_frame: Frame) -> Frame:
        parent, child, time, pose_term = arguments
        return self._add_transform(parent, child, int(instant_of(time)), pose_term, False, next_frame)

    def _add_static(self, machine: Machine, arguments: Sequence[Term], next_frame: Frame) -> Frame:
        parent, child, pose_term = arguments
        return self._add_transform(parent, child, 0, pose_term, True, next_frame)

    def _add_transform(
        self, parent: Term, child: Term, instant: int, pose_term: Term, is_static: bool, next_frame: Frame
    ) -> Frame:
        """Store one transform; return the frame that first calls the queries that waited for it."""
        position, rotation = parse_pose(pose_term)
        x, y, z, qx, qy, qz, qw = map(float, (*position, *rotation))
        numbers: Numbers = x, y, z, qx, qy, qz, qw
        names = self._frame_name(parent), self._frame_name(child)
        reason = self.buffer.refusal(*names, instant, numbers)
        if reason:
            raise permission_error("create", "transform", deref(child), reason)
        reached = self._store([(*names, instant, numbers)], is_static)
        return self._process_reached(reached, next_frame) if reached else next_frame

    def _process_reached(self, reached: ReachedTransforms, frame: Frame) -> Frame:
        """Return the frame that calls the queries that waited for transforms, and goes on with ``frame``."""
        for call_queries in self.on_reached:
            frame = call_queries(reached, frame)
        return frame

    def _frame_name(self, term: Term) -> str:
        """Return the name of a frame, given as an atom or a string.

        Double quotes around a string from a message and one leading slash are removed.
        """
        term = deref(term)
        if isinstance(term, Atom):
            text = term.name
        elif isinstance(term, String):
            text = term.text
        elif term.__class__ is Var:
            raise instantiation_error()
        else:
            raise type_error("frame", term)
        if len(text) > 1 and text[0] == text[-1] == '"':
            text = text[1:-1]
        name = str(text[1:] if text[:1] == "/" else text)
        if isinstance(term, Atom):
            if len(self._frame_names) >= _MAX_CACHED_NAMES:
                self._frame_names.clear()
            self._frame_names[term] = name
        return name

    def _report_unknown(self, *names: str) -> None:
        """Warn once about each frame that is unknown although others are known."""
        for name in names:
            if self.buffer.knows(name) or not len(self.buffer) or name in self._reported_frames:
                continue
            if len(self._reported_frames) < _MAX_REPORTED_FRAMES:
                self._reported_frames.add(name)
                closest = closest_name(name, self.buffer.names(), 0.66)
                hint = f"; did you mean '{closest}'?" if closest else ""
                self._warn(
                    f"tf_lookup: there is no frame '{name[:80]}' yet{hint}", ("frame", name), once=True
                )


def _mentions_transforms(terms: Iterable[Term]) -> bool:
    """Return whether terms contain a goal that reads transforms, or a synchronized query that waits for one."""
    stack = list(terms)
    while stack:
        term: Any = deref(stack.pop())
        if term.__class__ is not tuple:
            continue
        if term[0] in TRANSFORM_PREDICATES:
            return True
        if term[0] in SYNCHRONIZED:
            for item in list_items(term[3]) or ():
                condition: Any = [deref(part) for part in list_items(item) or ()]
                if condition and condition[0].__class__ is tuple and condition[0][0] is TF:
                    return True
        stack.extend(term[1:])
    return False
