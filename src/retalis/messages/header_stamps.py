"""Extraction of header stamps from serialized messages, for the monitoring of clock skew.

A stamp is a time with the frame that it belongs to (``frame_id`` and, if it follows, ``child_frame_id``). Stamps are
read from the message's own header and from the headers of array elements, at offsets that are computed from the type
definition: nothing is decoded. Every message is inspected, so the common case must be cheap: the observer is called
only if the second of a frame's stamp differs from the last one observed. For types that `FrameDecoderGenerator`
supports, that comparison is part of the generated decoding function; for other types it happens when the message's
time is read.
"""

from copy import copy
from struct import Struct
from struct import error as StructError
from typing import Any, Callable, List, Mapping, NamedTuple, Optional, Tuple

from ..prolog.terms.timestamps import SECOND
from .decoder import Decoder, StampWatch, UnsupportedLayout, make_watching_decoder
from .type_definition import HEADER, VARIABLE_LENGTH, Definition, Field, find_slot_end

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

_unpack_header = Struct("<4xIII").unpack_from
"""Reads secs, nsecs and the length of frame_id from a header, which begins with seq."""
_unpack_uint32 = Struct("<I").unpack_from


def make_stamp_reader(definition: Definition) -> Optional[ReadStamps]:
    """Return the function that reads the stamps of messages of a type; None if the type has no stamps.

    Zero stamps are unset and are omitted. If the bytes are malformed, the stamps before the error are returned.
    """
    fields = _stamped_fields(definition)
    if not fields:
        return None

    def read_stamps(data: bytes) -> List[FrameStamp]:
        stamps: List[FrameStamp] = []
        try:
            _collect_stamps(data, fields, stamps)
        except StructError:  # decoding the message reports the error
            pass
        return stamps

    return read_stamps


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
    read_stamps = make_stamp_reader(definition)
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
    """Return a fast reader for messages whose only stamp is that of their header."""

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
            names.append(key[offset + 4 : offset + 4 + size].decode("utf-8", "replace"))
            offset += 4 + size
    except StructError:
        return repr(key)
    return " > ".join(names)


class _StampedField(NamedTuple):
    """A field with stamps, or a field without stamps before it, which has to be skipped.

    Attributes:
        field: the field.
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
    """Return the number of bytes after the frames, or None if it varies."""
    frame_count = 2 if _has_child(definition) else 1
    measure = Definition(definition.name, definition.fields[frame_count:]).measure
    return measure.min_size if measure.is_fixed_size else None


def _collect_stamps(data: bytes, fields: List[_StampedField], stamps: List[FrameStamp]) -> None:
    """Add the stamps of a message to ``stamps``, so that those before an error are known."""
    # Offsets as on the wire: seq, secs, nsecs, length of frame_id (4 bytes each), then the frame's name.
    offset = 0
    for field, suffix, has_child, trailing_bytes in fields:
        if has_child is None:
            offset = find_slot_end(data, field, offset)
            continue
        count = 1 if field.length is None else field.length
        if count == VARIABLE_LENGTH:
            (count,) = _unpack_uint32(data, offset)
            offset += 4
        for _ in range(count):
            second, nanosecond, size = _unpack_header(data, offset)
            end = offset + 16 + size
            next_field = end
            if has_child:
                end += 4 + _unpack_uint32(data, end)[0]
            if second or nanosecond:
                stamps.append((data[offset + 12 : end] + suffix, second * SECOND + nanosecond))
            # The child frame is a field of the message itself, so that the loop reaches it next.
            if field.length is None:
                offset = next_field
            elif trailing_bytes is not None:
                offset = end + trailing_bytes
            else:
                offset = find_slot_end(data, field._replace(length=None), offset)
