"""Recipes for scans, images, clouds, maps and joints: their measurements equal those of numpy.

The bags are read with rosbags, and the messages with numpy only.
"""

import math
from pathlib import Path
from types import ModuleType
from typing import Any, Dict, List, Tuple

import pytest

numpy = pytest.importorskip("numpy")
from rosbags.rosbag1 import Reader  # noqa: E402
from rosbags.typesys import Stores, get_typestore  # noqa: E402

from retalis import (  # noqa: E402
    BagReader,
    Definitions,  # noqa: E402
    Engine,
    Playback,
    to_python,
)

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "cookbook"
STORE = get_typestore(Stores.ROS1_NOETIC)


@pytest.fixture
def play(recipes: ModuleType, definitions: Definitions, tmp_path: Path) -> Any:
    """Return a function that plays a recipe and returns its events and the messages of its bag, read by rosbags."""

    def run(name: Any) -> Tuple[Any, ...]:
        path = tmp_path / f"{name}.bag"
        recipes.make_bag(FOLDER / name, path, definitions)
        problems: List[Any] = []
        events: List[Any] = []
        playback = Playback(FOLDER / name, problems.append)
        playback.engine.on_event(lambda term, start, end: events.append(values_of(term)))
        with BagReader(path) as bag:
            for _ in playback.run(bag):
                pass
        assert problems == []
        with Reader(path) as reader:
            messages = [
                (time, connection.topic, STORE.deserialize_ros1(raw, connection.msgtype))
                for connection, time, raw in reader.messages()
            ]
        return events, messages

    return run


def values_of(term: Any) -> Any:
    """Return an event of the program as a Python value; None for a message, which may be large."""
    return to_python(term) if term.__class__ is tuple and "__0__" not in term[0].name else None


def arguments_of(events: Any, name: str) -> List[Any]:
    """Return the arguments of the events of a name, in order."""
    return [event.args for event in events if event is not None and event.name == name]


def test_nearest_reading_ahead_equals_numpy(play: Any) -> None:
    events, messages = play("obstacle")
    expected: List[Any] = []
    for _, _, scan in messages:
        angles = scan.angle_min + scan.angle_increment * numpy.arange(len(scan.ranges))
        ahead = scan.ranges[numpy.abs(angles) <= 0.25]
        valid = ahead[numpy.isfinite(ahead) & (ahead >= scan.range_min) & (ahead <= scan.range_max)]
        expected.append([float(valid.min()) if len(valid) else scan.range_max])
    assert arguments_of(events, "ahead") == expected
    assert arguments_of(events, "obstacle") == changes(
        "near" if d < 0.5 else "far" if d > 0.75 else None for (d,) in expected
    )


def changes(states: Any) -> List[List[Any]]:
    """Return the states that differ from the previous one, without None."""
    known_states = [state for state in states if state is not None]
    return [[state] for before, state in zip([None, *known_states], known_states) if state != before]


def test_mean_of_image_centre_equals_numpy(play: Any) -> None:
    events, messages = play("dark_image")
    expected: List[Any] = []
    for _, _, image in messages:
        rows = image.data.reshape(image.height, image.step)[:, : 3 * image.width]
        y, x = image.height // 4, image.width // 4
        middle = rows.reshape(image.height, image.width, 3)[
            y : y + image.height // 2, x : x + image.width // 2
        ]
        expected.append(middle.astype(float).mean())
    measured = [mean for (mean,) in arguments_of(events, "brightness")]
    assert measured == pytest.approx(expected, rel=1e-12)
    assert arguments_of(events, "light") == changes(
        "dark" if m < 40 else "bright" if m > 60 else None for m in expected
    )


def test_point_counts_in_zones_equal_numpy(play: Any) -> None:
    zones = {"door": ((1.5, -0.5, 0.25), (2.5, 0.5, 2.0)), "shelf": ((-0.5, 1.0, 0.25), (1.0, 2.0, 2.0))}
    events, messages = play("cloud_zone")
    expected: List[Any] = []
    for _, _, cloud in messages:
        points = cloud.data.view("<f4").reshape(-1, 4)[:, :3].astype(float)
        assert numpy.isnan(points).any()
        with numpy.errstate(invalid="ignore"):
            expected += [
                [zone, int(((points >= low) & (points <= high)).all(axis=1).sum())]
                for zone, (low, high) in zones.items()
            ]
    assert arguments_of(events, "points") == expected
    for zone in zones:
        states = changes(
            "taken" if count >= 10 else "free" if count <= 2 else None
            for name, count in expected
            if name == zone
        )
        assert len(states) > 1
        assert [[state] for name, state in arguments_of(events, "zone_is") if name == zone] == states


def test_cells_of_goals_equal_numpy(play: Any) -> None:
    events, messages = play("map_cell")
    grid: Any = None
    expected: List[Any] = []
    for _, topic, message in messages:
        if topic == "/map":
            grid = message
            continue
        info, position = grid.info, message.pose.position
        turn = 2 * math.atan2(info.origin.orientation.z, info.origin.orientation.w)
        inverse = numpy.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
        local = inverse @ [position.x - info.origin.position.x, position.y - info.origin.position.y]
        column, row = numpy.floor(local / info.resolution).astype(int)
        if not (0 <= column < info.width and 0 <= row < info.height):
            state = "outside"
        else:
            cell = grid.data.reshape(info.height, info.width)[row, column]
            state = "unknown" if cell < 0 else "occupied" if cell >= 65 else "free"
        if state != "free":
            expected.append([position.x, position.y, state])
    assert {state for *_, state in expected} == {"outside", "unknown", "occupied"}
    assert arguments_of(events, "refused") == expected


def test_mean_efforts_equal_numpy(play: Any) -> None:
    events, messages = play("joint_effort")
    expected: List[Any] = []
    for now, _, newest in messages:
        window = [state.effort for time, _, state in messages if time <= now and now - time < 2 * 10**9]
        expected += [[joint, mean] for joint, mean in zip(newest.name, numpy.mean(window, axis=0).tolist())]
    measured = [[joint.strip('"'), mean] for joint, mean in arguments_of(events, "mean")]
    assert [joint for joint, _ in measured] == [joint for joint, _ in expected]
    assert [mean for _, mean in measured] == pytest.approx([mean for _, mean in expected], rel=1e-12)
    states: Dict[Any, Any] = {}
    for joint in ("shoulder", "elbow", "wrist"):
        means = [mean for name, mean in expected if name == joint]
        states[joint] = changes("strained" if mean > 6 else "relaxed" if mean < 4 else None for mean in means)
        joint_states = [[state] for name, state in arguments_of(events, "joint_is") if name == f'"{joint}"']
        assert joint_states == states[joint]
    assert list(map(len, states.values())) == [1, 3, 2]


@pytest.mark.parametrize("name", ["dark_image", "cloud_zone", "map_cell", "obstacle", "joint_effort"])
def test_messages_as_text_have_same_outputs(
    name: str, recipes: ModuleType, definitions: Definitions, tmp_path: Path
) -> None:
    """A separate interface node sends messages as text."""
    path = tmp_path / "recipe.bag"
    recipes.make_bag(FOLDER / name, path, definitions)
    playback = Playback(FOLDER / name, print)
    with BagReader(path) as bag:
        expected = [(playback.engine.show(output.term), output.topic) for output in playback.run(bag)]
    engine = Engine()
    outputs: List[Tuple[str, str]] = []
    engine.load_program(FOLDER / name)
    engine.on_output(lambda term, topic, _: outputs.append((engine.show(term), topic)))
    recipe = recipes.Recipe(FOLDER / name)
    for time, topic, slots in recipe.messages():
        definition = definitions.find(recipe.topics[topic])
        data = definitions.encoder(definition).encode(recipes.to_term(definition, slots, time))
        message = engine.show(definitions.decoder(definition).decode(data))
        engine.post_text(f"event({message},[{time / 1e9!r},{time / 1e9!r}])")
    assert outputs == expected
