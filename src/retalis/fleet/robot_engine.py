"""The engine of one robot for a stream processor: events in, outputs out, and a state that can be stored as bytes.

The results depend on the events and on their order only, so that a robot that is restored from a stored state, and
gets the later events again, emits the same outputs with the same numbers.
"""

import json
from hashlib import sha256
from pathlib import Path
from typing import Dict, Iterable, List, NamedTuple, Optional

from ..engine.checkpoints import compute_file_digest, list_program_files
from ..engine.engine import Engine
from ..engine.engine_settings import Settings
from ..events.clock.clock import StreamClock
from ..events.program.topic_configuration import TOPICS, Topics, read_topics
from ..foundation.displayed_text import quote_shortened
from ..foundation.errors import RetalisError, UsageError
from ..messages.message_dictionaries import make_message_term
from ..messages.type_registry import Definitions
from ..prolog.syntax.term_reader import read_term
from ..prolog.syntax.tokenizer import ReadFlags
from ..prolog.terms.types import Term
from .robot_events import RobotEvent, read_robot_event

REFUSE, RELOAD = "refuse", "reload"
ON_CHANGE = (REFUSE, RELOAD)
"""Choices for a restored robot whose program has changed: raise an error, or load the program and keep its state."""

MAX_SESSIONS = 8
"""Maximum number of sessions of a robot whose last event is remembered; the least recently used is forgotten."""

BEFORE_ALL = -1
"""Watermark before all events, in nanoseconds."""

_EVENT_FLAGS = ReadFlags(is_constructed=True)

_FORMAT = 1
"""Format of the first line of a stored state."""


class RobotOutput(NamedTuple):
    """An output of a robot.

    Attributes:
        number: number of the output, from 1 on.
        topic: topic of the subscription.
        text: the output as a term.
    """

    number: int
    topic: str
    text: str


class Processed(NamedTuple):
    """Result of an event.

    Attributes:
        outputs: outputs since the previous event.
        error: why the event failed; "" if it did not.
        is_repeated: whether an event with this number, or a later one, has been processed before.
        is_late: whether the event is too late.
        missing: number of events between this one and the previous one of the session.
    """

    outputs: List[RobotOutput]
    error: str = ""
    is_repeated: bool = False
    is_late: bool = False
    missing: int = 0


class FleetProgram:
    """The program of all robots.

    Args:
        folder: folder of the program.
        settings: settings of the engines, for example limits.
        definitions: known message types; by default none but those of ``std_msgs`` and the like.
        on_change: see `ON_CHANGE`.

    Attributes:
        digest: SHA-256 digest of the files of the program.

    Raises:
        ProgramErrors: the errors of the program.
        UsageError: if a file cannot be read, or ``on_change`` is unknown.
    """

    def __init__(
        self,
        folder: Path,
        settings: Optional[Settings] = None,
        definitions: Optional[Definitions] = None,
        on_change: str = REFUSE,
    ):
        if on_change not in ON_CHANGE:
            raise UsageError(
                f"on_change: expected {' or '.join(ON_CHANGE)}, found {quote_shortened(on_change)}"
            )
        self.folder = folder.resolve()
        self.settings = settings
        self.definitions = Definitions() if definitions is None else definitions
        self.on_change = on_change
        self.topics = read_topics(self.folder / TOPICS) if (self.folder / TOPICS).exists() else Topics()
        # An error ends the job at its start, not at the first event.
        engine = self.create_engine(StreamClock())
        files = list_program_files(self.folder, [str(path) for path in engine.program.rules.files.loaded])
        # Paths inside the folder are relative, so that a copy of the folder is the same program.
        digests = [f"{_relative_path(path, self.folder)} {compute_file_digest(path)}" for path in files]
        self.digest = sha256("\n".join(digests).encode()).hexdigest()

    def create_engine(self, clock: StreamClock) -> Engine:
        """Return the engine of a new robot, with its clock."""
        engine = Engine(clock, self.settings, definitions=self.definitions)
        engine.load_program(self.folder)
        return engine

    def make_message_term(self, topic: str, slots: Dict[str, object]) -> Term:
        """Return the event of a message.

        Raises:
            RetalisError: if the program does not subscribe to the topic, or a slot does not fit the type.
        """
        name = topic.strip("/")
        subscribed = next((entry for entry in self.topics.subscribed if entry.topic.strip("/") == name), None)
        if subscribed is None:
            raise UsageError(f"topic {quote_shortened(topic)}: the program does not subscribe to it")
        try:
            definition = self.definitions.find(subscribed.type)
            term = make_message_term(definition, slots)
            data = self.definitions.encoder(definition).encode(term, topic)
        except (AttributeError, TypeError, ValueError) as error:
            # `make_message_term` expects values of the right kind, for example a dictionary for a nested message.
            raise UsageError(
                f"topic {quote_shortened(topic)}: no message of {subscribed.type}: {error}"
            ) from error
        # Decoded as a node does it: the term has the form of strings and the event name that the program expects.
        event_name = self.topics.event_name_of(subscribed.topic)
        return self.definitions.decoder(definition.as_event(event_name)).decode(data)


def _relative_path(path: str, folder: Path) -> str:
    try:
        return str(Path(path).resolve().relative_to(folder))
    except ValueError:
        return path


class RobotEngine:
    """The engine of one robot.

    The state of a robot is a snapshot and the inputs since then, which are processed again to restore it. This is
    for stream processors that do not tell a function when they store its state: it has to be complete after each
    input, and a snapshot takes as long as dozens of events.

    Args:
        program: program of the fleet.
        state: result of `snapshot`, to resume from; None for a new robot.
        inputs: the inputs since the snapshot: lines of events, and times in nanoseconds up to which alarms have run.

    Attributes:
        is_reloaded: whether the present program has replaced the stored one.

    Raises:
        UsageError: if the state is damaged, or belongs to another program that must not be replaced.
        ProgramErrors: if the program has changed, and cannot be loaded in place of the stored one.
    """

    def __init__(self, program: FleetProgram, state: Optional[bytes] = None, inputs: Iterable[str] = ()):
        self._program = program
        self._outputs: List[RobotOutput] = []
        self._output_count = 0
        self._last_ids: Dict[str, int] = {}
        self._clock = StreamClock()
        self.is_reloaded = False
        if state is None:
            self._engine = program.create_engine(self._clock)
            self._engine.on_output(self._add_output)
            return
        header, _, data = state.partition(b"\n")
        stored = _read_header(header)
        has_changed = stored.digest != program.digest
        if has_changed and program.on_change == REFUSE:
            raise UsageError(
                f"{program.folder}: the program has changed since the state of this robot was stored: start the "
                "fleet with the stored program, or with on_change='reload'"
            )
        self._output_count, self._last_ids = stored.output_count, stored.last_ids
        self._engine = Engine.restore(
            data, self._clock, program.settings, definitions=program.definitions, folder=program.folder
        )
        self._engine.on_output(self._add_output)
        # The stored program processes them, as it has done before.
        for text in inputs:
            self._repeat(text)
        if has_changed:
            self._reload()

    def _reload(self) -> None:
        deployments = self._engine.loaded_deployments()
        if str(self._program.folder) not in deployments:
            raise UsageError(
                f"{self._program.folder}: the stored program was loaded from {', '.join(deployments)}: expected the "
                "same folder"
            )
        self._engine.reload(self._program.folder)
        self.is_reloaded = True

    def snapshot(self) -> bytes:
        """Return the state as bytes."""
        header = {
            "format": _FORMAT,
            "digest": self._program.digest,
            "output_count": self._output_count,
            "last_ids": self._last_ids,
        }
        return json.dumps(header).encode() + b"\n" + self._engine.snapshot()

    @property
    def reached(self) -> int:
        """The time of the robot in nanoseconds: that of its newest event, or of its newest alarm."""
        return self._clock.reached()

    @property
    def next_alarm(self) -> Optional[int]:
        """The time in nanoseconds at which `fire_alarms` has something to do; None if there is none."""
        return self._clock.next_alarm()

    def process(self, event: RobotEvent, watermark: int = BEFORE_ALL) -> Processed:
        """Process an event.

        Args:
            event: the event.
            watermark: time in nanoseconds up to which all events are expected to have been received. An event is too
                late if it is not after the watermark, and before the time of this robot: alarms may have fired that
                it would have prevented.
        """
        missing = 0
        if event.id is not None:
            last_id = self._last_ids.get(event.session)
            if last_id is not None and event.id <= last_id:
                return Processed([], is_repeated=True)
            missing = 0 if last_id is None else event.id - last_id - 1
            self._remember(event.session, event.id)
        if event.instant <= watermark and event.instant < self.reached:
            return Processed([], is_late=True, missing=missing)
        self._move_to(event.instant)
        error = ""
        try:
            self._dispatch(event)
        except RetalisError as problem:
            error = str(problem)
        return Processed(self._take_outputs(), error, missing=missing)

    def fire_alarms(self, limit: int) -> List[RobotOutput]:
        """Run the alarms up to a time in nanoseconds, each at its own time, and return the outputs."""
        self._clock.fire_alarms(limit, self._engine.advance)
        return self._take_outputs()

    def _repeat(self, text: str) -> None:
        """Process an input again, whose outputs have been emitted before."""
        if text.startswith("{"):
            self.process(read_robot_event(text))
        else:
            self.fire_alarms(int(text))

    def _remember(self, session: str, number: int) -> None:
        # The last one is the newest, so that a session in use is never forgotten.
        self._last_ids.pop(session, None)
        if len(self._last_ids) >= MAX_SESSIONS:
            del self._last_ids[next(iter(self._last_ids))]
        self._last_ids[session] = number

    def _move_to(self, instant: int) -> None:
        self._clock.fire_alarms(instant, self._engine.advance)
        self._clock.move_to(instant)
        self._engine.advance()

    def _dispatch(self, event: RobotEvent) -> None:
        if event.text is not None:
            term = read_term(event.text, self._engine.operators, "event", _EVENT_FLAGS).term
        elif event.topic is not None and event.message is not None:
            term = self._program.make_message_term(event.topic, event.message)
        else:
            return
        self._engine.event_at(term, event.instant if event.start is None else event.start, event.instant)

    def _add_output(self, term: Term, topic: str, name: Term) -> None:
        self._output_count += 1
        self._outputs.append(RobotOutput(self._output_count, topic, self._engine.show(term)))

    def _take_outputs(self) -> List[RobotOutput]:
        outputs, self._outputs = self._outputs, []
        return outputs


class _StateHeader(NamedTuple):
    """First line of a stored state.

    Attributes:
        digest: digest of the program.
        output_count: number of outputs.
        last_ids: number of the last event of each session, in the order of these events.
    """

    digest: str
    output_count: int
    last_ids: Dict[str, int]


def _read_header(line: bytes) -> _StateHeader:
    try:
        fields = json.loads(line)
        if fields["format"] != _FORMAT:
            raise UsageError(f"state of a robot: format {fields['format']} is unknown: expected {_FORMAT}")
        last_ids = {str(session): int(number) for session, number in fields["last_ids"].items()}
        return _StateHeader(str(fields["digest"]), int(fields["output_count"]), last_ids)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise UsageError(f"state of a robot: it is damaged: {error!r}") from error
