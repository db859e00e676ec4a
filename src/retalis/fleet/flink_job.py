"""The fleet as a job of Apache Flink: reading lines, the engines of the robots, and three streams of results.

The function `Robots` stores the state of each robot in Flink's keyed state: the last snapshot, and the inputs since
then, because Flink does not notify functions in Python of checkpoints. Engines stay in the memory of a worker, and
the state is read only to restore a robot that is not there. It is bytes and texts, no pickles.

The time of events is that of their lines. The next alarm of an engine is a timer of Flink, which fires when the
watermark passes it; the watermark follows the newest event of all robots at a distance of `Options.max_lag`.
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
    KeyedProcessFunction,
    OutputTag,
    ProcessFunction,
    RuntimeContext,
    StreamExecutionEnvironment,
    TimeDomain,
)
from pyflink.datastream.connectors.file_system import FileSink, FileSource, RollingPolicy, StreamFormat
from pyflink.datastream.state import ListStateDescriptor, ValueStateDescriptor

from ..engine.engine_settings import Settings
from ..foundation.errors import RetalisError, UsageError
from ..prolog.terms.timestamps import SECOND, from_seconds
from .line_log import START, LogReader, Position
from .robot_engine import BEFORE_ALL, REFUSE, FleetProgram, RobotEngine, RobotOutput
from .robot_events import read_robot_event

MILLISECOND = 1_000_000
"""Nanoseconds of Flink's unit of time."""

MAX_WATERMARK = (1 << 63) - 1
"""Watermark after the last event of a source that ends, in milliseconds."""

POLL_MILLISECONDS = 100
"""Time between two reads of a log that has no new lines."""

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

    def read(self, line: str, position: Optional[str] = None, error: str = "") -> Any:
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


class CheckLines(ProcessFunction):
    """Checks the lines of a source of Flink, which has no positions of lines.

    Args:
        options: options of the fleet.
    """

    def __init__(self, options: Options):
        self._options = options

    def open(self, context: RuntimeContext) -> None:
        """Create the reader."""
        self._reader = LineChecker(self._options, context)

    def process_element(self, line: str, context: ProcessFunction.Context) -> Iterator[Any]:
        """Yield an event or a failure."""
        yield self._reader.read(line)


class FollowLogs(KeyedProcessFunction):
    """Reads the logs whose paths are its keys, and goes on when they grow.

    The position of each log is keyed state, and a timer reads the next lines.

    Args:
        options: options of the fleet.
    """

    def __init__(self, options: Options):
        self._options = options

    def open(self, context: RuntimeContext) -> None:
        """Declare the state."""
        self._reader = LineChecker(self._options, context)
        self._position = context.get_state(ValueStateDescriptor("position", Types.STRING()))

    def process_element(self, path: str, context: KeyedProcessFunction.Context) -> None:
        """Begin to read a log."""
        timers = context.timer_service()
        timers.register_processing_time_timer(timers.current_processing_time())

    def on_timer(self, timestamp: int, context: KeyedProcessFunction.OnTimerContext) -> Iterator[Any]:
        """Yield the events and failures of the next lines."""
        stored = self._position.value()
        position = START if stored is None else Position.parse(stored)
        lines, next_position = LogReader(Path(context.get_current_key())).read(position)
        for line in lines:
            yield self._reader.read(line.text, str(line.position), line.error)
        if next_position != position:
            self._position.update(str(next_position))
        timers = context.timer_service()
        # A timer of the present time lets Flink take a checkpoint first.
        delay = 0 if lines else POLL_MILLISECONDS
        timers.register_processing_time_timer(timers.current_processing_time() + delay)


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
        flush_limit: time in nanoseconds up to which alarms run after the end of the input.
    """

    __slots__ = ("robot", "input_count", "characters", "timer", "flush_limit")

    def __init__(self, robot: RobotEngine, input_count: int, characters: int):
        self.robot, self.input_count, self.characters = robot, input_count, characters
        self.timer: Optional[int] = None
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
        metrics = context.get_metrics_group()
        self._count = {name: metrics.counter(name) for name in COUNTERS}

    def process_element(self, value: Any, context: KeyedProcessFunction.Context) -> Iterator[Any]:
        """Process an event; yield outputs, or a failure or late event with its tag."""
        name, _, line = value
        resident = self._find(name, context)
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
        resident = self._find(name, context)
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

    def _find(self, name: str, context: KeyedProcessFunction.Context) -> _Resident:
        """Return a robot, which is restored or created if it is not in memory."""
        resident = self._residents.get(name)
        if resident is None:
            resident = self._residents[name] = self._restore()
            if len(self._residents) > self._options.max_engines:
                self._residents.popitem(last=False)
            self._touch(context)
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

    def _touch(self, context: KeyedProcessFunction.Context) -> None:
        """Store that a robot is in use, unless that was stored recently."""
        timers = context.timer_service()
        now = timers.current_processing_time()
        seen = self._seen.value()
        if seen is None:
            timers.register_processing_time_timer(now + self._forget_milliseconds)
        if seen is None or now - seen > self._forget_milliseconds // 10:
            self._seen.update(now)

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
        for state in (self._snapshot, self._inputs, self._seen):
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
    text = str(path)
    return text if "://" in text else Path(text).resolve().as_uri()


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
        return lines.process(CheckLines(options), EVENT_TYPE).name("read").uid("read")


def follow_log(
    environment: StreamExecutionEnvironment, path: Union[str, Path], options: Options = DEFAULT_OPTIONS
) -> DataStream:
    """Return the events of a log or of a file that grows; the job does not end.

    Args:
        environment: environment of the job.
        path: folder of a log, or a file, which all machines can read.
        options: options of the fleet.
    """
    # Flink has no source in Python. A folder with one file is a source that has one element and never ends, and the
    # reader is a function with keyed state.
    path = Path(path).resolve()
    seed = path.parent / f".{path.name}.follow" / "path"
    seed.parent.mkdir(exist_ok=True)
    seed.write_text(f"{path}\n", encoding="utf-8")
    builder = FileSource.for_record_stream_format(StreamFormat.text_line_format(), _url(seed.parent))
    source = builder.monitor_continuously(Duration.of_hours(1)).build()
    with _one_worker(environment):
        paths = environment.from_source(source, WatermarkStrategy.no_watermarks(), "logs").uid("logs")
        by_path = paths.key_by(lambda path: path, key_type=Types.STRING())
        return by_path.process(FollowLogs(options), EVENT_TYPE).name("read").uid("read")


def run_robots(
    events: DataStream,
    program: Union[str, Path],
    options: Options = DEFAULT_OPTIONS,
    settings: Optional[Settings] = None,
) -> Streams:
    """Return the results of a program that runs for each robot.

    Args:
        events: result of `read_file` or `follow_log`.
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
