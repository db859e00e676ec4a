"""Predicates on point clouds, images and occupancy grids: ``sensor_msgs/PointCloud2``, ``Image``, ``OccupancyGrid``.

The messages are event terms, decoded ones or written by hand. Their bytes are read through strided numpy views (see
`array_of`), so no list and no base64 text is created. The sizes in a message are checked before a view is created: a
message with inconsistent sizes raises an error that names the slot; numpy would otherwise read outside of the data or
return an empty array. Other types with the same slots are accepted, such as the events of a topic with an own name.

Points are tested in blocks that fit into the processor's cache, with a check of the goal's limits after each block.
Coordinates are compared as float64, as the numbers of a list would be: numpy alone would round a limit to the type of
the coordinates.
"""

from math import isfinite
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Tuple
from weakref import ref

from ...foundation.errors import MessageError
from ...foundation.limit_checks import check_limits
from ..machine.errors import (
    CONTEXT,
    PrologError,
    domain_error,
    existence_error,
    instantiation_error,
    instantiation_or_type_error,
    type_error,
)
from ..terms.array_terms import ELEMENTS_PER_INFERENCE, array_term, lazy_array
from ..terms.byte_texts import text_bytes
from ..terms.list_terms import list_parts, make_list
from ..terms.types import (
    FALSE,
    NIL,
    TRUE,
    Atom,
    CompoundTerm,
    Functor,
    String,
    Term,
    Var,
    atom,
    deref,
    functor,
)
from .argument_checks import array_of, bound, integer, natural, number
from .builtin_registry import function
from .pose_predicates import parse_vector

Array = Any
"""A numpy array; numpy is imported at the first use of a predicate."""

_POINT_CLOUD, _IMAGE, _GRID = "sensor_msgs/PointCloud2", "sensor_msgs/Image", "nav_msgs/OccupancyGrid"
_ARITIES = {_POINT_CLOUD: 9, _IMAGE: 7, _GRID: 3}

_POINT_FIELD = functor("sensor_msgs__0__PointField", 4)
_MAP_META_DATA = functor("nav_msgs__0__MapMetaData", 5)
_POSE = functor("geometry_msgs__0__Pose", 2)
_POINT = functor("geometry_msgs__0__Point", 3)
_QUATERNION = functor("geometry_msgs__0__Quaternion", 4)

_MAX_BYTE = 255
_POINTS_PER_BLOCK = 1 << 14
"""Points that are tested at once: three coordinates as float64 take 384 KiB."""


def _size_error(slot: str, value: Term, reason: str) -> PrologError:
    """Return the error for a message whose slot contradicts the others."""
    return domain_error(slot, value, f"{slot}: {reason}")


def _require_message(term: Term, type_name: str) -> CompoundTerm:
    """Return a message of a type, by its number of slots."""
    term = deref(term)
    if term.__class__ is tuple and len(term) == _ARITIES[type_name] + 1:
        return term
    raise instantiation_or_type_error(type_name, term)


def _require_nested_message(term: Term, expected: Functor, slot: str) -> CompoundTerm:
    term = deref(term)
    if term.__class__ is tuple and term[0] is expected:
        return term
    raise instantiation_or_type_error(expected.name.replace("__0__", "/"), term, f"slot {slot}")


def _read_number(term: Term, slot: str) -> float:
    term = deref(term)
    if term.__class__ is int or term.__class__ is float:
        return float(term)
    raise instantiation_or_type_error("number", term, f"slot {slot}")


def _read_non_negative(term: Term, slot: str) -> int:
    term = deref(term)
    if term.__class__ is not int:
        raise instantiation_or_type_error("integer", term, f"slot {slot}")
    if term < 0:
        raise _size_error(slot, term, f"{term}, expected 0 or more")
    return term


def _read_is_bigendian(term: Term) -> bool:
    """Return the truth value in a slot ``is_bigendian``, which is a number in ``sensor_msgs/Image``."""
    term = deref(term)
    if term is TRUE or term is FALSE:
        return term is TRUE
    if term.__class__ is int:
        return bool(term)
    raise instantiation_or_type_error("bool", term, "slot is_bigendian")


def _read_text(term: Term, slot: Optional[str] = None) -> str:
    """Return a text, of a slot or an argument, without the double quotes that texts of messages have."""
    term = bound(term)
    if term.__class__ is String:
        return term.text
    if term.__class__ is not Atom or term is NIL:
        raise type_error("text", term, slot and f"slot {slot}")
    name = term.name
    return name[1:-1] if len(name) >= 2 and name[0] == name[-1] == '"' else name


def _read_bytes(term: Term) -> Array:
    """Return the bytes in the slot ``data`` as an array."""
    import numpy  # noqa: PLC0415 - takes longer to import than the whole package

    if lazy_array(term) is None:
        term = deref(term)
        if term.__class__ is String or (term.__class__ is Atom and term is not NIL):
            return numpy.frombuffer(_decode_text(term), "u1")
        if term.__class__ is not tuple and term is not NIL and term.__class__ is not Var:
            raise type_error("bytes", term, "slot data")
    # Programs may send a list of numbers instead of a text.
    values = array_of(term)
    if values.dtype != "u1":
        if len(values) and (values.dtype.kind not in "iu" or values.min() < 0 or values.max() > _MAX_BYTE):
            raise type_error("bytes", deref(term), "slot data")
        values = values.astype("u1")
    return values


_MIN_CACHED_TEXT_BYTES = 1024
"""Size from which the bytes of a text are cached."""

_last_decoded_text: Tuple[Optional["ref[Atom]"], bytes] = (None, b"")
"""The long text that was decoded last, and its bytes, because several predicates usually read the same message.

It is one tuple, because several threads may replace it at any time."""


def _decode_text(term: Term) -> bytes:
    """Return the bytes that a text in the slot ``data`` denotes."""
    global _last_decoded_text
    cached_atom, cached_bytes = _last_decoded_text
    if cached_atom is not None and cached_atom() is term:
        return cached_bytes
    try:
        decoded = text_bytes(term) or b""
    except MessageError as error:
        raise type_error("bytes", term, f"slot data: {error.message}") from None
    if term.__class__ is Atom and len(decoded) >= _MIN_CACHED_TEXT_BYTES:
        _last_decoded_text = ref(term), decoded
    return decoded


def _array_to_term(values: Array) -> Term:
    """Return the term of all elements of an array, row by row."""
    check_limits(1 + values.size // ELEMENTS_PER_INFERENCE, values.nbytes)
    return array_term(values.reshape(-1))


# Point clouds


_FIELD_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""Types by the constants INT8 to FLOAT64 of ``sensor_msgs/PointField``."""


class _Cloud(NamedTuple):
    """The layout and the bytes of a point cloud.

    Attributes:
        height: number of rows.
        width: number of points of a row.
        point_step: bytes of a point.
        row_step: bytes of a row, with its padding.
        data: the bytes.
        byte_order: ``<`` or ``>``, as for numpy.
        fields: list of the fields of a point.
    """

    height: int
    width: int
    point_step: int
    row_step: int
    data: Array
    byte_order: str
    fields: Term

    def read_field(self, name: str) -> Array:
        """Return the values of a field, in three dimensions: rows, columns, and values of a point."""
        import numpy  # noqa: PLC0415 - see `_read_bytes`

        names = []
        for term in _read_fields(self.fields):
            field = _require_nested_message(term, _POINT_FIELD, "fields")
            field_name = _read_text(field[1], "fields.name")
            names.append(field_name)
            if field_name == name:
                break
        else:
            reason = f"the cloud has {', '.join(names) or 'no fields'}"
            raise existence_error("field", atom(name), (CONTEXT, Var(), atom(reason)))
        offset, datatype = (
            _read_non_negative(field[2], "fields.offset"),
            _read_non_negative(field[3], "fields.datatype"),
        )
        # A count of 0 is found in clouds of old drivers and means one value, as in PCL.
        count = _read_non_negative(field[4], "fields.count") or 1
        if datatype not in _FIELD_TYPES:
            raise _size_error("fields.datatype", datatype, f"{datatype} of {name}, expected 1 to 8")
        dtype = numpy.dtype(self.byte_order + _FIELD_TYPES[datatype])
        end = offset + count * dtype.itemsize
        if end > self.point_step:
            raise _size_error(
                "point_step", self.point_step, f"{self.point_step} bytes, expected {end} or more for {name}"
            )
        if not self.height * self.width:
            return numpy.empty((0, 0, count), dtype)
        shape = self.height, self.width, count
        strides = self.row_step, self.point_step, dtype.itemsize
        return numpy.ndarray(shape, dtype, self.data, offset, strides)

    def read_coordinate(self, name: str) -> Array:
        """Return the coordinates of the points in two dimensions, rows and columns."""
        values = self.read_field(name)
        if values.shape[2] != 1:
            raise _size_error("fields.count", values.shape[2], f"{values.shape[2]} of {name}, expected 1")
        return values[:, :, 0]

    def blocks(self) -> Iterator[Tuple[Array, Array, Array]]:
        """Yield the coordinates x, y and z of blocks of points as float64."""
        coordinates = [self.read_coordinate(name) for name in "xyz"]
        height, width = coordinates[0].shape
        if width and self.row_step == self.width * self.point_step:
            # Without padding at the end of rows, the cloud is one row.
            coordinates = [values.reshape(1, -1) for values in coordinates]
            height, width = coordinates[0].shape
        rows_per_block = max(1, _POINTS_PER_BLOCK // width) if width else 1
        for top in range(0, height, rows_per_block):
            for left in range(0, width, _POINTS_PER_BLOCK):
                x, y, z = [
                    values[top : top + rows_per_block, left : left + _POINTS_PER_BLOCK]
                    for values in coordinates
                ]
                check_limits(1 + x.size // ELEMENTS_PER_INFERENCE)
                yield x.astype("f8"), y.astype("f8"), z.astype("f8")


def _read_fields(term: Term) -> List[Term]:
    items, tail = list_parts(term)
    if tail is NIL:
        return items
    if tail.__class__ is Var:
        raise instantiation_error()
    raise type_error("list", deref(term), "slot fields")


def _read_cloud(term: Term) -> _Cloud:
    """Return the layout of a point cloud, after its sizes have been checked."""
    message = _require_message(term, _POINT_CLOUD)
    height, width = _read_non_negative(message[2], "height"), _read_non_negative(message[3], "width")
    is_bigendian = _read_is_bigendian(message[5])
    point_step, row_step = (
        _read_non_negative(message[6], "point_step"),
        _read_non_negative(message[7], "row_step"),
    )
    data = _read_bytes(message[8])
    if row_step < width * point_step and height:
        needed = width * point_step
        raise _size_error(
            "row_step", row_step, f"{row_step} bytes, expected width * point_step = {needed} or more"
        )
    _check_data("bytes", len(data), height * row_step, "height * row_step")
    return _Cloud(height, width, point_step, row_step, data, ">" if is_bigendian else "<", message[4])


def _check_data(unit: str, size: int, expected: int, formula: str) -> None:
    """Raise an error for a slot ``data`` whose size differs from the one that the other slots determine."""
    if size != expected:
        raise _size_error("data", size, f"{size} {unit}, expected {formula} = {expected}")


@function("cloud_field/3")
def cloud_field(cloud: Term, name: Term) -> Term:
    """Return the values of a field of all points, row by row; if a point has several values, all of them."""
    layout = _read_cloud(cloud)
    return _array_to_term(layout.read_field(_read_text(name)))


@function("cloud_near/4")
def cloud_near(cloud: Term, point: Term, radius: Term) -> Term:
    """Return the number of points within a radius of a point.

    Points with a coordinate that is not finite are not counted.
    """
    import numpy  # noqa: PLC0415 - see `_read_bytes`

    layout = _read_cloud(cloud)
    px, py, pz = map(float, parse_vector(point))
    radius_value = float(number(radius))
    if radius_value < 0:
        raise domain_error("not_less_than_zero", deref(radius))
    limit = radius_value * radius_value
    count = 0
    with numpy.errstate(invalid="ignore", over="ignore"):
        for x, y, z in layout.blocks():
            x -= px
            y -= py
            z -= pz
            x *= x
            y *= y
            z *= z
            x += y
            x += z
            count += int(numpy.count_nonzero(x <= limit))
    return count


@function("cloud_box/4")
def cloud_box(cloud: Term, lower: Term, upper: Term) -> Term:
    """Return the number of points in a box, faces included."""
    import numpy  # noqa: PLC0415 - see `_read_bytes`

    layout = _read_cloud(cloud)
    low, high = [tuple(map(float, parse_vector(corner))) for corner in (lower, upper)]
    count = 0
    with numpy.errstate(invalid="ignore"):
        for block in layout.blocks():
            is_inside: Array = True
            for values, lower_bound, upper_bound in zip(block, low, high):
                is_inside = (values >= lower_bound) & (values <= upper_bound) & is_inside
            count += int(numpy.count_nonzero(is_inside))
    return count


# Images


_CHANNELS = {"mono": 1, "rgb": 3, "bgr": 3, "rgba": 4, "bgra": 4}
_ENCODINGS: Dict[str, Tuple[str, int]] = {
    **{f"{name}{8 * size}": (f"u{size}", count) for name, count in _CHANNELS.items() for size in (1, 2)},
    **{
        f"bayer_{order}{8 * size}": (f"u{size}", 1)
        for order in ("rggb", "bggr", "gbrg", "grbg")
        for size in (1, 2)
    },
    **dict.fromkeys(("yuv422", "yuv422_yuy2", "uyvy", "yuyv"), ("u1", 2)),
}
"""Type and number of the values of a pixel, by encoding; those of OpenCV are read by `_parse_encoding`."""

_OPENCV_TYPES = {"8U": "u1", "8S": "i1", "16U": "u2", "16S": "i2", "32S": "i4", "32F": "f4", "64F": "f8"}
_MAX_CHANNELS = 512
"""Values of a pixel in OpenCV's types (``CV_CN_MAX``)."""


def _parse_encoding(term: Term) -> Tuple[str, int]:
    """Return the type of the values of a pixel without its byte order, and their number."""
    name = _read_text(term, "encoding")
    type_and_count = _ENCODINGS.get(name)
    if type_and_count is not None:
        return type_and_count
    type_name, separator, digits = name.partition("C")
    if separator and type_name in _OPENCV_TYPES:
        if not digits:
            return _OPENCV_TYPES[type_name], 1
        if digits.isdigit() and digits.isascii() and len(digits) < 4 and 0 < int(digits) <= _MAX_CHANNELS:
            return _OPENCV_TYPES[type_name], int(digits)
    raise domain_error("image_encoding", deref(term), f"encoding: '{name[:40]}' is not supported")


class _Image(NamedTuple):
    """The pixels of an image.

    Attributes:
        height: number of rows.
        width: number of columns.
        channels: values of a pixel.
        rows: the values in two dimensions: rows, and the values of all pixels of a row.
    """

    height: int
    width: int
    channels: int
    rows: Array


def _read_image(term: Term) -> _Image:
    """Return the pixels of an image, after its sizes have been checked."""
    import numpy  # noqa: PLC0415 - see `_read_bytes`

    message = _require_message(term, _IMAGE)
    height, width = _read_non_negative(message[2], "height"), _read_non_negative(message[3], "width")
    type_name, channels = _parse_encoding(message[4])
    byte_order = ">" if _read_is_bigendian(message[5]) else "<"
    step, data = _read_non_negative(message[6], "step"), _read_bytes(message[7])
    dtype = numpy.dtype(byte_order + type_name)
    needed = width * channels * dtype.itemsize
    if step < needed and height:
        raise _size_error(
            "step", step, f"{step} bytes, expected width * {channels * dtype.itemsize} = {needed} or more"
        )
    _check_data("bytes", len(data), height * step, "height * step")
    if not height * width:
        return _Image(height, width, channels, numpy.empty((0, 0), dtype))
    shape, strides = (height, width * channels), (step, dtype.itemsize)
    return _Image(height, width, channels, numpy.ndarray(shape, dtype, data, 0, strides))


@function("image_pixel/4")
def image_pixel(image: Term, column: Term, row: Term) -> Optional[Term]:
    """Return the value of a pixel, or the list of its values; fail outside of the image."""
    pixels = _read_image(image)
    x, y = integer(column), integer(row)
    if not (0 <= x < pixels.width and 0 <= y < pixels.height):
        return None
    values: List[Term] = pixels.rows[y, x * pixels.channels : (x + 1) * pixels.channels].tolist()
    return values[0] if pixels.channels == 1 else make_list(values)


@function("image_region_mean/6")
def image_region_mean(image: Term, left: Term, top: Term, width: Term, height: Term) -> Optional[Term]:
    """Return the mean of the pixels in a rectangle, or the list of the means of their values.

    The part of the rectangle outside of the image, and values that are not finite, are ignored. The predicate fails
    if no finite value remains.
    """
    pixels = _read_image(image)
    x, y, columns, rows = integer(left), integer(top), natural(width), natural(height)
    x_end, y_end = min(x + columns, pixels.width), min(y + rows, pixels.height)
    x, y = max(x, 0), max(y, 0)
    if x >= x_end or y >= y_end:
        return None
    region = pixels.rows[y:y_end, x * pixels.channels : x_end * pixels.channels]
    check_limits(1 + region.size // ELEMENTS_PER_INFERENCE)
    means = (
        _finite_means(region, pixels.channels)
        if region.dtype.kind == "f"
        else _integer_means(region, pixels.channels)
    )
    if any(mean is None for mean in means):
        return None
    return means[0] if pixels.channels == 1 else make_list(means)


def _integer_means(region: Array, channels: int) -> List[Any]:
    """Return the mean of each channel of rows of integers."""
    count = region.size // channels
    # The rows are added first: a sum over long rows is vectorised, one over the channels of a pixel is not. Sums of
    # up to 2**16 bytes fit into 32 bits, which takes half the time.
    is_small = region.dtype.itemsize == 1 and len(region) <= 1 << 16
    sums = region.sum(axis=0, dtype="i4" if is_small else "i8")
    return [total / count for total in sums.reshape(-1, channels).sum(axis=0, dtype="i8").tolist()]


def _finite_means(region: Array, channels: int) -> List[Any]:
    """Return the mean of the finite values of each channel of rows of floats, None for a channel without any."""
    import numpy  # noqa: PLC0415 - see `_read_bytes`

    check_limits(size=9 * region.size)
    with numpy.errstate(over="ignore", invalid="ignore"):
        finite = numpy.isfinite(region)
        sums = numpy.where(finite, region, 0).astype("f8").sum(axis=0).reshape(-1, channels).sum(axis=0)
    counts = finite.sum(axis=0).reshape(-1, channels).sum(axis=0)
    return [total / count if count else None for total, count in zip(sums.tolist(), counts.tolist())]


@function("image_array/2")
def image_array(image: Term) -> Term:
    """Return all values of an image, row by row, without the padding of rows."""
    return _array_to_term(_read_image(image).rows)


# Occupancy grids


@function("map_cell/4")
def map_cell(grid: Term, x: Term, y: Term) -> Optional[Term]:
    """Return the value of the cell at a point, in metres in the frame of the map; fail outside of the map."""
    message = _require_message(grid, _GRID)
    info = _require_nested_message(message[2], _MAP_META_DATA, "info")
    resolution = _read_number(info[2], "info.resolution")
    if not (resolution > 0 and isfinite(resolution)):
        raise domain_error("info.resolution", deref(info[2]), "info.resolution: expected a positive number")
    width, height = (
        _read_non_negative(info[3], "info.width"),
        _read_non_negative(info[4], "info.height"),
    )
    local_x, local_y = _to_grid(info[5], float(number(x)), float(number(y)))
    data = array_of(message[3])
    _check_data("cells", len(data), width * height, "width * height")
    column, row = local_x / resolution, local_y / resolution
    # The comparison is also false for nan, which cannot be converted to an integer.
    if not (0 <= column < width and 0 <= row < height):
        return None
    value: Term = data[int(row) * width + int(column)].item()
    return value


def _to_grid(origin: Term, x: float, y: float) -> Tuple[float, float]:
    """Return the coordinates, in metres along the rows and columns, of a point in the frame of the map.

    The origin is the pose of the corner of the first cell. Its inverse rotation, by the transposed matrix of the
    quaternion, turns the point into the grid.
    """
    pose = _require_nested_message(origin, _POSE, "info.origin")
    position = _require_nested_message(pose[1], _POINT, "info.origin.position")
    rotation = _require_nested_message(pose[2], _QUATERNION, "info.origin.orientation")
    dx = x - _read_number(position[1], "info.origin.position.x")
    dy = y - _read_number(position[2], "info.origin.position.y")
    qx, qy, qz, qw = [
        _read_number(part, f"info.origin.orientation.{name}") for part, name in zip(rotation[1:], "xyzw")
    ]
    norm = qx * qx + qy * qy + qz * qz + qw * qw
    # Many publishers leave the orientation out; rviz shows such maps without a rotation, too.
    if not norm:
        return dx, dy
    scale = 2 / norm
    return (
        (1 - scale * (qy * qy + qz * qz)) * dx + scale * (qx * qy + qz * qw) * dy,
        scale * (qx * qy - qz * qw) * dx + (1 - scale * (qx * qx + qz * qz)) * dy,
    )
