"""The stamps in the bytes of a message, each with the frame that it is of; cheap to look at for every message."""

from copy import copy
from struct import Struct
from struct import error as StructError
from typing import Any, Callable, List, Mapping, NamedTuple, Optional, Tuple

from ..prolog.terms.timestamps import SECOND
from .decoder import Decoder, Unsuited, Watch, watching_decoder
from .type_definition import HEADER, VARIABLE, Definition, Field, element_end

FrameStamp = Tuple[bytes, int]
"""The bytes that stand for a frame, and an instant in nanoseconds."""

ReadStamps = Callable[[bytes], List[FrameStamp]]

ReadStamp = Callable[[bytes], Optional[int]]
"""From the bytes of a message to the time of its own header, as `Decoder.stamp`."""

Look = Callable[[List[FrameStamp]], object]
"""Takes the stamps of a message of which one may be new."""

_CHILD = "child_frame_id"

_header = Struct("<4xIII").unpack_from
_number = Struct("<I").unpack_from


def stamp_reader(definition: Definition) -> Optional[ReadStamps]:
    """Return what reads the stamps of messages of a type; None for a type that has none.

    These are the stamps of its own header and of the elements of its arrays, with ``frame_id`` and, where it follows,
    ``child_frame_id``. A stamp of zero says nothing and is left out, and so is what broken bytes do not hold.
    """
    slots = _stamped_slots(definition)
    if not slots:
        return None

    def read(data: bytes) -> List[FrameStamp]:
        found: List[FrameStamp] = []
        try:
            _walk(data, slots, found)
        except StructError:  # who makes the term says what is wrong
            pass
        return found

    return read


def watched(decoder: Decoder, known: Mapping[bytes, Any], look: Look) -> Decoder:
    """Return a decoder that hands on the stamps that are not of a known second.

    It does so where it decodes a message if frames are looked up there anyhow, otherwise where it gives the time
    of the message's header: whoever takes messages has to call both.

    Args:
        decoder: of the messages' type.
        known: has for the bytes of a frame what has the attribute ``second``: the second that is known.
        look: takes all stamps of a message where one is of another second; what it raises comes out.
    """
    definition, stamp, get = decoder.definition, decoder.stamp, known.get
    read = stamp_reader(definition)
    if read is None:
        return decoder
    all_stamps: ReadStamps = read

    def look_at(data: bytes) -> None:
        found = all_stamps(data)
        for key, instant in found:
            seen = get(key)
            if seen is None or seen.second != instant // SECOND:
                look(found)
                break

    def look_at_one(key: bytes, instant: int) -> None:
        if instant:
            look([(key, instant)])

    try:
        watch = Watch(_texts_of_frames(definition), get, look_at, look_at_one)
        return watching_decoder(decoder, watch)
    except Unsuited:
        pass

    def watched_stamp(data: bytes) -> Optional[int]:
        look_at(data)
        return stamp(data)

    watching = copy(decoder)
    slots = _stamped_slots(definition)
    single = len(slots) == 1 and slots[0].slot.length is None and not slots[0].has_child
    watching.stamp = _own(get, watched_stamp) if single else watched_stamp
    return watching


def _texts_of_frames(definition: Definition) -> int:
    """Return how many texts are the frames of a message with one stamp, or of the only element of its only slot.

    Raises:
        Unsuited: for types of another form.
    """
    slots = _stamped_slots(definition)
    if len(slots) > 1 or (slots[0].slot.length is not None and len(definition.fields) > 1):
        raise Unsuited
    return 2 if slots[0].has_child else 1


def _own(get: Callable[[bytes], Any], rest: ReadStamp) -> ReadStamp:
    """Return the short way for messages whose only stamp is that of their header."""

    def watched_header(data: bytes) -> Optional[int]:
        try:
            second, nanosecond, size = _header(data)
        except StructError:
            return rest(data)
        seen = get(data[12 : 16 + size])
        if seen is not None and seen.second == second:
            return second * SECOND + nanosecond or None
        return rest(data)

    return watched_header


def frame_text(key: bytes) -> str:
    """Return the bytes that stand for a frame as people read them: the frame, or a frame and its child."""
    names = []
    at = 0
    try:
        while at + 4 <= len(key):  # a byte may follow that tells slots apart
            (size,) = _number(key, at)
            names.append(key[at + 4 : at + 4 + size].decode("utf-8", "replace"))
            at += 4 + size
    except StructError:
        return repr(key)
    return " > ".join(names)


class _StampedSlot(NamedTuple):
    """A slot that has stamps, or one that lies before such a slot and has to be passed over.

    Attributes:
        slot: the slot.
        suffix: what tells its frames from those of other slots.
        has_child: whether a child's frame follows the header; None where there is no stamp.
        rest: the bytes that follow; None where elements differ in them.
    """

    slot: Field
    suffix: bytes
    has_child: Optional[bool]
    rest: Optional[int]


def _stamped_slots(definition: Definition) -> List[_StampedSlot]:
    """Return the slots up to the last one with stamps."""
    slots: List[_StampedSlot] = []
    stamped = 0
    for slot in definition.fields:
        inner = slot.definition
        if slot is definition.fields[0] and slot.length is None and _is_header(slot):
            slots.append(_StampedSlot(slot, b"", _has_child(definition), 0))
            stamped = len(slots)
        elif inner is not None and slot.length is not None and inner.fields and _is_header(inner.fields[0]):
            suffix = b"%c" % len(slots) if stamped else b""
            slots.append(_StampedSlot(slot, suffix, _has_child(inner), _fixed_rest(inner)))
            stamped = len(slots)
        else:
            slots.append(_StampedSlot(slot, b"", None, None))
        if len(slots) > 255:
            break
    return slots[:stamped]


def _is_header(slot: Field) -> bool:
    return slot.type == HEADER and slot.length is None and slot.name == "header"


def _has_child(definition: Definition) -> bool:
    second = definition.fields[1] if len(definition.fields) > 1 else None
    return second is not None and second.name == _CHILD and second.type == "string" and second.length is None


def _fixed_rest(definition: Definition) -> Optional[int]:
    """Return how many bytes follow the frames; None where that differs."""
    rest = Definition(definition.name, definition.fields[2 if _has_child(definition) else 1 :]).measure
    return rest.least if rest.fixed else None


def _walk(data: bytes, slots: List[_StampedSlot], found: List[FrameStamp]) -> None:
    at = 0
    for slot, suffix, has_child, rest in slots:
        if has_child is None:
            at = element_end(data, slot, at)
            continue
        number = 1 if slot.length is None else slot.length
        if number == VARIABLE:
            (number,) = _number(data, at)
            at += 4
        for _ in range(number):
            second, nanosecond, size = _header(data, at)
            end = at + 16 + size
            following = end
            if has_child:
                end += 4 + _number(data, end)[0]
            if second or nanosecond:
                found.append((data[at + 12 : end] + suffix, second * SECOND + nanosecond))
            if slot.length is None:  # the child's frame is the next slot
                at = following
            elif rest is not None:
                at = end + rest
            else:
                at = element_end(data, slot._replace(length=None), at)
