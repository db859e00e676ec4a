"""Small bags for the comparison of a node with playback: with and without stamps, repeated, out of order, nested."""

import random
from typing import Any, NamedTuple, Tuple

from retalis import BagWriter, Definitions, Operators
from retalis.prolog.syntax.term_reader import read_term

SECOND = 10**9
START = 1_000_000_000 * SECOND
LINE = "=" * 80
DEFINITIONS = Definitions()

DEFINITIONS_BY_TOPIC = {
    "notes": DEFINITIONS.add("configuration_msgs/Note", "int32 run\nstring text"),
    "numbers": DEFINITIONS.add("configuration_msgs/Number", "int32 run\nfloat64 number"),
    "marks": DEFINITIONS.add(
        "configuration_msgs/Mark",
        f"Header header\nint32 run\nPart[] parts\n{LINE}\nMSG: configuration_msgs/Part\n"
        "string name\nfloat32[3] place\nbool ok\ntime when\nduration[] gaps\nuint8[] data\n"
        f"{LINE}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id",
    ),
    "poses": DEFINITIONS.find("geometry_msgs/PoseStamped"),
}
DEFINITIONS_BY_TOPIC["others"] = DEFINITIONS_BY_TOPIC["numbers"]
DEFINITIONS_BY_TOPIC["asked"] = DEFINITIONS_BY_TOPIC["poses"]
"""Definitions by topic; three of the types are not installed. A goal subscribes to the last topic."""


class BagSpecification(NamedTuple):
    """Contents of a bag.

    Attributes:
        name: description of the bag.
        topics: topics of the messages.
        step: seconds between messages.
        stamps: order of the stamps.
    """

    name: str
    topics: Tuple[str, ...]
    step: float
    stamps: str = "rising"


BAGS = (
    BagSpecification("no stamps, time stands", ("notes", "numbers"), 0),
    BagSpecification("no stamps, time runs", ("notes", "numbers", "others"), 0.3),
    BagSpecification("stamps, time stands", ("marks", "poses"), 0),
    BagSpecification("stamps, time runs", ("marks", "poses", "asked"), 0.25),
    BagSpecification("the same stamps", ("marks", "poses"), 0.1, "same"),
    BagSpecification("stamps out of order", ("marks", "poses"), 0.2, "shuffled"),
    BagSpecification("zero stamps", ("marks",), 0, "zero"),
    BagSpecification("all topics, time stands", tuple(DEFINITIONS_BY_TOPIC), 0),
    BagSpecification("all topics, time runs", tuple(DEFINITIONS_BY_TOPIC), 0.5),
    BagSpecification("all topics, stamps of years ago", tuple(DEFINITIONS_BY_TOPIC), 0.4, "old"),
)


def write_bag(path: Any, number: Any, specification: Any) -> Any:
    """Write the bag of a specification; return its path."""
    draw = random.Random(number)
    start = START + 1000 * number * SECOND
    with BagWriter(path) as bag:
        connections = {
            topic: bag.add(f"/{topic}", DEFINITIONS_BY_TOPIC[topic]) for topic in specification.topics
        }
        for index in range(24):
            topic = (
                specification.topics[index]
                if index < len(specification.topics)
                else draw.choice(specification.topics)
            )
            now = start + int(index * specification.step * SECOND)
            text = _TERMS[topic](draw, number, _stamp(draw, specification.stamps, start, index))
            term = read_term(text, Operators.prolog()).term
            bag.write(
                connections[topic], now, DEFINITIONS.encoder(DEFINITIONS_BY_TOPIC[topic]).encode(term, topic)
            )
    return path


def _stamp(draw: Any, stamps: Any, start: Any, index: Any) -> Any:
    """Return the stamp of a message, in nanoseconds."""
    if stamps == "zero":
        return 0
    if stamps == "same":
        return start + index // 6 * SECOND
    if stamps == "shuffled":
        return start + draw.randrange(8) * SECOND
    if stamps == "old":
        return start - 400_000_000 * SECOND + index
    return start + index * SECOND // 7


def _string(draw: Any) -> Any:
    return draw.choice(
        [
            "keep",
            "a, [b",
            "",
            "gr\u00fcn",
            "4x4_1",
            "back\\\\slash",
            "keep",
            "\u65e5\u672c \U0001f916",
            "two\\nlines",
        ]
    )


def _header(draw: Any, stamp: Any) -> str:
    seconds, nanoseconds = divmod(stamp, SECOND)
    return f"std_msgs__0__Header({draw.randrange(9)},[{seconds},{nanoseconds}],'\"{_string(draw)}\"')"


def _note(draw: Any, run: Any, stamp: Any) -> str:
    return f"configuration_msgs__0__Note({run},'\"{_string(draw)}\"')"


def _number(draw: Any, run: Any, stamp: Any) -> str:
    return f"configuration_msgs__0__Number({run},{draw.choice(['1.5', '0.0', '-2.5e300', 'inf', '3.0'])})"


def _part(draw: Any) -> str:
    floats = ",".join(str(draw.randrange(-8, 8) / 4) for _ in range(3))
    gaps = ",".join(f"[{draw.randrange(9)},{draw.randrange(SECOND)}]" for _ in range(draw.randrange(3)))
    ok = draw.choice(["true", "false"])
    text = _string(draw)
    return f"configuration_msgs__0__Part('\"{text}\"',[{floats}],{ok},[{draw.randrange(9)},5],[{gaps}],'\"xyz\"')"


def _mark(draw: Any, run: Any, stamp: Any) -> str:
    parts = ",".join(_part(draw) for _ in range(draw.randrange(4)))
    return f"configuration_msgs__0__Mark({_header(draw, stamp)},{run},[{parts}])"


def _pose(draw: Any, run: Any, stamp: Any) -> str:
    x = draw.randrange(100) / 8
    return (
        f"geometry_msgs__0__PoseStamped({_header(draw, stamp)},geometry_msgs__0__Pose("
        f"geometry_msgs__0__Point({x},0.0,-1.0),geometry_msgs__0__Quaternion(0.0,0.0,0.0,1.0)))"
    )


_TERMS = {
    "notes": _note,
    "numbers": _number,
    "others": _number,
    "marks": _mark,
    "poses": _pose,
    "asked": _pose,
}
