#!/usr/bin/env python3
"""Write simulated recordings of a robot with a localization filter, with and without each fault of the program.

    examples/localization_faults/make_recordings.py recordings                     # ROS 2 bags, all cases
    examples/localization_faults/make_recordings.py recordings --case gyro_sign --format bag

Each case is two recordings of 100 s: ``CASE_fault`` has the fault, ``CASE_healthy`` a harmless situation that
resembles it. The robot stands, drives, turns and reverses; its wheels, gyroscope, receiver and filter have noise. The
same seed gives the same messages. The bags are written by the package rosbags (``pip install rosbags``).
"""

import argparse
import math
import random
import sys
import tempfile
from pathlib import Path
from typing import Any, Dict, Iterator, List, NamedTuple, Tuple

import numpy
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

START = 1_700_000_000
"""Start of the recordings, in seconds since the epoch."""

SECOND = 10**9

DURATION = 100.0
"""Length of a recording in seconds."""

RATES = {"imu": 25, "wheel": 10, "filter": 10, "fix": 5, "joints": 5, "diagnostics": 1}
"""Messages per second."""

DRIVE = (
    # until [s], speed [m/s], yaw rate [rad/s]
    (8.0, 0.0, 0.0),
    (28.0, 1.0, 0.0),
    (36.0, 0.6, 0.4),
    (50.0, 1.0, 0.0),
    (58.0, 0.0, 0.0),
    (66.0, -0.5, 0.0),
    (74.0, 0.6, -0.4),
    (94.0, 1.0, 0.0),
    (DURATION, 0.0, 0.0),
)
"""Phases of the drive."""

NO_FIX = (50.0, 64.0)
"""Time under a bridge: the receiver reports that it has no fix, and the filter rejects its positions."""

NO_NETWORK = (62.0, 65.0)
"""Time without any message in the recording that resembles a node that died."""

TOPICS = {
    "/imu/data": "sensor_msgs/msg/Imu",
    "/wheel/twist": "geometry_msgs/msg/TwistWithCovarianceStamped",
    "/gps/fix": "sensor_msgs/msg/NavSatFix",
    "/odometry/filtered": "nav_msgs/msg/Odometry",
    "/filter/nis/gps": "std_msgs/msg/Float64",
    "/filter/nis/wheel": "std_msgs/msg/Float64",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
"""Type of each topic."""

CASES = (
    "gps_rejected",
    "backwards",
    "small_innovations",
    "gyro_sign",
    "idle_gate",
    "transforms_stopped",
    "filter_died",
    "filter_late",
)
"""Names of the faults."""


class Message(NamedTuple):
    """A message: time of its receipt in seconds since the start, topic, and fields by name."""

    time: float
    topic: str
    fields: Dict[str, Any]


class Robot:
    """Simulation of one recording.

    Args:
        case: one of `CASES`.
        faulty: the recording has the fault; otherwise it has a situation that resembles it.
        seed: seed of the noise.
    """

    def __init__(self, case: str, faulty: bool, seed: int):
        self.case = case
        self.faulty = faulty
        self.random = random.Random(f"{case} {faulty} {seed}")
        self.x = self.y = self.yaw = 0.0
        # The position that the filter publishes, without its noise.
        self.filter_x = self.filter_y = 0.0

    def has(self, case: str) -> bool:
        """Whether the recording has the fault of a case."""
        return self.faulty and self.case == case

    def resembles(self, case: str) -> bool:
        """Whether the recording has the situation that resembles a case."""
        return not self.faulty and self.case == case

    def messages(self) -> Iterator[Message]:
        """Yield the messages of the recording in the order of their receipt."""
        for message in sorted(self._simulate(), key=lambda message: message.time):
            # A network that fails loses the messages of all nodes, which live.
            if not (self.resembles("filter_died") and NO_NETWORK[0] <= message.time < NO_NETWORK[1]):
                yield message

    def _simulate(self) -> Iterator[Message]:
        ticks = 50
        for tick in range(round(DURATION * ticks)):
            time = tick / ticks
            speed, turn = self._motion(time)
            self._move(speed, turn, 1 / ticks)
            if tick % (ticks // RATES["imu"]) == 0:
                yield self._imu(time, turn)
            if tick % (ticks // RATES["wheel"]) == 0:
                yield from self._wheel(time, speed, turn)
            if tick % (ticks // RATES["filter"]) == 0:
                yield from self._filter(time, speed, turn)
            if tick % (ticks // RATES["fix"]) == 0:
                yield from self._fix(time)
            if tick % (ticks // RATES["joints"]) == 0:
                yield self._transform(time, time + 0.004, "base_link", "wheel_left", 0.0, 0.3, 0.0)
            if tick % (ticks // RATES["diagnostics"]) == 0 and self._filter_lives(time):
                yield self._diagnostics(time)

    def _motion(self, time: float) -> Tuple[float, float]:
        """Return speed and yaw rate of the robot."""
        return next((speed, turn) for until, speed, turn in DRIVE if time < until)

    def _move(self, speed: float, turn: float, seconds: float) -> None:
        self.yaw += turn * seconds
        self.x += speed * math.cos(self.yaw) * seconds
        self.y += speed * math.sin(self.yaw) * seconds
        moved = -speed if self.has("backwards") else speed
        self.filter_x += moved * math.cos(self.yaw) * seconds
        self.filter_y += moved * math.sin(self.yaw) * seconds

    def _noise(self, deviation: float) -> float:
        return self.random.gauss(0.0, deviation)

    def _nis(self, degrees: int, scale: float) -> float:
        """Return a normalized innovation squared: the sum of squared normal numbers, times a scale."""
        return scale * sum(self._noise(1.0) ** 2 for _ in range(degrees))

    def _imu(self, time: float, turn: float) -> Message:
        sign = -1.0 if self.has("gyro_sign") else 1.0
        bias = 0.004
        rate = sign * turn + bias + self._noise(0.01)
        fields = {
            "header": header(time, "imu_link"),
            "orientation": {"w": 1.0},
            "angular_velocity": {"x": self._noise(0.01), "y": self._noise(0.01), "z": rate},
            "linear_acceleration": {
                "x": self._noise(0.05),
                "y": self._noise(0.05),
                "z": 9.81 + self._noise(0.05),
            },
        }
        return Message(time + 0.003, "/imu/data", fields)

    def _wheel(self, time: float, speed: float, turn: float) -> Iterator[Message]:
        stands = speed == 0.0 and turn == 0.0
        # Wheels that skid measure too much rotation.
        skid = 1.9 if self.resembles("gyro_sign") else 1.05
        twist = {
            "linear": {"x": 0.0 if stands else speed + self._noise(0.02)},
            "angular": {"z": 0.0 if stands else skid * turn + self._noise(0.02)},
        }
        fields = {"header": header(time, "base_link"), "twist": {"twist": twist}}
        yield Message(time + 0.005, "/wheel/twist", fields)
        if self._filter_lives(time):
            yield Message(
                time + 0.010, "/filter/nis/wheel", {"data": self._nis(2, self._wheel_scale(stands))}
            )

    def _wheel_scale(self, stands: bool) -> float:
        """Return the mean of the wheels' NIS, relative to that of a filter with the right noise."""
        if stands:  # the encoders measure what the filter expects
            return 0.005
        if self.has("small_innovations"):
            return 0.015
        return 0.3 if self.resembles("small_innovations") else 0.8

    def _filter_lives(self, time: float) -> bool:
        if self.has("filter_died"):
            return not 45.0 <= time < 75.0
        # A process that waits for a disk is alive.
        return not (self.resembles("filter_died") and 45.0 <= time < 46.2)

    def _filter(self, time: float, speed: float, turn: float) -> Iterator[Message]:
        if not self._filter_lives(time):
            return
        delay = 0.015
        if self.has("filter_late") and 40.0 <= time < 70.0:
            delay = 0.45 + abs(self._noise(0.05))
        if self.resembles("filter_late") and 40.0 <= time < 40.8:
            delay = 0.5 - 0.5 * (time - 40.0)
        drift = 0.3 * math.sin(time / 9.0)
        # A correction of the position by 3 m is no motion.
        jump = -3.0 if self.resembles("backwards") and time >= 20.0 else 0.0
        x, y = self.filter_x + drift + jump, self.filter_y - drift
        pose = {"position": {"x": x, "y": y}, "orientation": rotation(self.yaw + self._noise(0.005))}
        twist = {
            "linear": {"x": speed + self._noise(0.02)},
            "angular": {"z": turn + self._noise(0.01)},
        }
        fields = {
            "header": header(time, "odom"),
            "child_frame_id": "base_link",
            "pose": {"pose": pose},
            "twist": {"twist": twist},
        }
        yield Message(time + delay, "/odometry/filtered", fields)
        stopped = self.has("transforms_stopped") and 45.0 <= time < 75.0
        # A short pause of the transforms does not matter.
        pause = self.resembles("transforms_stopped") and 45.0 <= time < 45.6
        if not stopped and not pause:
            yield self._transform(time, time + delay + 0.001, "odom", "base_link", x, y, self.yaw)

    def _transform(
        self, time: float, receipt: float, parent: str, child: str, x: float, y: float, yaw: float
    ) -> Message:
        transform = {
            "header": header(time, parent),
            "child_frame_id": child,
            "transform": {"translation": {"x": x, "y": y}, "rotation": rotation(yaw)},
        }
        return Message(receipt, "/tf", {"transforms": [transform]})

    def _fix(self, time: float) -> Iterator[Message]:
        has_fix = not NO_FIX[0] <= time < NO_FIX[1]
        deviation = 0.8 if has_fix else 25.0  # m
        north, east = self.y + self._noise(deviation), self.x + self._noise(deviation)
        fields = {
            "header": header(time, "gps"),
            "status": {"status": 0 if has_fix else -1, "service": 1},
            "latitude": 48.0 + north / 111_200.0,
            "longitude": 11.0 + east / 74_500.0,
            "altitude": 520.0 + self._noise(1.5),
            "position_covariance": [0.64, 0.0, 0.0, 0.0, 0.64, 0.0, 0.0, 0.0, 2.25],
            "position_covariance_type": 2,
        }
        yield Message(time + 0.080, "/gps/fix", fields)
        if self._filter_lives(time):
            yield Message(time + 0.090, "/filter/nis/gps", {"data": self._gps_nis(time, has_fix)})

    def _gps_nis(self, time: float, has_fix: bool) -> float:
        speed, turn = self._motion(time)
        if not has_fix:
            return 60.0 + abs(self._noise(40.0))
        if self.has("gps_rejected") and 30.0 <= time < 75.0:
            return 40.0 + abs(self._noise(25.0))
        # Reflections: one fix in ten is far off, and rejecting it is right.
        if self.resembles("gps_rejected") and self.random.random() < 0.1:
            return 30.0 + abs(self._noise(10.0))
        if self.has("idle_gate"):
            # The filter trusts neither itself nor the receiver: the largest NIS is 39 times below the threshold.
            return 0.207 + 0.208 * math.sin(time) ** 3
        # The error of a receiver that stands hardly changes.
        scale = 0.05 if speed == 0.0 and turn == 0.0 else 0.6
        return self._nis(3, scale * (0.3 if self.resembles("idle_gate") else 1.0))

    def _diagnostics(self, time: float) -> Message:
        status = [
            {"level": 0, "name": f"filter: {sensor}", "message": "OK", "hardware_id": "filter"}
            for sensor in ("IMU", "wheel", "GPS", "output")
        ]
        return Message(time + 0.02, "/diagnostics", {"header": header(time, ""), "status": status})


def header(time: float, frame: str) -> Dict[str, Any]:
    """Return the fields of a header."""
    seconds, nanoseconds = divmod(round(time * SECOND), SECOND)
    return {"stamp": {"sec": START + seconds, "nanosec": nanoseconds}, "frame_id": frame}


def rotation(yaw: float) -> Dict[str, float]:
    """Return the fields of a quaternion about the vertical axis."""
    return {"z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}


class RecordingError(Exception):
    """A recording cannot be written."""


class MessageTypes:
    """Types of ROS 2 or of ROS 1, and messages of them from fields by name.

    Args:
        version: 1 or 2, the generation of ROS.
    """

    def __init__(self, version: int):
        self.version = version
        self.store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
        if "tf2_msgs/msg/TFMessage" not in self.store.types:
            definition = "geometry_msgs/TransformStamped[] transforms\n"
            self.store.register(get_types_from_msg(definition, "tf2_msgs/msg/TFMessage"))
        # Old versions of rosbags have the upper-case name.
        self._definitions = getattr(self.store, "fielddefs", None) or self.store.FIELDDEFS

    def serialize(self, fields: Dict[str, Any], name: str) -> bytes:
        """Return a message as its bytes in a bag. Fields that are not named are zero, empty or false."""
        message = self.create(fields, name)
        if self.version == 1:
            return bytes(self.store.serialize_ros1(message, name))
        return bytes(self.store.serialize_cdr(message, name))

    def create(self, fields: Dict[str, Any], name: str) -> Any:
        """Return a message of rosbags."""
        definitions = dict(self._definitions[name][1])
        values = {field: self._value(kind, fields.get(field)) for field, kind in definitions.items()}
        return self.store.types[name](**values)

    def _value(self, kind: Any, value: Any) -> Any:
        node, description = int(kind[0]), kind[1]
        if node == 1:  # a number, a bool or a string
            base = description[0]
            return value if value is not None else "" if base == "string" else False if base == "bool" else 0
        if node == 2:  # a message
            return self.create(value or {}, description)
        (element_node, element), length = description
        if int(element_node) == 1:
            return numpy.array(value if value is not None else [0] * length, dtype=element[0])
        return [self.create(item, element) for item in value or []]


def write_recording(path: Path, messages: List[Message], bag_format: str) -> None:
    """Write a bag: ``mcap`` or ``db3`` (folders of ROS 2), or ``bag`` (a file of ROS 1).

    Raises:
        RecordingError: if the path exists, or the installed version of rosbags cannot write the format.
    """
    if path.exists():
        raise RecordingError(f"{path}: it exists already: remove it, or choose another folder")
    types = MessageTypes(1 if bag_format == "bag" else 2)
    with tempfile.TemporaryDirectory(prefix=".unfinished-", dir=path.parent) as folder:
        unfinished = Path(folder) / path.name
        with open_writer(unfinished, bag_format) as writer:
            connections = {
                topic: writer.add_connection(topic, name, typestore=types.store)
                for topic, name in TOPICS.items()
            }
            for message in messages:
                data = types.serialize(message.fields, TOPICS[message.topic])
                writer.write(connections[message.topic], START * SECOND + round(message.time * SECOND), data)
        unfinished.rename(path)


def open_writer(path: Path, bag_format: str) -> Any:
    """Return a writer of rosbags for a format."""
    if bag_format == "bag":
        return rosbag1.Writer(path)
    if hasattr(rosbag2, "StoragePlugin"):
        plugin = rosbag2.StoragePlugin.MCAP if bag_format == "mcap" else rosbag2.StoragePlugin.SQLITE3
        return rosbag2.Writer(path, version=9, storage_plugin=plugin)
    if bag_format == "mcap":
        raise RecordingError("this version of rosbags writes no MCAP files: choose --format db3 or bag")
    return rosbag2.Writer(path)


def write_cases(folder: Path, cases: List[str], bag_format: str, seed: int) -> List[Path]:
    """Write both recordings of each case; return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for case in cases:
        for faulty in (True, False):
            name = f"{case}_{'fault' if faulty else 'healthy'}"
            path = folder / (f"{name}.bag" if bag_format == "bag" else name)
            write_recording(path, list(Robot(case, faulty, seed).messages()), bag_format)
            paths.append(path)
    return paths


def main() -> int:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="folder of the recordings; it is created")
    parser.add_argument(
        "--case", action="append", choices=CASES, help="a case, all if not given; can be repeated"
    )
    parser.add_argument(
        "--format", choices=("mcap", "db3", "bag"), default="mcap", help="ROS 2 (default mcap) or ROS 1"
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the noise (default 1)")
    options = parser.parse_args()
    try:
        for path in write_cases(options.folder, options.case or list(CASES), options.format, options.seed):
            print(path)
    except (RecordingError, OSError) as error:
        print(f"make_recordings: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
