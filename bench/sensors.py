#!/usr/bin/env python3
"""Cost of predicates on point clouds and images, from the bytes of a message to the result, beside numpy alone.

    bench/sensors.py [--points N] [--repeats N]

The messages are decoded for each call, as they are when they arrive. All cases run in turn; a figure is the median of
the repeats, in milliseconds of CPU time.

    near        ``cloud_near/4``: points within a radius, in clouds of points of 16 and of 32 bytes
    box         ``cloud_box/4``: points in a box
    field       ``cloud_field/3``: one coordinate of all points as an array
    pixel       ``image_pixel/4`` of an image of 1 MB
    region      ``image_region_mean/6`` of its middle
    mean        ``image_region_mean/6`` of all of it
    numpy ...   the same by numpy, by somebody who knows the layout of the message
    rule        a rule with one region mean, over the same image without a rule: the share of a core that 30 images
                a second take
"""

import argparse
import statistics
import struct
import sys
import time
from pathlib import Path
from typing import Any, Callable, Dict, List

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "src")]

import numpy as np  # noqa: E402
from arguments import positive  # noqa: E402

from retalis import Definitions, Engine, Var, deref, functor, limit_gc_pauses, make_list  # noqa: E402
from retalis.prolog.system.prolog_system import PrologSystem  # noqa: E402

HEADER = struct.pack("<IIII6s", 1, 100, 0, 6, b"sensor")
WIDTH, HEIGHT = 720, 480
IMAGES_PER_SECOND = 30
RULE = """
brightness(M) <- sensor_msgs__0__Image{width: W, height: H}
  where (access_mem(camera, I, _), X is W // 4, Y is H // 4, image_region_mean(I, X, Y, X, Y, [_, M, _]), M < 0).
"""


def cloud(points: int, step: int) -> bytes:
    """Return the message of a cloud with float32 coordinates at the beginning of each point."""
    values = np.zeros((points, step // 4), "<f4")
    values[:, :3] = np.random.RandomState(1).uniform(-10, 10, (points, 3))
    fields = b"".join(
        struct.pack("<I1sIBI", 1, name, 4 * place, 7, 1) for place, name in enumerate((b"x", b"y", b"z"))
    )
    head = struct.pack("<III", 1, points, 3) + fields + struct.pack("<?II", False, step, step * points)
    return HEADER + head + struct.pack("<I", values.nbytes) + values.tobytes() + b"\1"


def image() -> bytes:
    """Return the message of an image of 1 MB."""
    data = np.random.RandomState(1).bytes(WIDTH * HEIGHT * 3)
    head = struct.pack("<III4sBI", HEIGHT, WIDTH, 4, b"rgb8", 0, 3 * WIDTH)
    return HEADER + head + struct.pack("<I", len(data)) + data


def cases(points: int) -> Dict[str, Callable[[], object]]:
    """Return the functions to measure, by name."""
    logic, definitions = PrologSystem(), Definitions()

    def goal(message_type: str, data: bytes, name: str, *inputs: Any) -> Callable[[], object]:
        decoder = definitions.decoder(definitions.find(message_type))
        key = functor(name, len(inputs) + 2)

        def run() -> object:
            result = Var()
            logic.once((key, decoder.decode(data), *inputs, result))
            return deref(result) if name != "cloud_field" else None

        return run

    point, corner = make_list([0, 0, 0]), make_list([5, 5, 5])
    found: Dict[str, Callable[[], object]] = {}
    for step in (16, 32):
        data = cloud(points, step)
        kind = "sensor_msgs/PointCloud2"
        found[f"near {step}"] = goal(kind, data, "cloud_near", point, 5)
        found[f"box {step}"] = goal(kind, data, "cloud_box", point, corner)
        found[f"field {step}"] = goal(kind, data, "cloud_field", functor("x", 0).atom)
        found[f"numpy near {step}"] = lambda data=data, step=step: near(data, points, step)
        found[f"numpy box {step}"] = lambda data=data, step=step: box(data, points, step)
    data, x, y = image(), WIDTH // 4, HEIGHT // 4
    kind = "sensor_msgs/Image"
    found["pixel"] = goal(kind, data, "image_pixel", 300, 200)
    found["region"] = goal(kind, data, "image_region_mean", x, y, 2 * x, 2 * y)
    found["mean"] = goal(kind, data, "image_region_mean", 0, 0, WIDTH, HEIGHT)
    found["numpy region"] = lambda: pixels(data)[y : 3 * y, x : 3 * x].mean(axis=(0, 1))
    found["numpy mean"] = lambda: pixels(data).mean(axis=(0, 1))
    found["rule"], found["no rule"] = rule(data, RULE), rule(data, "")
    return found


def coordinates(data: bytes, points: int, step: int) -> Any:
    """Return the coordinates of a cloud as float64, in three rows."""
    start = len(data) - 1 - points * step
    return np.frombuffer(data, "<f4", points * step // 4, start).reshape(points, -1)[:, :3].T.astype("f8")


def near(data: bytes, points: int, step: int) -> int:
    """Return the number of points near the origin."""
    return int(((coordinates(data, points, step) ** 2).sum(axis=0) <= 25).sum())


def box(data: bytes, points: int, step: int) -> int:
    """Return the number of points in a box."""
    places = coordinates(data, points, step)
    return int(((places >= 0) & (places <= 5)).all(axis=0).sum())


def pixels(data: bytes) -> Any:
    """Return the pixels of an image."""
    return np.frombuffer(data, "u1", HEIGHT * WIDTH * 3, len(data) - HEIGHT * WIDTH * 3).reshape(
        HEIGHT, WIDTH, 3
    )


def rule(data: bytes, rules: str) -> Callable[[], object]:
    """Return a function that gives an image to an engine with a memory of the newest one."""
    engine, definitions = Engine(), Definitions()
    engine.load(rules=rules, goals="memorize(sensor_msgs__0__Image{}, [], _, camera, 1)")
    decoder = definitions.decoder(definitions.find("sensor_msgs/Image"))
    instant = [0]

    def take() -> None:
        instant[0] += 33_000_000
        engine.post(decoder.decode(data), instant[0])

    return take


def main() -> int:
    """Run the benchmark that the command line selects."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=positive, default=100_000, help="of each cloud")
    parser.add_argument("--repeats", type=positive, default=200)
    options = parser.parse_args()
    found = cases(options.points)
    assert found["near 16"]() == found["numpy near 16"]() and found["box 32"]() == found["numpy box 32"]()
    limit_gc_pauses()
    taken: Dict[str, List[float]] = {name: [] for name in found}
    for _ in range(options.repeats):
        for name, run in found.items():
            began = time.process_time()
            run()
            taken[name].append((time.process_time() - began) * 1e3)
    medians = {name: statistics.median(times) for name, times in taken.items()}
    for name, milliseconds in medians.items():
        print(f"{name:<14} {milliseconds:7.3f} ms, at best {min(taken[name]):.3f}")
    share = IMAGES_PER_SECOND * (medians["rule"] - medians["no rule"]) / 10
    print(f"a region mean of {IMAGES_PER_SECOND} images a second: {share:.2f} % of a core")
    return 0


if __name__ == "__main__":
    sys.exit(main())
