"""Clouds, images and maps: answers compared with numpy, and errors of malformed messages."""

import math
import struct
from base64 import b64encode
from typing import Any, Dict, List, Optional, Tuple

import pytest
from asserting_accessors import compound

numpy = pytest.importorskip("numpy")
from hypothesis import given  # noqa: E402
from hypothesis import strategies as st  # noqa: E402

from retalis import (  # noqa: E402
    Atom,  # noqa: E402
    Definitions,
    Limits,
    PrologError,
    String,
    Var,
    atom,
    deref,
    functor,
    list_items,
    make_list,
)
from retalis.prolog.builtins import sensor_predicates  # noqa: E402
from retalis.prolog.system.prolog_system import PrologSystem  # noqa: E402
from retalis.prolog.terms import byte_texts  # noqa: E402

from ..goal_answers import answers, prolog, show  # noqa: E402

DEFINITIONS = Definitions()
LOGIC = PrologSystem()
HEADER = functor("std_msgs__0__Header", 3)(0, make_list([0, 0]), atom('"sensor"'))
FIELD = functor("sensor_msgs__0__PointField", 4)
CLOUD = functor("sensor_msgs__0__PointCloud2", 9)
IMAGE = functor("sensor_msgs__0__Image", 7)
BOOLEANS = {True: atom("true"), False: atom("false")}


def text(name: str) -> Atom:
    return atom(f'"{name}"')


def base64_atom(data: bytes) -> Any:
    """Return bytes as an atom in base64 with lines of 76 characters."""
    encoded = b64encode(data).decode()
    return text("FFFFFFFFFF" + "".join(encoded[i : i + 76] + "////" for i in range(0, len(encoded), 76)))


def call(name: str, *inputs: Any) -> Any:
    """Return the value of the last argument of a predicate; None if it fails."""
    result = Var()
    if not LOGIC.once((functor(name, len(inputs) + 1), *inputs, result)):
        return None
    value = deref(result)
    return list_items(value) if value.__class__ is tuple or value is atom("[]") else value


def error_of(name: str, *inputs: Any) -> Tuple[Any, ...]:
    """Return the formal term and the reason of a predicate's error."""
    with pytest.raises(PrologError) as error:
        call(name, *inputs)
    formal, context = compound(error.value.term)[1:]
    context = deref(context)
    reason = deref(context[2]) if context.__class__ is tuple and len(context) == 3 else None
    return show(formal), getattr(reason, "name", None)


def decoded(term: Any) -> Any:
    """Return a message as it is received from a topic: decoded lazily."""
    definition = DEFINITIONS.find(term[0].name.replace("__0__", "/"))
    return DEFINITIONS.decoder(definition).lazy(DEFINITIONS.encoder(definition).encode(term))


def equal_numbers(left: Any, right: Any) -> bool:
    """Return whether two lists contain the same numbers, where nan equals nan."""
    return len(left) == len(right) and all(
        type(left_number) is type(right_number)
        and (left_number == right_number or (left_number != left_number and right_number != right_number))
        for left_number, right_number in zip(left, right)
    )


# Point clouds

TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


class Cloud:
    """A random cloud, with the structured array that its bytes are read by."""

    def __init__(
        self, height: Any, width: Any, fields: Any, gaps: Any, row_padding: Any, big: Any, seed: Any
    ) -> None:
        self.fields: List[Any] = []
        self.names: List[Any] = []
        offset = gaps[0]
        layout: Dict[Any, Any] = {}
        for index, (name, code, count) in enumerate(fields):
            kind = (">" if big else "<") + TYPES[code]
            layout[name] = (numpy.dtype((kind, (count or 1,))), offset)
            self.fields.append(FIELD(text(name), offset, code, count))
            offset += numpy.dtype(kind).itemsize * (count or 1) + gaps[index + 1]
        self.point_step, self.row_step = offset, width * offset + row_padding
        self.layout = numpy.dtype(
            {
                "names": list(layout),
                "formats": [form for form, _ in layout.values()],
                "offsets": [start for _, start in layout.values()],
                "itemsize": offset,
            }
        )
        self.data = numpy.random.RandomState(seed).bytes(height * self.row_step)
        self.height, self.width, self.big = height, width, big

    def term(self, **changes: Any) -> Any:
        slots = {
            "header": HEADER,
            "height": self.height,
            "width": self.width,
            "fields": make_list(self.fields),
            "is_bigendian": BOOLEANS[self.big],
            "point_step": self.point_step,
            "row_step": self.row_step,
            "data": base64_atom(self.data),
            "is_dense": BOOLEANS[False],
        }
        assert set(changes) <= set(slots)
        return CLOUD(*{**slots, **changes}.values())

    def values(self, name: Any) -> Any:
        """Return the values of a field, read row by row."""
        rows = [
            numpy.frombuffer(
                self.data[row * self.row_step : row * self.row_step + self.width * self.point_step],
                self.layout,
            )[name].reshape(-1)
            for row in range(self.height)
        ]
        return numpy.concatenate(rows) if rows else numpy.empty(0)


@st.composite
def clouds(draw: Any) -> Cloud:
    names = draw(st.lists(st.sampled_from("abcdef"), min_size=1, max_size=4, unique=True))
    fields = [(name, draw(st.integers(1, 8)), draw(st.integers(0, 3))) for name in names]
    gaps = [draw(st.integers(0, 5)) for _ in range(len(names) + 1)]
    size = st.integers(0, 5)
    return Cloud(
        draw(size),
        draw(size),
        fields,
        gaps,
        draw(st.integers(0, 9)),
        draw(st.booleans()),
        draw(st.integers(0, 999)),
    )


@given(clouds())
def test_cloud_field_has_values_of_layout(cloud: Any) -> None:
    for message in (cloud.term(), decoded(cloud.term())):
        for field in cloud.fields:
            name = field[1].name.strip('"')
            expected = cloud.values(name).tolist()
            assert equal_numbers(call("cloud_field", message, atom(name)), expected)
            assert equal_numbers(call("cloud_field", message, field[1]), expected)
            assert equal_numbers(call("cloud_field", message, String(name)), expected)


def xyz(
    points: Any,
    kinds: Any = ("f4", "f4", "f4"),
    big: bool = False,
    height: int = 1,
    padding: int = 0,
    extra: int = 0,
) -> Tuple[Any, ...]:
    """Return a cloud of points and the stored coordinates as an array of shape (n, 3)."""
    order = ">" if big else "<"
    codes = {form: code for code, form in TYPES.items()}
    fields = [(name, codes[kind], 1) for name, kind in zip("xyz", kinds)]
    cloud = Cloud(height, len(points) // height, fields, [0, 0, 0, extra], padding, big, 0)
    rows: List[Any] = []
    stored = numpy.zeros((len(points), 3))
    for row in range(height):
        part = b""
        for index in range(row * cloud.width, (row + 1) * cloud.width):
            for axis, kind in enumerate(kinds):
                value = numpy.array(points[index][axis]).astype(order + kind)
                stored[index, axis] = value
                part += value.tobytes()
            part += bytes(extra)
        rows.append(part + bytes(padding))
    cloud.data = b"".join(rows)
    return cloud, stored


COORDINATE = st.one_of(
    st.floats(-4, 4, width=32), st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 1.0, 3.0, 4.0])
)


@given(
    st.lists(st.tuples(COORDINATE, COORDINATE, COORDINATE), max_size=12),
    st.sampled_from([1, 2, 3]),
    st.integers(0, 5),
    st.integers(0, 5),
    st.booleans(),
    st.sampled_from([("f4", "f4", "f4"), ("f8", "f4", "f8")]),
    st.lists(st.floats(-4, 4), min_size=6, max_size=6),
    st.floats(0, 6),
)
def test_points_in_box_and_sphere_are_counted(
    points: List[Any],
    height: Any,
    padding: int,
    extra: int,
    big: bool,
    kinds: Any,
    box: List[Any],
    radius: float,
) -> None:
    points = points[: len(points) // height * height]
    cloud, stored = xyz(points, kinds, big, height, padding, extra)
    low, high = [min(a, b) for a, b in zip(box[:3], box[3:])], [max(a, b) for a, b in zip(box[:3], box[3:])]
    with numpy.errstate(invalid="ignore"):
        inside = ((stored >= low) & (stored <= high)).all(axis=1).sum() if len(stored) else 0
        close = (((stored - box[:3]) ** 2).sum(axis=1) <= radius**2).sum() if len(stored) else 0
    for message in (cloud.term(), decoded(cloud.term())):
        assert call("cloud_box", message, make_list(low), make_list(high)) == inside
        assert call("cloud_near", message, make_list(box[:3]), radius) == close


@pytest.mark.parametrize("block", [1, 7, 64])
@pytest.mark.parametrize(("height", "padding"), [(1, 0), (30, 0), (30, 4), (300, 4)])
def test_large_clouds_are_counted_in_blocks(
    block: int, height: int, padding: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sensor_predicates, "_POINTS_PER_BLOCK", block)
    points = numpy.random.RandomState(1).uniform(-2, 2, (600, 3))
    cloud, stored = xyz(points, height=height, padding=padding)
    inside = int(((stored >= -1) & (stored <= 1)).all(axis=1).sum())
    assert 0 < inside < 600
    assert call("cloud_box", cloud.term(), make_list([-1] * 3), make_list([1] * 3)) == inside
    near = int(((stored**2).sum(axis=1) <= 1).sum())
    assert call("cloud_near", cloud.term(), make_list([0] * 3), 1) == near


def test_integer_coordinates_are_counted() -> None:
    cloud, _ = xyz([(1, 2, 3), (-1, 0, 2)], ("i2", "i1", "u1"))
    assert call("cloud_box", cloud.term(), make_list([0, 0, 0]), make_list([3, 3, 3])) == 1
    assert call("cloud_near", cloud.term(), make_list([-1, 0, 0]), 2) == 1


def test_box_limit_is_not_rounded_to_float32() -> None:
    cloud, _ = xyz([(0.1, 0.0, 0.0)])  # as float32, 0.1 is a little more
    box = make_list([0, 0, 0])
    assert call("cloud_box", cloud.term(), box, make_list([0.1, 1, 1])) == 0
    assert call("cloud_box", cloud.term(), box, make_list([0.1000001, 1, 1])) == 1


def test_renamed_cloud_event_is_accepted() -> None:
    cloud, _ = xyz([(0, 0, 0)])
    own = functor("front_cloud", 9)(*cloud.term()[1:])
    assert call("cloud_near", own, make_list([0, 0, 0]), 1) == 1


GOOD, _ = xyz([(0, 0, 0), (1, 1, 1)])


@pytest.mark.parametrize(
    ("changes", "formal", "reason"),
    [
        ({"data": text("abc")}, "domain_error(data,3)", "data: 3 bytes, expected height * row_step = 24"),
        ({"data": atom("[]")}, "domain_error(data,0)", "data: 0 bytes, expected height * row_step = 24"),
        ({"height": 2}, "domain_error(data,24)", "data: 24 bytes, expected height * row_step = 48"),
        (
            {"width": 3},
            "domain_error(row_step,24)",
            "row_step: 24 bytes, expected width * point_step = 36 or more",
        ),
        (
            {"width": 1 << 80},
            "domain_error(row_step,24)",
            f"row_step: 24 bytes, expected width * point_step = {12 << 80} or more",
        ),
        (
            {"point_step": 11, "row_step": 24},
            "domain_error(point_step,11)",
            "point_step: 11 bytes, expected 12 or more for z",
        ),
        ({"point_step": 0}, "domain_error(point_step,0)", "point_step: 0 bytes, expected 4 or more for x"),
        ({"height": -1}, "domain_error(height,-1)", "height: -1, expected 0 or more"),
        ({"width": 1.0}, "type_error(integer,1.0)", "slot width"),
        ({"fields": make_list([])}, "existence_error(field,x)", "the cloud has no fields"),
        ({"fields": make_list([FIELD(text("u"), 0, 7, 1)])}, "existence_error(field,x)", "the cloud has u"),
        ({"fields": make_list([atom("x")])}, "type_error('sensor_msgs/PointField',x)", "slot fields"),
        ({"fields": 7}, "type_error(list,7)", "slot fields"),
        (
            {"fields": make_list([FIELD(text("x"), 0, 9, 1)])},
            "domain_error('fields.datatype',9)",
            "fields.datatype: 9 of x, expected 1 to 8",
        ),
        (
            {"fields": make_list([FIELD(text("x"), 0, 7, 2)])},
            "domain_error('fields.count',2)",
            "fields.count: 2 of x, expected 1",
        ),
        (
            {"fields": make_list([FIELD(text("x"), -4, 7, 1)])},
            "domain_error('fields.offset',-4)",
            "fields.offset: -4, expected 0 or more",
        ),
        ({"fields": make_list([FIELD(5, 0, 7, 1)])}, "type_error(text,5)", "slot fields.name"),
        ({"is_bigendian": atom("maybe")}, "type_error(bool,maybe)", "slot is_bigendian"),
        ({"data": make_list([1, 256])}, "type_error(bytes,[1,256])", "slot data"),
        ({"data": make_list([1.5])}, "type_error(bytes,[1.5])", "slot data"),
    ],
)
def test_malformed_cloud_is_an_error_naming_slot(changes: Dict[str, Any], formal: str, reason: str) -> None:
    for goal in (
        ("cloud_near", GOOD.term(**changes), make_list([0, 0, 0]), 1),
        ("cloud_box", GOOD.term(**changes), make_list([0, 0, 0]), make_list([1, 1, 1])),
    ):
        assert error_of(*goal) == (formal, reason)


@pytest.mark.parametrize(
    "slot", ["height", "width", "fields", "is_bigendian", "point_step", "row_step", "data"]
)
def test_unbound_slot_is_an_instantiation_error(slot: str) -> None:
    assert (
        error_of("cloud_near", GOOD.term(**{slot: Var()}), make_list([0, 0, 0]), 1)[0]
        == "instantiation_error"
    )


def test_unread_slots_are_not_checked() -> None:
    message = GOOD.term(header=Var(), is_dense=atom("perhaps"))
    assert call("cloud_near", message, make_list([0, 0, 0]), 1) == 1


@pytest.mark.parametrize(
    ("goal", "error"),
    [
        ("cloud_near(_, [0,0,0], 1, N)", "instantiation_error"),
        ("cloud_near(cloud, [0,0,0], 1, N)", "type_error('sensor_msgs/PointCloud2',cloud)"),
        ("cloud_field(f(1), x, N)", "type_error('sensor_msgs/PointCloud2',f(1))"),
        ("image_array(7, N)", "type_error('sensor_msgs/Image',7)"),
        ('map_cell("map", 1, 1, N)', "type_error('nav_msgs/OccupancyGrid',\"map\")"),
        ("map_cell(map(h, 5, []), 1, 1, N)", "type_error('nav_msgs/MapMetaData',5)"),
    ],
)
def test_other_terms_are_type_errors(goal: str, error: str) -> None:
    assert answers(prolog(), goal) == [error]


def test_invalid_position_and_radius_are_errors() -> None:
    message = GOOD.term()
    assert error_of("cloud_near", message, make_list([0, 0]), 1)[0] == "type_error(position,[0,0])"
    assert (
        error_of("cloud_near", message, make_list([0, 0, 0]), -1)[0] == "domain_error(not_less_than_zero,-1)"
    )
    assert error_of("cloud_near", message, make_list([0, 0, 0]), atom("far"))[0] == "type_error(number,far)"
    assert (
        error_of("cloud_near", message, make_list([0, 0, 0]), 10**400)[0]
        == "evaluation_error(float_overflow)"
    )
    assert call("cloud_near", message, make_list([0, 0, 0]), math.inf) == 2
    assert call("cloud_near", message, make_list([math.nan, 0, 0]), 1) == 0


# Images

ENCODINGS = dict(
    name.split(":")
    for name in " ".join(
        (
            "mono8:1u1 mono16:1u2 rgb8:3u1 bgr8:3u1 rgba8:4u1 bgra8:4u1 rgb16:3u2 bgra16:4u2 bayer_rggb8:1u1",
            "bayer_gbrg16:1u2 yuv422:2u1 8UC1:1u1 8UC3:3u1 8UC:1u1 8UC12:12u1 8SC2:2i1 16UC1:1u2 16SC1:1i2 32SC1:1i4",
            "32FC1:1f4 32FC3:3f4 32FC:1f4 64FC1:1f8 64FC2:2f8",
        )
    ).split()
)
"""Number and type of the values of a pixel, by encoding."""


class Image:
    """A random image, whose values are read one by one with `struct`."""

    def __init__(self, height: Any, width: Any, encoding: Any, padding: Any, big: Any, seed: Any) -> None:
        self.channels, kind = int(ENCODINGS[encoding][:-2]), ENCODINGS[encoding][-2:]
        self.code = (">" if big else "<") + numpy.dtype(kind).char
        self.size = struct.calcsize(self.code)
        self.height, self.width, self.encoding, self.big = height, width, encoding, big
        self.step = width * self.channels * self.size + padding
        self.data = numpy.random.RandomState(seed).bytes(height * self.step)

    def term(self, **changes: Any) -> Any:
        slots = {
            "header": HEADER,
            "height": self.height,
            "width": self.width,
            "encoding": text(self.encoding),
            "is_bigendian": int(self.big),
            "step": self.step,
            "data": base64_atom(self.data),
        }
        assert set(changes) <= set(slots)
        return IMAGE(*{**slots, **changes}.values())

    def pixel(self, x: Any, y: Any) -> List[Any]:
        offset = y * self.step + x * self.channels * self.size
        return [
            struct.unpack_from(self.code, self.data, offset + channel * self.size)[0]
            for channel in range(self.channels)
        ]


@st.composite
def images(draw: Any) -> Image:
    size = st.integers(0, 6)
    encoding = draw(st.sampled_from(sorted(ENCODINGS)))
    return Image(
        draw(size),
        draw(size),
        encoding,
        draw(st.integers(0, 7)),
        draw(st.booleans()),
        draw(st.integers(0, 999)),
    )


def as_list(value: Any) -> Any:
    return value if isinstance(value, list) else [value]


@given(images(), st.integers(-2, 7), st.integers(-2, 7), st.integers(0, 8), st.integers(0, 8))
def test_image_values_follow_encoding(image: Any, left: int, top: int, width: int, height: int) -> None:
    everything = [image.pixel(x, y) for y in range(image.height) for x in range(image.width)]
    region = [
        image.pixel(x, y)
        for y in range(max(top, 0), min(top + height, image.height))
        for x in range(max(left, 0), min(left + width, image.width))
    ]
    channels = [
        [pixel[channel] for pixel in region if math.isfinite(pixel[channel])]
        for channel in range(image.channels)
    ]
    for message in (image.term(), decoded(image.term())):
        assert equal_numbers(call("image_array", message), [value for pixel in everything for value in pixel])
        channel_values = call("image_pixel", message, left, top)
        if 0 <= left < image.width and 0 <= top < image.height:
            assert equal_numbers(as_list(channel_values), image.pixel(left, top))
            assert isinstance(channel_values, list) == (image.channels > 1)
        else:
            assert channel_values is None
        means = call("image_region_mean", message, left, top, width, height)
        if all(channels):
            for mean, values in zip(as_list(means), channels):
                assert isinstance(mean, float)
                exact = math.fsum(values) / len(values) if max(map(abs, values)) < 1e300 else None
                bound = 1e-12 * max(map(abs, values)) + 1e-12
                assert exact is None or abs(mean - exact) <= bound
        else:
            assert means is None


def test_mean_of_large_image_does_not_overflow() -> None:
    tall = IMAGE(HEADER, 70_000, 3, text("mono8"), 0, 3, base64_atom(b"\xff" * 210_000))
    assert call("image_region_mean", tall, 0, 0, 3, 70_000) == 255.0
    wide = IMAGE(HEADER, 1, 40_000, text("16UC1"), 0, 80_000, base64_atom(b"\xff" * 80_000))
    assert call("image_region_mean", wide, 0, 0, 40_000, 1) == 65535.0


IMAGE_2X2 = Image(2, 2, "rgb8", 0, False, 1)


@pytest.mark.parametrize(
    ("changes", "formal", "reason"),
    [
        ({"data": text("abc")}, "domain_error(data,3)", "data: 3 bytes, expected height * step = 12"),
        ({"step": 5}, "domain_error(step,5)", "step: 5 bytes, expected width * 3 = 6 or more"),
        ({"step": 7}, "domain_error(data,12)", "data: 12 bytes, expected height * step = 14"),
        ({"width": -2}, "domain_error(width,-2)", "width: -2, expected 0 or more"),
        (
            {"encoding": text("jpeg")},
            "domain_error(image_encoding,'\"jpeg\"')",
            "encoding: 'jpeg' is not supported",
        ),
        (
            {"encoding": text("8UC0")},
            "domain_error(image_encoding,'\"8UC0\"')",
            "encoding: '8UC0' is not supported",
        ),
        (
            {"encoding": text("64UC1")},
            "domain_error(image_encoding,'\"64UC1\"')",
            "encoding: '64UC1' is not supported",
        ),
        ({"encoding": 8}, "type_error(text,8)", "slot encoding"),
        ({"is_bigendian": 0.5}, "type_error(bool,0.5)", "slot is_bigendian"),
        ({"height": Var()}, "instantiation_error", None),
    ],
)
def test_malformed_image_is_an_error_naming_slot(
    changes: Dict[str, Any], formal: str, reason: Optional[str]
) -> None:
    message = IMAGE_2X2.term(**changes)
    assert error_of("image_array", message) == (formal, reason)
    assert error_of("image_pixel", message, 0, 0) == (formal, reason)
    assert error_of("image_region_mean", message, 0, 0, 1, 1) == (formal, reason)


def test_fractional_pixel_coordinates_are_refused() -> None:
    message = IMAGE_2X2.term()
    assert error_of("image_pixel", message, 0.5, 0)[0] == "type_error(integer,0.5)"
    assert error_of("image_region_mean", message, 0, 0, -1, 1)[0] == "domain_error(not_less_than_zero,-1)"


def test_image_data_may_be_text_or_list() -> None:
    slots = {"height": 2, "width": 2, "encoding": atom("mono8"), "step": 2}
    for data in (atom("abcd"), text("abcd"), String("abcd"), make_list([97, 98, 99, 100])):
        assert call("image_array", IMAGE_2X2.term(**slots, data=data)) == [97, 98, 99, 100]
    empty = IMAGE_2X2.term(**{**slots, "height": 0}, data=atom("[]"))
    assert call("image_array", empty) == []


# Maps

GRID = functor("nav_msgs__0__OccupancyGrid", 3)
INFO = functor("nav_msgs__0__MapMetaData", 5)
POSE = functor("geometry_msgs__0__Pose", 2)
POINT = functor("geometry_msgs__0__Point", 3)
QUATERNION = functor("geometry_msgs__0__Quaternion", 4)


def grid(
    width: int,
    height: int,
    cells: Any,
    resolution: Any = 0.5,
    origin: Any = (0.0, 0.0),
    turn: float = 0.0,
    norm: float = 1.0,
) -> Any:
    rotation = QUATERNION(0.0, 0.0, norm * math.sin(turn / 2), norm * math.cos(turn / 2))
    pose = POSE(POINT(*map(float, origin), 0.0), rotation)
    return GRID(HEADER, INFO(make_list([0, 0]), resolution, width, height, pose), make_list(cells))


@given(
    st.integers(1, 6),
    st.integers(1, 6),
    st.floats(-3, 3),
    st.tuples(st.floats(-3, 3), st.floats(-3, 3)),
    st.sampled_from([0.25, 0.5, 2.0]),
    st.floats(0.5, 2),
    st.data(),
)
def test_map_cell_is_selected_by_position(
    width: int, height: int, turn: float, origin: Any, resolution: Any, norm: float, data: st.DataObject
) -> None:
    cells = data.draw(st.lists(st.integers(-1, 100), min_size=width * height, max_size=width * height))
    message = grid(width, height, cells, resolution, origin, turn, norm)
    matrix = numpy.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    for column in range(-1, width + 1):
        for row in range(-1, height + 1):
            middle = numpy.array([column + 0.5, row + 0.5]) * resolution
            x, y = (matrix @ middle + origin).tolist()
            inside = 0 <= column < width and 0 <= row < height
            expected = cells[row * width + column] if inside else None
            assert call("map_cell", message, x, y) == expected
            assert call("map_cell", decoded(message), x, y) == expected


def test_position_outside_map_has_no_cell() -> None:
    message = grid(2, 1, [7, 8], 1.0)
    assert [call("map_cell", message, x, 0) for x in (0, 0.999, 1, 2, -0.001)] == [7, 7, 8, None, None]
    for odd in (math.nan, math.inf, -math.inf, 1e308):
        assert call("map_cell", message, odd, 0) is None
        assert call("map_cell", message, 0, odd) is None


def test_map_without_orientation_is_not_rotated() -> None:
    assert call("map_cell", grid(2, 1, [7, 8], norm=0.0), 0.6, 0.1) == 8


@pytest.mark.parametrize(
    ("message", "formal", "reason"),
    [
        (grid(2, 2, [0]), "domain_error(data,1)", "data: 1 cells, expected width * height = 4"),
        (grid(-2, 2, [0]), "domain_error('info.width',-2)", "info.width: -2, expected 0 or more"),
        (
            grid(1, 1, [0], 0),
            "domain_error('info.resolution',0)",
            "info.resolution: expected a positive number",
        ),
        (
            grid(1, 1, [0], -0.5),
            "domain_error('info.resolution',-0.5)",
            "info.resolution: expected a positive number",
        ),
        (grid(1, 1, [0], atom("fine")), "type_error(number,fine)", "slot info.resolution"),
    ],
)
def test_malformed_map_is_an_error_naming_slot(message: Any, formal: str, reason: str) -> None:
    assert error_of("map_cell", message, 0, 0) == (formal, reason)


# Random slots

ODD = st.one_of(
    st.integers(-3, 40),
    st.sampled_from([1 << 70, -(1 << 70), 1.5, math.nan, math.inf]),
    st.sampled_from(
        [atom("x"), atom("true"), atom("[]"), text(""), text("rgb8"), text("FFFFFFFFFF!"), String("\ud800")]
    ),
    st.builds(lambda items: make_list(items), st.lists(st.integers(-1, 300), max_size=3)),
    st.just(make_list([1], Var())),
    st.builds(Var),
    st.builds(
        lambda *values: FIELD(*values), st.sampled_from([text("x"), text("y"), 1]), *[st.integers(-1, 9)] * 3
    ),
)
ODD_LIST = st.builds(make_list, st.lists(ODD, max_size=4))


@given(st.data())
def test_random_slots_are_read_or_refused(data: st.DataObject) -> None:
    """Random slots have an answer, no answer, or an error that a program can catch."""
    value = st.one_of(ODD, ODD_LIST)
    good = {
        CLOUD: (GOOD.term(), [("cloud_field", [atom("x")]), ("cloud_near", [make_list([0, 0, 0]), 1])]),
        IMAGE: (
            IMAGE_2X2.term(),
            [("image_pixel", [0, 1]), ("image_region_mean", [0, 0, 2, 2]), ("image_array", [])],
        ),
        GRID: (grid(2, 2, [0] * 4), [("map_cell", [0.6, 0.6])]),
    }
    term: Any
    goals: Any
    term, goals = good[data.draw(st.sampled_from(list(good)))]
    slots = list(term)
    for position in data.draw(st.lists(st.integers(2, len(slots) - 1), max_size=3)):
        slots[position] = data.draw(value)
    for name, inputs in goals:
        term_of_error = None
        try:
            call(name, tuple(slots), *inputs)
        except PrologError as error:
            term_of_error = error.term
        assert term_of_error is None or compound(term_of_error)[0] is functor("error", 2)


def test_counted_points_use_inferences() -> None:
    logic = PrologSystem()
    logic.limits = Limits(inferences=1000)
    size = 12 * 100_000
    message = decoded(GOOD.term(width=100_000, row_step=size, data=base64_atom(bytes(size))))
    goal = (functor("cloud_near", 4), message, make_list([0, 0, 0]), 1, Var())
    with pytest.raises(PrologError, match="inferences"):
        logic.once(goal)
    logic.limits = Limits(inferences=10_000)
    assert logic.once(goal)


def test_decoded_text_keeps_bytes_of_message() -> None:
    cloud, stored = xyz([(index, 0, 0) for index in range(500)])
    message = compound(decoded(cloud.term()))
    assert show(message).count("FFFFFFFFFF") == 1
    assert message[8].source == cloud.data
    assert call("cloud_field", message, atom("x")) == stored[:, 0].tolist()


@pytest.mark.parametrize(
    "name", ["", "C", "8U", "8UC513", "8UC1000", "8UC-1", "8UC\u0661", "8UC1 ", "RGB8", "C8UC1"]
)
def test_unknown_encoding_is_refused(name: str) -> None:
    assert error_of("image_array", IMAGE_2X2.term(encoding=text(name)))[0].startswith(
        "domain_error(image_encoding"
    )


def test_last_long_text_is_decoded_once(monkeypatch: pytest.MonkeyPatch) -> None:
    decoded_texts: List[Any] = []

    def text_bytes(term: Any) -> Any:
        decoded_texts.append(term)
        return byte_texts.text_bytes(term)

    monkeypatch.setattr(sensor_predicates, "text_bytes", text_bytes)
    cloud, _ = xyz([(index, 0, 0) for index in range(500)])
    message, other = cloud.term(), xyz([(0, 0, index) for index in range(500)])[0].term()
    for _ in range(3):
        assert call("cloud_near", message, make_list([0, 0, 0]), 9) == 10
        assert call("cloud_box", message, make_list([0, 0, 0]), make_list([4, 0, 0])) == 5
    assert decoded_texts == [message[8]]
    assert call("cloud_box", other, make_list([0, 0, 0]), make_list([4, 0, 0])) == 1
    assert call("cloud_near", message, make_list([0, 0, 0]), 9) == 10
    assert decoded_texts == [message[8], other[8], message[8]]
