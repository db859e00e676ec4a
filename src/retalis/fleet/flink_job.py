"""The fleet as a job of Apache Flink: reading lines, the engines of the robots, and three streams of results.

The function `Robots` stores the state of each robot in Flink's keyed state: the last snapshot, and the inputs since
then, because Flink does not notify functions in Python of checkpoints. Engines stay in the memory of a worker, and
the state is read only to restore a robot that is not there. It is bytes and texts, no pickles.

The time of events is that of their lines. The next alarm of an engine is a timer of Flink, which fires when the
watermark passes it; the watermark follows the newest event of all robots at a distance of `Options.max_lag`.

A checkpoint may lack the newest timers: a timer of a function in Python is registered only after the elements that
were passed to Python together, and Flink 2.3 does not wait for that before it writes a checkpoint. Therefore the
state of a robot contains the time of its timer, and the function that reads the lines stores the robots of the last
lines. After a restore it emits an element without a line for each of them, and `Robots` registers the timers again.
"""

import json
import sys
import time
from collections import OrderedDict
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Dict, Iterator, NamedTuple, Optional, Union

from pyflink.common import Configuration, Duration, Types, WatermarkStrategy
from pyflink.common.serialization import Encoder
from pyflink.common.watermark_strategy import TimestampAssigner
from pyflink.datastream import (
    DataStream,
    FlatMapFunction,
    KeyedProcessFunction,
    OutputTag,
    RuntimeContext,
    SourceFunction,
    StreamExecutionEnvironment,
    TimeDomain,
)
from pyflink.datastream.connectors.file_system import FileSink, FileSource, RollingPolicy, StreamFormat
from pyflink.datastream.state import ListStateDescriptor, ValueStateDescriptor
from pyflink.java_gateway import get_gateway

from ..engine.engine_settings import Settings
from ..forwarding.mqtt_sender import create_client
from ..foundation.errors import RetalisError, UsageError
from ..prolog.terms.timestamps import SECOND, from_seconds
from .line_log import START, LogReader, Position
from .mqtt_bridge import Configure
from .robot_engine import BEFORE_ALL, REFUSE, FleetProgram, RobotEngine, RobotOutput
from .robot_events import read_robot_event

MILLISECOND = 1_000_000
"""Nanoseconds of Flink's unit of time."""

MAX_WATERMARK = (1 << 63) - 1
"""Watermark after the last event of a source that ends, in milliseconds."""

POLL_MILLISECONDS = 100
"""Time between two reads of a log that has no new lines."""

RECENT_LINES = 100_000
"""Number of lines whose robots may lack a timer in a checkpoint: each worker gets up to 1,000 elements together."""

MAX_INPUT_CHARACTERS = 1_000_000
"""Length of the inputs since a snapshot at which a new one is stored."""

EVENT_TYPE = Types.TUPLE([Types.STRING(), Types.LONG(), Types.STRING()])
"""Type of an accepted line: name of the robot, time in milliseconds, line."""

LATE = OutputTag("late", Types.STRING())
FAILED = OutputTag("failed", Types.STRING())


class Options(NamedTuple):
    """Options of a fleet; times are in seconds.

    Attributes:
        on_change: what a restored robot does if the program has changed: "refuse" or "reload".
        snapshot_every: number of inputs of a robot between two snapshots.
        max_lag: time by which the events of one robot may be received after later events of others.
        max_ahead: maximum time of an event after the time of this computer; None for no limit.
        latest: latest time of an event since the epoch, for recorded events; None for no limit.
        flush: time by which the alarms of a robot run on after its last event if the input ends.
        forget_after: time after which the state of a robot that sends nothing is deleted.
        max_engines: maximum number of engines in the memory of a worker.
    """

    on_change: str = REFUSE
    snapshot_every: int = 100
    max_lag: float = 10.0
    max_ahead: Optional[float] = 60.0
    latest: Optional[float] = None
    flush: float = 600.0
    forget_after: float = 30 * 86_400.0
    max_engines: int = 10_000


DEFAULT_OPTIONS = Options()


class Streams(NamedTuple):
    """Results of a fleet; each element is a line of JSON.

    Attributes:
        outputs: ``robot``, ``number``, ``topic`` and ``output``.
        late: events that were received too late: ``reason``, ``line``, ``robot``.
        failed: lines that are no events, and events with an error: ``reason``, ``line``, and ``position`` or
            ``robot``.
    """

    outputs: DataStream
    late: DataStream
    failed: DataStream


class LineChecker:
    """Checks of the lines of one worker; it counts the lines that are refused.

    Args:
        options: options of the fleet.
        context: receives the counters.
    """

    def __init__(self, options: Options, context: RuntimeContext):
        self._max_ahead = options.max_ahead
        self._latest = None if options.latest is None else from_seconds(options.latest)
        self._failed = context.get_metrics_group().counter("failed")

    def check(self, line: str, position: Optional[str] = None, error: str = "") -> Any:
        """Return an element of the stream of events, or one of the stream of failures with its tag."""
        try:
            if error:
                raise UsageError(error)
            event = read_robot_event(line, self._find_latest())
        except UsageError as problem:
            self._failed.inc()
            return FAILED, json.dumps({"reason": str(problem), "line": line, "position": position})
        return event.robot, event.instant // MILLISECOND, line

    def _find_latest(self) -> Optional[int]:
        # The time of one wrong clock would otherwise advance the watermark, and thereby the alarms of all robots.
        if self._max_ahead is None:
            return self._latest
        limit = time.time_ns() + round(self._max_ahead * SECOND)
        return limit if self._latest is None else min(limit, self._latest)


class RecentRobots:
    """Keyed state with the names of the robots of the last lines: `RECENT_LINES` to twice as many; see the module.

    Args:
        context: declares the state.
    """

    def __init__(self, context: RuntimeContext):
        # The newest names, and those of the lines before them: a name is stored at its first line only.
        self._newest = context.get_list_state(ListStateDescriptor("newest robots", Types.STRING()))
        self._previous = context.get_list_state(ListStateDescriptor("previous robots", Types.STRING()))
        self._names: Dict[str, None] = {}
        self._line_count = 0

    def restore(self) -> Iterator[Any]:
        """Yield an element for each stored robot; called before the first line of a process."""
        self._names = dict.fromkeys(self._newest.get())
        # The number of lines is not stored. Counted from 0, the names of a job that restarts often would accumulate.
        self._line_count = len(self._names)
        for name in {**dict.fromkeys(self._previous.get()), **self._names}:
            yield name, 0, ""

    def add(self, name: str) -> None:
        """Store the robot of a line."""
        self._line_count += 1
        if self._line_count > RECENT_LINES:
            self._previous.update(list(self._names))
            self._newest.clear()
            self._names, self._line_count = {}, 1
        if name not in self._names:
            self._names[name] = None
            self._newest.add(name)


class CheckLines(KeyedProcessFunction):
    """Checks the lines of a source of Flink, which has no positions of lines; all lines have one key.

    Args:
        options: options of the fleet.
    """

    def __init__(self, options: Options):
        self._options = options

    def open(self, context: RuntimeContext) -> None:
        """Create the reader."""
        self._checker = LineChecker(self._options, context)
        self._recent = RecentRobots(context)
        self._has_begun = False

    def process_element(self, line: str, context: KeyedProcessFunction.Context) -> Iterator[Any]:
        """Yield an event or a failure, at the first line after an element for each recent robot."""
        if not self._has_begun:
            # If no line follows a restore, the end of the input is the only occasion to set the timers again.
            context.timer_service().register_event_time_timer(MAX_WATERMARK)
            yield from self._begin()
        element = self._checker.check(line)
        if element[0] is not FAILED:
            self._recent.add(element[0])
        yield element

    def on_timer(self, timestamp: int, context: KeyedProcessFunction.OnTimerContext) -> Iterator[Any]:
        """Yield an element for each recent robot at the end of the input, if there was no line since a restore."""
        if not self._has_begun:
            yield from self._begin()

    def _begin(self) -> Iterator[Any]:
        self._has_begun = True
        return self._recent.restore()


class FollowLog(KeyedProcessFunction):
    """Reads a log, whose path is its key, and goes on when it grows.

    The position in the log is keyed state, and a timer reads the next lines. A checkpoint may lack this timer;
    therefore the input is a clock, whose next tick starts it after a restore.

    Args:
        options: options of the fleet.
    """

    def __init__(self, options: Options):
        self._options = options

    def open(self, context: RuntimeContext) -> None:
        """Declare the state."""
        self._checker = LineChecker(self._options, context)
        self._position = context.get_state(ValueStateDescriptor("position", Types.STRING()))
        self._recent = RecentRobots(context)
        self._timer: Optional[int] = None

    def process_element(self, path: str, context: KeyedProcessFunction.Context) -> Iterator[Any]:
        """Begin to read the log if this process does not read it yet; yield an element for each recent robot."""
        if self._timer is not None:
            return
        self._set_timer(context, 0)
        yield from self._recent.restore()

    def on_timer(self, timestamp: int, context: KeyedProcessFunction.OnTimerContext) -> Iterator[Any]:
        """Yield the events and failures of the next lines."""
        if timestamp != self._timer:
            return  # of the process before
        stored = self._position.value()
        position = START if stored is None else Position.parse(stored)
        lines, next_position = LogReader(Path(context.get_current_key())).read(position)
        for line in lines:
            element = self._checker.check(line.text, str(line.position), line.error)
            if element[0] is not FAILED:
                self._recent.add(element[0])
            yield element
        if next_position != position:
            self._position.update(str(next_position))
        self._set_timer(context, 0 if lines else POLL_MILLISECONDS)

    def _set_timer(self, context: KeyedProcessFunction.Context, delay: int) -> None:
        timers = context.timer_service()
        # Each timer has another time, because Flink drops a timer that exists.
        self._timer = max(timers.current_processing_time() + delay, (self._timer or 0) + 1)
        timers.register_processing_time_timer(self._timer)


class EventTime(TimestampAssigner):
    """The time of an event in milliseconds."""

    def extract_timestamp(self, value: Any, record_timestamp: int) -> int:
        """Return the time of an event."""
        return value[1]  # type: ignore[no-any-return]


class _Resident:
    """A robot in the memory of a worker.

    Attributes:
        robot: its engine.
        input_count: number of inputs since the last snapshot.
        characters: length of these inputs.
        timer: time of the earliest known timer in milliseconds; None if there is none.
        seen: time of use that is stored, in milliseconds; None if it is unknown.
        flush_limit: time in nanoseconds up to which alarms run after the end of the input.
    """

    __slots__ = ("robot", "input_count", "characters", "timer", "seen", "flush_limit")

    def __init__(self, robot: RobotEngine, input_count: int, characters: int):
        self.robot, self.input_count, self.characters = robot, input_count, characters
        self.timer: Optional[int] = None
        self.seen: Optional[int] = None
        self.flush_limit: Optional[int] = None


class Robots(KeyedProcessFunction):
    """The robots of one worker; see the module.

    Args:
        folder: folder of the program.
        options: options of the fleet.
        settings: settings of the engines.
    """

    def __init__(self, folder: str, options: Options, settings: Optional[Settings] = None):
        self._folder, self._options, self._settings = folder, options, settings
        self._forget_milliseconds = round(options.forget_after * 1000)

    def open(self, context: RuntimeContext) -> None:
        """Load the program, and declare the state that Flink stores for each robot."""
        self._program = FleetProgram(Path(self._folder), self._settings, on_change=self._options.on_change)
        self._residents: OrderedDict[str, _Resident] = OrderedDict()
        self._snapshot = context.get_state(
            ValueStateDescriptor("snapshot", Types.PRIMITIVE_ARRAY(Types.BYTE()))
        )
        self._inputs = context.get_list_state(ListStateDescriptor("inputs", Types.STRING()))
        self._seen = context.get_state(ValueStateDescriptor("seen", Types.LONG()))
        self._timer = context.get_state(ValueStateDescriptor("timer", Types.LONG()))
        metrics = context.get_metrics_group()
        self._count = {name: metrics.counter(name) for name in COUNTERS}

    def process_element(self, value: Any, context: KeyedProcessFunction.Context) -> Iterator[Any]:
        """Process an event; yield outputs, or a failure or late event with its tag."""
        name, _, line = value
        if not line:
            self._restore_timers(context)
            return
        resident = self._find(name)
        # Not for alarms: a robot that sends nothing is forgotten although its alarms repeat.
        self._touch(resident, context)
        event = read_robot_event(line)
        try:
            result = resident.robot.process(event, _watermark(context))
        except RetalisError:
            raise
        except Exception as error:
            # A fault of the package. The engine may have processed a part of the event: it is restored without it.
            del self._residents[name]
            yield self._fail(name, line, f"{type(error).__name__}: {error}")
            return
        self._count["missing"].inc(result.missing)
        if result.is_repeated:
            self._count["repeated"].inc()
            return
        if result.is_late:
            self._count["late"].inc()
            reason = "the time of the robot is later, and alarms may have run"
            yield LATE, json.dumps({"reason": reason, "line": line, "robot": name})
            return
        self._count["events"].inc()
        self._store_input(resident, line)
        if result.error:
            yield self._fail(name, line, result.error)
        for output in result.outputs:
            yield self._write(name, output)
        self._set_timer(resident, context)

    def on_timer(self, timestamp: int, context: KeyedProcessFunction.OnTimerContext) -> Iterator[Any]:
        """Run the alarms of a robot, or delete its state if it has sent nothing for too long."""
        name = context.get_current_key()
        if context.time_domain() == TimeDomain.PROCESSING_TIME:
            self._forget(name, context)
            return
        if name not in self._residents and self._seen.value() is None:
            return  # the state has been deleted
        resident = self._find(name)
        resident.timer = None
        robot, limit = resident.robot, timestamp * MILLISECOND
        if context.timer_service().current_watermark() == MAX_WATERMARK:
            # The input has ended: an alarm that sets the next one would otherwise go on forever.
            if resident.flush_limit is None:
                resident.flush_limit = robot.reached + round(self._options.flush * SECOND)
            limit = min(limit, resident.flush_limit)
        alarm = robot.next_alarm
        if alarm is not None and alarm <= limit:
            outputs = robot.fire_alarms(limit)
            self._store_input(resident, str(limit))
            for output in outputs:
                yield self._write(name, output)
        if resident.flush_limit is None or (robot.next_alarm or 0) <= resident.flush_limit:
            self._set_timer(resident, context)
        if resident.timer is None:
            self._timer.clear()

    def _find(self, name: str) -> _Resident:
        """Return a robot, which is restored or created if it is not in memory."""
        resident = self._residents.get(name)
        if resident is None:
            resident = self._residents[name] = self._restore()
            if len(self._residents) > self._options.max_engines:
                self._residents.popitem(last=False)
        else:
            self._residents.move_to_end(name)
        return resident

    def _restore(self) -> _Resident:
        state = self._snapshot.value()
        inputs = [] if state is None else list(self._inputs.get())
        robot = RobotEngine(self._program, state, inputs)
        resident = _Resident(robot, len(inputs), sum(map(len, inputs)))
        if state is not None:
            self._count["restored"].inc()
        if state is None or robot.is_reloaded:
            # The first snapshot holds the program with which the inputs have to be processed again.
            self._store_snapshot(resident)
        return resident

    def _store_input(self, resident: _Resident, text: str) -> None:
        resident.input_count += 1
        resident.characters += len(text)
        if (
            resident.input_count >= self._options.snapshot_every
            or resident.characters >= MAX_INPUT_CHARACTERS
        ):
            self._store_snapshot(resident)
        else:
            self._inputs.add(text)

    def _store_snapshot(self, resident: _Resident) -> None:
        self._snapshot.update(resident.robot.snapshot())
        self._inputs.clear()
        resident.input_count = resident.characters = 0

    def _set_timer(self, resident: _Resident, context: KeyedProcessFunction.Context) -> None:
        alarm = resident.robot.next_alarm
        if alarm is None:
            return
        timer = -(-alarm // MILLISECOND)
        # An earlier timer sets the next one. After a restore the timer is set again, which Flink ignores.
        if resident.timer is None or timer < resident.timer:
            context.timer_service().register_event_time_timer(timer)
            resident.timer = timer
            self._timer.update(timer)

    def _restore_timers(self, context: KeyedProcessFunction.Context) -> None:
        """Register the timers of a robot that a checkpoint may lack; Flink drops those that exist."""
        timer, seen = self._timer.value(), self._seen.value()
        if timer is not None:
            context.timer_service().register_event_time_timer(timer)
        if seen is not None:
            context.timer_service().register_processing_time_timer(seen + self._forget_milliseconds)

    def _touch(self, resident: _Resident, context: KeyedProcessFunction.Context) -> None:
        """Store that a robot is in use, unless that was stored recently."""
        timers = context.timer_service()
        now = timers.current_processing_time()
        if resident.seen is None:
            resident.seen = self._seen.value()
        elif now - resident.seen <= self._forget_milliseconds // 10:
            return
        if resident.seen is None or now - resident.seen > self._forget_milliseconds // 10:
            resident.seen = now
            self._seen.update(now)
        # Registered again in each process, as a checkpoint may lack it; Flink drops a timer that exists.
        timers.register_processing_time_timer(resident.seen + self._forget_milliseconds)

    def _forget(self, name: str, context: KeyedProcessFunction.OnTimerContext) -> None:
        timers = context.timer_service()
        seen = self._seen.value()
        if seen is None:
            return
        end = seen + self._forget_milliseconds
        if end > timers.current_processing_time():
            timers.register_processing_time_timer(end)
            return
        self._residents.pop(name, None)
        for state in (self._snapshot, self._inputs, self._seen, self._timer):
            state.clear()
        self._count["forgotten"].inc()

    def _fail(self, name: str, line: str, reason: str) -> Any:
        self._count["failed"].inc()
        return FAILED, json.dumps({"reason": reason, "line": line, "robot": name})

    def _write(self, name: str, output: RobotOutput) -> str:
        self._count["outputs"].inc()
        fields: Dict[str, object] = {"robot": name, "number": output.number}
        return json.dumps({**fields, "topic": output.topic, "output": output.text})


COUNTERS = ("events", "outputs", "late", "failed", "repeated", "missing", "restored", "forgotten")
"""Counters of `Robots` in Flink's metrics."""


def _watermark(context: KeyedProcessFunction.Context) -> int:
    """Return the last nanosecond of the watermark."""
    milliseconds = context.timer_service().current_watermark()
    return BEFORE_ALL if milliseconds is None or milliseconds < 0 else (milliseconds + 1) * MILLISECOND - 1


def create_environment(
    checkpoints: Union[str, Path], interval: float = 10.0, resume: Union[None, str, Path] = None
) -> StreamExecutionEnvironment:
    """Return an environment with the settings that a fleet needs.

    The settings of the folder ``FLINK_CONF_DIR`` apply too, for example the address of a cluster.

    Args:
        checkpoints: folder of the checkpoints, a path or a URL, which all machines can use.
        interval: time between two checkpoints in seconds.
        resume: a checkpoint or savepoint to resume from.
    """
    configuration = Configuration()
    for key, value in {
        # By default a worker runs the first `python` of its PATH, which may belong to another environment.
        "python.executable": sys.executable,
        # Outputs wait at most this long for the end of a bundle, in milliseconds.
        "python.fn-execution.bundle.time": "100",
        "execution.checkpointing.interval": f"{round(interval * 1000)} ms",
        "execution.checkpointing.mode": "EXACTLY_ONCE",
        "execution.checkpointing.dir": _url(checkpoints),
        "execution.checkpointing.externalized-checkpoint-retention": "RETAIN_ON_CANCELLATION",
        "restart-strategy.type": "exponential-delay",
        "restart-strategy.exponential-delay.initial-backoff": "1 s",
        "restart-strategy.exponential-delay.max-backoff": "1 min",
        **({} if resume is None else {"execution.state-recovery.path": _url(resume)}),
    }.items():
        configuration.set_string(key, value)
    return StreamExecutionEnvironment.get_execution_environment(configuration)


def _url(path: Union[str, Path]) -> str:
    # Flink writes `file:/path` for the path of a savepoint.
    text = str(path)
    return text if ":/" in text else Path(text).resolve().as_uri()


def find_newest_checkpoint(folder: Path) -> Optional[Path]:
    """Return the newest complete checkpoint in a folder of checkpoints, or None."""
    # Flink writes the metadata of a checkpoint last, and renames it.
    complete = [path for path in folder.glob("*/chk-*/_metadata") if path.stat().st_size]
    newest = max(complete, key=lambda path: path.stat().st_mtime_ns, default=None)
    return None if newest is None else newest.parent


@contextmanager
def _one_worker(environment: StreamExecutionEnvironment) -> Iterator[None]:
    """Let the operators that are added have one worker, which keeps the order of the lines."""
    parallelism = environment.get_parallelism()
    environment.set_parallelism(1)
    try:
        yield
    finally:
        environment.set_parallelism(parallelism)


def read_file(
    environment: StreamExecutionEnvironment, path: Union[str, Path], options: Options = DEFAULT_OPTIONS
) -> DataStream:
    """Return the events of a file that does not grow; the job ends after them."""
    source = FileSource.for_record_stream_format(StreamFormat.text_line_format(), _url(path)).build()
    with _one_worker(environment):
        lines = environment.from_source(source, WatermarkStrategy.no_watermarks(), "lines").uid("lines")
    return read_lines(lines, options)


def read_lines(lines: DataStream, options: Options = DEFAULT_OPTIONS) -> DataStream:
    """Return the events of a stream of lines, for example of a connector of Flink.

    Args:
        lines: texts; those of one robot are in order if the stream has one worker.
        options: options of the fleet.
    """
    with _one_worker(lines.get_execution_environment()):
        keyed = lines.key_by(lambda line: "", Types.STRING())
        return keyed.process(CheckLines(options), EVENT_TYPE).name("read").uid("read")


def follow_log(
    environment: StreamExecutionEnvironment, path: Union[str, Path], options: Options = DEFAULT_OPTIONS
) -> DataStream:
    """Return the events of a log or of a file that grows; the job does not end.

    Args:
        environment: environment of the job.
        path: folder of a log, or a file, which all machines can read.
        options: options of the fleet.
    """
    # Flink has no sources in Python, so a function with keyed state reads the log. A source that never ends is its
    # clock: a random truth value each second.
    name = str(Path(path).resolve())
    datagen = get_gateway().jvm.org.apache.flink.streaming.api.functions.source.datagen
    source = datagen.DataGeneratorSource(datagen.RandomGenerator.booleanGenerator(), 1, None)
    with _one_worker(environment):
        ticks = environment.add_source(SourceFunction(source), "clock", Types.BOOLEAN()).uid("clock")
        by_path = ticks.map(lambda tick: name, Types.STRING()).key_by(lambda path: path, Types.STRING())
        return by_path.process(FollowLog(options), EVENT_TYPE).name("read").uid("read")


def run_robots(
    events: DataStream,
    program: Union[str, Path],
    options: Options = DEFAULT_OPTIONS,
    settings: Optional[Settings] = None,
) -> Streams:
    """Return the results of a program that runs for each robot.

    Args:
        events: result of `read_file`, `read_lines` or `follow_log`.
        program: folder of the program, which has the same path on all machines.
        options: options of the fleet.
        settings: settings of the engines, for example limits.

    Raises:
        RetalisError: if the program has errors.
    """
    folder = Path(program).resolve()
    # Errors are reported where the job is submitted.
    FleetProgram(folder, settings, on_change=options.on_change)
    strategy = WatermarkStrategy.for_bounded_out_of_orderness(
        Duration.of_millis(round(options.max_lag * 1000))
    )
    with _one_worker(events.get_execution_environment()):
        timed = events.assign_timestamps_and_watermarks(strategy.with_timestamp_assigner(EventTime()))
        by_robot = timed.key_by(lambda event: event[0], key_type=Types.STRING())
    outputs = by_robot.process(Robots(str(folder), options, settings), Types.STRING())
    outputs = outputs.name("robots").uid("robots")
    failed = events.get_side_output(FAILED).union(outputs.get_side_output(FAILED))
    return Streams(outputs, outputs.get_side_output(LATE), failed)


def write_files(lines: DataStream, folder: Union[str, Path], name: str) -> None:
    """Write a stream to files of a folder, exactly once: files whose names begin with a dot are not complete.

    Args:
        lines: the stream.
        folder: folder of the files, which all machines can use.
        name: name of the sink, unique in the job.
    """
    sink = FileSink.for_row_format(_url(folder), Encoder.simple_string_encoder()).with_rolling_policy(
        RollingPolicy.on_checkpoint_rolling_policy()
    )
    lines.sink_to(sink.build()).name(name).uid(name)


PUBLISH_TIMEOUT_SECONDS = 30.0
"""Time in which the broker has to acknowledge an output."""


class PublishLines(FlatMapFunction):
    """Publishes lines to a broker of MQTT with quality of service 1, and waits for each acknowledgement.

    Args:
        host: host of the broker.
        port: port of the broker.
        topic: topic with ``{robot}`` for the name of the robot.
        configure: configures the client of paho.
    """

    def __init__(self, host: str, port: int, topic: str, configure: Configure):
        self._host, self._port, self._topic, self._configure = host, port, topic, configure

    def open(self, context: RuntimeContext) -> None:
        """Connect."""
        self._client = create_client("")
        self._configure(self._client)
        self._client.connect(self._host, self._port)
        self._client.loop_start()

    def close(self) -> None:
        """Disconnect."""
        self._client.loop_stop()
        self._client.disconnect()

    def flat_map(self, line: str) -> Iterator[str]:
        """Publish a line.

        Raises:
            RuntimeError: if the broker does not acknowledge it; the job then continues from its last checkpoint.
        """
        # In the name of a robot these characters would make it several levels, or a pattern.
        robot = json.loads(line)["robot"].translate(str.maketrans("/+#", "___"))
        topic = self._topic.replace("{robot}", robot)
        message = self._client.publish(topic, line, qos=1)
        message.wait_for_publish(PUBLISH_TIMEOUT_SECONDS)
        if not message.is_published():
            raise RuntimeError(f"MQTT: {self._host}:{self._port} did not acknowledge an output")
        yield from ()


def publish_mqtt(
    lines: DataStream,
    host: str,
    port: int = 1883,
    topic: str = "retalis/{robot}/outputs",
    configure: Configure = lambda client: None,
) -> None:
    """Publish the outputs of a fleet to a broker of MQTT, at least once: receivers drop repetitions by the number.

    Args:
        lines: the outputs.
        host: host of the broker.
        port: port of the broker.
        topic: topic with ``{robot}`` for the name of the robot.
        configure: configures the client of paho, for example with a password and certificates.
    """
    published = lines.flat_map(PublishLines(host, port, topic, configure), Types.STRING())
    published.name("publish").uid("publish")
