"""Small bags for the comparison of node configurations: with and without stamps, repeated, out of order, nested."""

import random
from typing import NamedTuple, Tuple

from harness import DEFINITIONS

from retalis import BagWriter, Operators
from retalis.prolog.syntax.term_reader import read_term

SECOND = 10**9
START = 1_000_000_000 * SECOND
LINE = "=" * 80

KINDS = {
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
KINDS["others"] = KINDS["numbers"]
KINDS["asked"] = KINDS["poses"]
"""The topics with their types, of which three are installed nowhere; some have the same.

A goal subscribes to the last one."""


class Kind(NamedTuple):
    """What a bag has in it: topics, seconds from one message to the next, and what stamps are like."""

    name: str
    topics: Tuple[str, ...]
    step: float
    stamps: str = "rising"


BAGS = (
    Kind("no stamps, time stands", ("notes", "numbers"), 0),
    Kind("no stamps, time runs", ("notes", "numbers", "others"), 0.3),
    Kind("stamps, time stands", ("marks", "poses"), 0),
    Kind("stamps, time runs", ("marks", "poses", "asked"), 0.25),
    Kind("the same stamps", ("marks", "poses"), 0.1, "same"),
    Kind("stamps out of order", ("marks", "poses"), 0.2, "shuffled"),
    Kind("zero stamps", ("marks",), 0, "zero"),
    Kind("all topics, time stands", tuple(KINDS), 0),
    Kind("all topics, time runs", tuple(KINDS), 0.5),
    Kind("all topics, stamps of years ago", tuple(KINDS), 0.4, "old"),
)


def write_bag(path, number, kind):
    """Write the bag of a kind; return its path."""
    draw = random.Random(number)
    start = START + 1000 * number * SECOND
    with BagWriter(path) as bag:
        connections = {topic: bag.add(f"/{topic}", KINDS[topic]) for topic in kind.topics}
        for at in range(24):
            topic = kind.topics[at] if at < len(kind.topics) else draw.choice(kind.topics)
            now = start + int(at * kind.step * SECOND)
            text = _TERMS[topic](draw, number, _stamp(draw, kind.stamps, start, at))
            term = read_term(text, Operators.prolog()).term
            bag.write(connections[topic], now, DEFINITIONS.encoder(KINDS[topic]).encode(term, topic))
    return path


def _stamp(draw, stamps, start, at):
    """Return the stamp of a message, in nanoseconds."""
    if stamps == "zero":
        return 0
    if stamps == "same":
        return start + at // 6 * SECOND
    if stamps == "shuffled":
        return start + draw.randrange(8) * SECOND
    if stamps == "old":
        return start - 400_000_000 * SECOND + at
    return start + at * SECOND // 7


def _string(draw):
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


def _header(draw, stamp):
    seconds, nanoseconds = divmod(stamp, SECOND)
    return f"std_msgs__0__Header({draw.randrange(9)},[{seconds},{nanoseconds}],'\"{_string(draw)}\"')"


def _note(draw, run, stamp):
    return f"configuration_msgs__0__Note({run},'\"{_string(draw)}\"')"


def _number(draw, run, stamp):
    return f"configuration_msgs__0__Number({run},{draw.choice(['1.5', '0.0', '-2.5e300', 'inf', '3.0'])})"


def _part(draw):
    floats = ",".join(str(draw.randrange(-8, 8) / 4) for _ in range(3))
    gaps = ",".join(f"[{draw.randrange(9)},{draw.randrange(SECOND)}]" for _ in range(draw.randrange(3)))
    ok = draw.choice(["true", "false"])
    text = _string(draw)
    return f"configuration_msgs__0__Part('\"{text}\"',[{floats}],{ok},[{draw.randrange(9)},5],[{gaps}],'\"xyz\"')"


def _mark(draw, run, stamp):
    parts = ",".join(_part(draw) for _ in range(draw.randrange(4)))
    return f"configuration_msgs__0__Mark({_header(draw, stamp)},{run},[{parts}])"


def _pose(draw, run, stamp):
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
