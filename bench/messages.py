#!/usr/bin/env python3
"""Time of decoding and encoding messages, against genpy where ROS is installed.

Prints a line for each case: ``case CASE TYPE us_per_message U genpy U ratio R``. ``decode`` reads all fields
that the NAO's rules use; ``look`` also decodes the lazy parts; ``encode`` starts from the decoded term.
"""

import argparse
import importlib
import io
import json
import struct
import sys
from pathlib import Path
from time import perf_counter
from typing import Any, Callable, Dict, Iterator, List, Optional, Tuple

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "bench"), str(ROOT / "src"), str(ROOT / "examples" / "nao")]

import nao_messages  # noqa: E402
from arguments import positive, target  # noqa: E402
from nao_robot import Robot  # noqa: E402

from retalis import Definition, Definitions, deref  # noqa: E402

BATCH = 2000


def best(function: Callable[[Any], Any], argument: Any, repeats: int) -> float:
    """Return the microseconds per call of the fastest batch."""
    times = []
    for _ in range(repeats):
        start = perf_counter()
        for _ in range(BATCH):
            function(argument)
        times.append(perf_counter() - start)
    return min(times) / BATCH * 1e6


def messages(known: Definitions) -> Iterator[Tuple[str, Definition, bytes]]:
    """Yield name, type and bytes of the messages to measure."""
    types = nao_messages.definitions()
    robot = Robot(1)
    stamp = 1413748205_981209993
    link = robot.chain[1]
    transform = nao_messages.transform(3, stamp, link.parent, link.child, link.pose(0.7))
    marker = nao_messages.marker(3, stamp, "4x4_1", robot.seen("4x4_1", 0.7), 50)
    faces = nao_messages.faces(3, stamp, stamp, ["anna"], [0.9])
    for kind, term in zip(types, (transform, marker, faces)):
        yield kind, types[kind], known.encoder(types[kind]).encode(term)
    one = known.encoder(types["tf/tfMessage"]).encode(transform)
    yield "tf/tfMessage (10 transforms)", types["tf/tfMessage"], struct.pack("<I", 10) + one[4:] * 10
    header = struct.pack("<IIII4s", 3, 5, 7, 4, b"odom")
    for kind, data in (
        ("geometry_msgs/PoseStamped", header + struct.pack("<7d", *range(7))),
        ("nav_msgs/Odometry", header + struct.pack("<I4s85d", 4, b"base", *range(85))),
        ("sensor_msgs/LaserScan", header + struct.pack("<7fI640fI", *range(7), 640, *range(640), 0)),
        (
            "sensor_msgs/Image",
            header + struct.pack("<III4sBII", 480, 640, 4, b"rgb8", 0, 1920, 921600) + bytes(921600),
        ),
        ("std_msgs/String", struct.pack("<I", 11) + b"hello world"),
        ("geometry_msgs/Twist", struct.pack("<6d", *range(6))),
    ):
        if kind in known:
            yield kind, known.find(kind), data


def look(term: Any) -> None:
    """Decode all lazy parts of a term."""
    stack = [term]
    while stack:
        term = deref(stack.pop())
        if term.__class__ is tuple:
            stack.extend(term[1:])


def genpy_functions(definition: Definition) -> Optional[Tuple[Callable[[bytes], Any], Callable[[Any], Any]]]:
    """Return genpy's functions to decode and encode a type; None if it has none."""
    package, kind = definition.name.split("/")
    try:
        generated = getattr(importlib.import_module(package + ".msg"), kind)
    except (ImportError, AttributeError):
        return None

    def encode(message: Any) -> bytes:
        out = io.BytesIO()
        message.serialize(out)
        return out.getvalue()

    return lambda data: generated().deserialize(data), encode


def measure(repeats: int) -> List[Dict[str, Any]]:
    known = Definitions()
    results = []
    for name, definition, data in messages(known):
        decoder, encode = known.decoder(definition), known.encoder(definition).encode
        term = decoder.decode(data)
        theirs = genpy_functions(definition)
        cases: List[Tuple[str, Callable[[Any], Any], Any, Optional[Callable[[Any], Any]], Any]] = [
            ("stamp", decoder.stamp, data, None, None),
            ("decode", decoder.decode, data, theirs and theirs[0], data),
            ("encode", encode, term, theirs and theirs[1], theirs and theirs[0](data)),
        ]
        if len(data) < 100_000:
            cases.insert(2, ("look", lambda raw, read=decoder.decode: look(read(raw)), data, None, None))
        for case, function, argument, other, given in cases:
            ours = best(function, argument, repeats)
            genpy = best(other, given, repeats) if other else None
            results.append({"case": case, "message": name, "us": ours, "genpy_us": genpy})
            report(results[-1])
    return results


def report(result: Dict[str, Any]) -> None:
    line = f"case {result['case']} {result['message']} us_per_message {result['us']:.3f}"
    if result["genpy_us"] is not None:
        line += f" genpy {result['genpy_us']:.3f} ratio {result['us'] / result['genpy_us']:.2f}"
    print(line, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument(
        "--repeats", type=positive, default=7, help="batches of which the fastest counts (default 7)"
    )
    parser.add_argument("--json", type=target, metavar="FILE", help="also write the results there")
    given = parser.parse_args()
    results = measure(given.repeats)
    if given.json:
        Path(given.json).write_text(json.dumps({"python": sys.version, "results": results}, indent=1) + "\n")


if __name__ == "__main__":
    main()
