"""Extraction of header stamps from serialized messages, for the monitoring of clock skew.

A stamp is a time with the frame that it belongs to (``frame_id`` and, if it follows, ``child_frame_id``). Stamps are
read from the message's own header and from the headers of array elements, at offsets that are computed from the type
definition: nothing is decoded. `Ros1Walker` and `CdrWalker` find these offsets in the two formats of messages. Every
message is inspected, so the common case must be cheap: the observer is called only if the second of a frame's stamp
differs from the last one observed. For types that `FrameDecoderGenerator` supports, that comparison is part of the
generated decoding function; for other types it happens when the message's time is read.
"""

from copy import copy
from struct import Struct, pack, unpack_from
from struct import error as StructError
from typing import Any, Callable, List, Mapping, NamedTuple, Optional, Tuple, Union

from ..prolog.terms.timestamps import SECOND
from .cdr_decoder import (
    BYTE_ORDERS,
    ENCAPSULATION_BYTES,
    MAX_SECONDS,
    aligned_offset,
    cdr_slots,
    number_layout,
)
from .decoder import Decoder, StampWatch, UnsupportedLayout, make_watching_decoder
from .type_definition import (
    HEADER,
    TIMES,
    VARIABLE_LENGTH,
    Definition,
    Field,
    SerializationFormat,
    find_slot_end,
)

FrameStamp = Tuple[bytes, int]
"""Bytes that identify a frame, and a time in nanoseconds."""

ReadStamps = Callable[[bytes], List[FrameStamp]]
"""Function from the bytes of a message to its stamps."""

ReadStamp = Callable[[bytes], Optional[int]]
"""Function from the bytes of a message to the time of its own header, as `Decoder.stamp`."""

StampObserver = Callable[[List[FrameStamp]], object]
"""Observer of a message's stamps, called if the second of at least one stamp differs from the last observed second
of that frame."""

_CHILD_FRAME_FIELD = "child_frame_id"

_STAMP_OFFSET, _STAMP_END = 4, 12
"""Range of the bytes of the stamp in a message that begins with a header."""

_unpack_header = Struct("<4xIII").unpack_from
"""Reads secs, nsecs and the length of frame_id from a header, which begins with seq."""
_unpack_uint32 = Struct("<I").unpack_from


def make_stamp_reader(
    definition: Definition, serialization_format: SerializationFormat = SerializationFormat.ROS1
) -> Optional[ReadStamps]:
    """Return the function that reads the stamps of messages of a type; None if the type has no stamps.

    Zero stamps are unset and are omitted. If the bytes are malformed, the stamps before the error are returned.
    """
    create_walker = CdrWalker if serialization_format is SerializationFormat.CDR else Ros1Walker
    fields = _stamped_fields(definition)
    if not fields:
        return None

    def read_stamps(data: bytes) -> List[FrameStamp]:
        stamps: List[FrameStamp] = []
        try:
            _collect_stamps(create_walker(data), fields, stamps)
        except StructError:  # decoding the message reports the error
            pass
        return stamps

    return read_stamps


def shift_header_stamp(data: bytes, serialization_format: SerializationFormat, nanoseconds: int) -> bytes:
    """Return a message whose header has another stamp.

    Args:
        data: a message that begins with a header.
        serialization_format: its format.
        nanoseconds: time that is added to the stamp, which stays within the range of the format.

    Returns:
        The changed message, or an equal one if its stamp is zero, which means unset, or cannot be read.
    """
    byte_order = BYTE_ORDERS.get(data[:2]) if serialization_format is SerializationFormat.CDR else "<"
    # Both formats have four bytes before the stamp: ``seq`` in ROS 1, the encapsulation in CDR.
    if byte_order is None or len(data) < _STAMP_END:
        return data
    seconds, nanosecond = unpack_from(f"{byte_order}II", data, _STAMP_OFFSET)
    stamp = seconds * SECOND + nanosecond
    if not stamp or seconds > MAX_SECONDS:
        return data
    shifted = min(max(stamp + nanoseconds, 0), MAX_SECONDS * SECOND)
    return data[:_STAMP_OFFSET] + pack(f"{byte_order}II", *divmod(shifted, SECOND)) + data[_STAMP_END:]


def make_observed_decoder(decoder: Decoder, states: Mapping[bytes, Any], observer: StampObserver) -> Decoder:
    """Return a decoder that passes stamps to an observer if their second differs from the last observed one.

    The observer is called by `Decoder.decode` for types that `FrameDecoderGenerator` supports, otherwise by
    `Decoder.stamp`: a caller has to call both for each message.

    Args:
        decoder: decoder of the messages' type.
        states: states of frames by their bytes, with the attribute ``second``: the second that was observed last.
        observer: receives all stamps of a message if the second of any of these differs. Its exceptions
            propagate.
    """
    definition, stamp, get_state = decoder.definition, decoder.stamp, states.get
    # Types without stamps keep their decoder, so that monitoring costs nothing for them.
    read_stamps = make_stamp_reader(definition, decoder.format)
    if read_stamps is None:
        return decoder
    read_all_stamps: ReadStamps = read_stamps

    def observe(data: bytes) -> None:
        stamps = read_all_stamps(data)
        for key, instant in stamps:
            state = get_state(key)
            # A comparison of seconds is enough: the observer looks for deviations of seconds, and is too slow for
            # every message.
            if state is None or state.second != instant // SECOND:
                observer(stamps)
                break

    def observe_single(key: bytes, instant: int) -> None:
        if instant:
            observer([(key, instant)])

    try:
        watch = StampWatch(_count_frame_strings(definition), get_state, observe, observe_single)
        return make_watching_decoder(decoder, watch)
    except UnsupportedLayout:
        pass

    def observe_and_read_stamp(data: bytes) -> Optional[int]:
        observe(data)
        return stamp(data)

    observed_decoder = copy(decoder)
    observed_decoder.plain = decoder
    fields = _stamped_fields(definition)
    # The fast reader assumes that the header's frame is the only one.
    is_single = len(fields) == 1 and fields[0].field.length is None and not fields[0].has_child
    observed_decoder.stamp = (
        _make_header_stamp_reader(get_state, observe_and_read_stamp) if is_single else observe_and_read_stamp
    )
    return observed_decoder


def _count_frame_strings(definition: Definition) -> int:
    """Return the number of strings that name frames in a message with one stamp, in its header or its only array.

    Raises:
        UnsupportedLayout: if the type has another form.
    """
    fields = _stamped_fields(definition)
    if len(fields) > 1 or (fields[0].field.length is not None and len(definition.fields) > 1):
        raise UnsupportedLayout
    return 2 if fields[0].has_child else 1


def _make_header_stamp_reader(get_state: Callable[[bytes], Any], fallback: ReadStamp) -> ReadStamp:
    """Return a fast reader for messages whose only stamp is that of their header.

    In little-endian CDR, four bytes precede the message in place of ``seq``. Others are read by ``fallback``, because
    they name no known frame.
    """

    def read_header_stamp(data: bytes) -> Optional[int]:
        try:
            second, nanosecond, size = _unpack_header(data)
        except StructError:
            return fallback(data)
        # The frame is identified by the bytes of its name, with the length in front.
        state = get_state(data[12 : 16 + size])
        if state is not None and state.second == second:
            return second * SECOND + nanosecond or None
        return fallback(data)

    return read_header_stamp


def format_frame_key(key: bytes) -> str:
    """Return the bytes that identify a frame as text: ``frame``, or ``frame > child``."""
    names = []
    offset = 0
    try:
        # A last byte may follow, which distinguishes fields with the same frame.
        while offset + 4 <= len(key):
            (size,) = _unpack_uint32(key, offset)
            name = key[offset + 4 : offset + 4 + size]
            offset += 4 + size
            # In CDR a zero ends the name.
            names.append(name.rstrip(b"\0").decode("utf-8", "replace"))
    except StructError:
        return repr(key)
    return " > ".join(names)


class _StampedField(NamedTuple):
    """A field with stamps, or a field without stamps before it, which has to be skipped.

    Attributes:
        suffix: byte that distinguishes the field's frames from those of other fields.
        has_child: whether a child frame follows the header; None if the field has no stamp.
        trailing_bytes: number of bytes after the frames; None if elements differ in it.
    """

    field: Field
    suffix: bytes
    has_child: Optional[bool]
    trailing_bytes: Optional[int]


def _stamped_fields(definition: Definition) -> List[_StampedField]:
    """Return the fields up to the last one with a stamp."""
    fields: List[_StampedField] = []
    stamped_count = 0
    for field in definition.fields:
        element = field.definition
        if field is definition.fields[0] and field.length is None and _is_header(field):
            fields.append(_StampedField(field, b"", _has_child(definition), 0))
            stamped_count = len(fields)
        elif (
            element is not None
            and field.length is not None
            and element.fields
            and _is_header(element.fields[0])
        ):
            # Without the suffix, two arrays with the same frame would overwrite each other's state.
            suffix = b"%c" % len(fields) if stamped_count else b""
            fields.append(_StampedField(field, suffix, _has_child(element), _count_trailing_bytes(element)))
            stamped_count = len(fields)
        else:
            fields.append(_StampedField(field, b"", None, None))
        # The suffix is one byte, so fields after the first 256 are ignored. No real message has so many.
        if len(fields) > 255:
            break
    return fields[:stamped_count]


def _is_header(field: Field) -> bool:
    return field.type == HEADER and field.length is None and field.name == "header"


def _has_child(definition: Definition) -> bool:
    second_field = definition.fields[1] if len(definition.fields) > 1 else None
    return (
        second_field is not None
        and second_field.name == _CHILD_FRAME_FIELD
        and second_field.type == "string"
        and second_field.length is None
    )


def _count_trailing_bytes(definition: Definition) -> Optional[int]:
    """Return the number of bytes after the frames in ROS 1, or None if it varies."""
    frame_count = 2 if _has_child(definition) else 1
    measure = Definition(definition.name, definition.fields[frame_count:]).measure
    return measure.min_size if measure.is_fixed_size else None


class HeaderPosition(NamedTuple):
    """A header in a message.

    Attributes:
        second: seconds of its stamp.
        nanosecond: nanoseconds of its stamp.
        frame_start: offset of the frame's name, with its length in front.
        end: offset after the name.
    """

    second: int
    nanosecond: int
    frame_start: int
    end: int


class Ros1Walker:
    """Positions in a serialized message of ROS 1. All methods raise `struct.error` if the bytes end before.

    Attributes:
        start: offset of the first slot.
    """

    start = 0

    def __init__(self, data: bytes):
        self.data = data

    def read_count(self, offset: int) -> Tuple[int, int]:
        """Return the number of elements of an array, and the offset of the first one."""
        return _unpack_uint32(self.data, offset)[0], offset + 4

    def read_header(self, offset: int) -> HeaderPosition:
        """Return the position of a header that begins at an offset: seq, secs, nsecs, and the frame's name."""
        second, nanosecond, size = _unpack_header(self.data, offset)
        return HeaderPosition(second, nanosecond, offset + 12, offset + 16 + size)

    @staticmethod
    def string_start(offset: int) -> int:
        """Return the offset of the length of a string."""
        return offset

    def skip_string(self, offset: int) -> int:
        """Return the offset after a string."""
        return offset + 4 + int(_unpack_uint32(self.data, offset)[0])

    def skip_slot(self, slot: Field, offset: int) -> int:
        """Return the offset after a slot."""
        return find_slot_end(self.data, slot, offset)

    def skip_rest(self, element: _StampedField, start: int, frames_end: int) -> int:
        """Return the offset after an element with a header, given its start and the end of its frames."""
        if element.trailing_bytes is not None:
            return frames_end + element.trailing_bytes
        return self.skip_slot(element.field._replace(length=None), start)


class CdrWalker:
    """Positions in a CDR message; see `Ros1Walker`."""

    start = ENCAPSULATION_BYTES

    def __init__(self, data: bytes):
        self.data = data
        byte_order = BYTE_ORDERS.get(data[:2])
        if byte_order is None:
            raise StructError
        self._unpack_uint32 = Struct(byte_order + "I").unpack_from

    def read_count(self, offset: int) -> Tuple[int, int]:
        """Return the number of elements of an array, and the offset of the first one before its padding."""
        offset = offset + 3 & -4
        return self._unpack_uint32(self.data, offset)[0], offset + 4

    def read_header(self, offset: int) -> HeaderPosition:
        """Return the position of a header that begins at an offset, before its padding."""
        second, offset = self.read_count(offset)
        nanosecond, frame_start = self.read_count(offset)
        # A negative time has no event form. Decoding the message reports the error.
        if second > MAX_SECONDS:
            raise StructError
        return HeaderPosition(second, nanosecond, frame_start, self.skip_string(frame_start))

    @staticmethod
    def string_start(offset: int) -> int:
        """Return the offset of the length of a string, after its padding."""
        return offset + 3 & -4

    def skip_string(self, offset: int) -> int:
        """Return the offset after a string."""
        size, start = self.read_count(offset)
        return self._check_end(start + size)

    def skip_rest(self, element: _StampedField, start: int, frames_end: int) -> int:
        """Return the offset after an element with a header, given its start and the end of its frames."""
        return self.skip_slot(element.field._replace(length=None), start)

    def skip_slot(self, slot: Field, offset: int) -> int:
        """Return the offset after a slot."""
        count = 1 if slot.length is None else slot.length
        if count == VARIABLE_LENGTH:
            count, offset = self.read_count(offset)
        layout = number_layout(slot)
        if layout is not None:
            codes, size = layout
            if count:
                offset = aligned_offset(offset, size) + count * len(codes) * size
            return self._check_end(offset)
        # Each element has a byte at least, so the end is checked after as many steps.
        element = slot._replace(length=None)
        for _ in range(count):
            offset = self._skip_element(element, offset)
        return offset

    def _skip_element(self, slot: Field, offset: int) -> int:
        if slot.definition is not None:
            slots = cdr_slots(slot.definition)
            for inner in slots:
                offset = self.skip_slot(inner, offset)
            return offset if slots else self._check_end(offset + 1)
        if slot.type in TIMES:
            return self._check_end((offset + 3 & -4) + 8)
        if slot.is_wide:
            # The width of characters is unknown here; the stamps before are returned.
            raise StructError
        return self.skip_string(offset)

    def _check_end(self, offset: int) -> int:
        if offset > len(self.data):
            raise StructError
        return offset


def _collect_stamps(
    walker: Union[Ros1Walker, CdrWalker], fields: List[_StampedField], stamps: List[FrameStamp]
) -> None:
    """Add the stamps of a message to ``stamps``, so that those before an error are known."""
    offset = walker.start
    for field in fields:
        if field.has_child is None:
            offset = walker.skip_slot(field.field, offset)
            continue
        count = 1 if field.field.length is None else field.field.length
        if count == VARIABLE_LENGTH:
            count, offset = walker.read_count(offset)
        for _ in range(count):
            header = walker.read_header(offset)
            frames = walker.data[header.frame_start : header.end]
            end = header.end
            if field.has_child:
                # Without the padding before it, which some implementations do not clear.
                child_start = walker.string_start(end)
                end = walker.skip_string(end)
                frames += walker.data[child_start:end]
            if header.second or header.nanosecond:
                stamps.append((frames + field.suffix, header.second * SECOND + header.nanosecond))
            # The child frame is a field of the message itself, so that the loop reaches it next.
            if field.field.length is None:
                offset = header.end
            else:
                offset = walker.skip_rest(field, offset, end)
