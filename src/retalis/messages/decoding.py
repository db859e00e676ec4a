"""Message bytes to event terms, by functions that are generated for each type.

The generated source reads each run of fixed-size slots with one `struct` call. Long arrays and texts become
lazy terms: what no rule looks at is cut out of the message and left undecoded. Where a message is numbers,
then texts, then numbers, all texts are looked up at once by the bytes they make up (a robot's frame names
come again and again); so one transform costs two `struct` calls and one look-up.
"""

from copy import copy
from struct import Struct
from struct import error as StructError
from typing import Callable, Optional

from ..foundation import MessageError, codegen
from ..prolog.terms import Lazy, Term, functor
from .decode_code import DecoderSource
from .definition import HEADER, Definition
from .frame_code import FrameSource, Unsuited, Watch
from .layout import BARE, check_bare, explain

Decode = Callable[[bytes], Term]


class Decoder:
    """The decoder of one message type.

    >>> definitions = Definitions()
    >>> decoder = definitions.decoder(definitions.add("my_robot/Bumper", "bool left"))
    >>> Engine().show(decoder.decode(bytes([1])))
    'my_robot__0__Bumper(true)'

    Args:
        definition: the type.
        bare: how many elements without bytes a message may have.

    Attributes:
        definition: the type.
        functor: the functor of its event terms (arity 0: the term is an atom).
        decode: the function from the bytes of a message to its term. Raises `MessageError` where the bytes
            are no such message.
        stamp: the function from the bytes to the time of ``header.stamp`` in nanoseconds; None for a zero
            stamp, and always for a type without a header.
        watch: who looks at the stamps of the messages that `decode` reads; None for nobody.
        plain: the same decoder with nobody who looks, where there is somebody; otherwise None.
    """

    __slots__ = ("definition", "functor", "decode", "stamp", "watch", "plain")

    def __init__(self, definition: Definition, bare: int = BARE):
        self.definition = definition
        self.functor = functor(definition.functor_name, len(definition.fields))
        self.decode: Decode = _compile_decode(definition, bare)
        self.stamp: Callable[[bytes], Optional[int]] = _compile_stamp(definition)
        self.watch: Optional[Watch] = None
        self.plain: Optional[Decoder] = None

    def lazy(self, data: bytes) -> Term:
        """Return the term of a message, decoded when something looks at it.

        A message that is broken is found out only then.

        >>> definitions = Definitions()
        >>> decoder = definitions.decoder(definitions.add("my_robot/Bumper", "bool left"))
        >>> Engine().show(decoder.lazy(bytes([1])))
        'my_robot__0__Bumper(true)'
        """
        if not self.definition.fields:
            return self.decode(data)
        return Lazy(self.functor, self.decode, data)


def watching_decoder(decoder: Decoder, watch: Watch) -> Decoder:
    """Return a decoder that has somebody look at the stamps of the messages that it reads.

    Raises:
        Unsuited: where the type is not of the form for that.
    """
    plain = decoder.decode

    def general(data: bytes) -> Term:
        watch.look_all(data)
        return plain(data)

    found = copy(decoder)
    found.decode = _compile_frames(decoder.definition, general, watch)
    found.watch = watch
    found.plain = decoder
    return found


def _compile_decode(definition: Definition, bare: int) -> Decode:
    code = DecoderSource()
    code.base = "0"
    result = code.message(definition)
    code.flush()
    code.names["fail"] = _failing(definition)
    lines = ["def decode(data):", "  try:", *("    " + line for line in code.lines)]
    lines += [
        f"    if len(data) != {code.place()}: fail(data)",
        "  except StructError: fail(data)",
        f"  return {result}",
    ]
    general: Decode = codegen.function(lines, code.names, f"decode {definition.name}", "decode")
    if definition.measure.may_be_bare:
        return _checked(definition, bare, general)
    try:
        return _compile_frames(definition, general)
    except Unsuited:
        return general


def _compile_frames(definition: Definition, general: Decode, watch: Optional[Watch] = None) -> Decode:
    frames = FrameSource(watch)
    lines = frames.build(definition, general)
    fast: Decode = codegen.function(lines, frames.names, f"decode {definition.name}", "decode")
    return fast


def _checked(definition: Definition, bare: int, decode: Decode) -> Decode:
    """Return the function of a type with arrays that a few bytes may say anything of: they are counted before."""

    def checked(data: bytes) -> Term:
        check_bare(definition, data, bare)
        return decode(data)

    return checked


def _failing(definition: Definition) -> Callable[[bytes], None]:
    def fail(data: bytes) -> None:
        raise MessageError(explain(definition, data))

    return fail


def _compile_stamp(definition: Definition) -> Callable[[bytes], Optional[int]]:
    first = definition.fields[0] if definition.fields else None
    if first is None or first.type != HEADER or first.length is not None or first.name != "header":
        return _no_stamp
    unpack = Struct("<II").unpack_from
    fail = _failing(definition)

    def stamp(data: bytes) -> Optional[int]:
        try:
            seconds, nanoseconds = unpack(data, 4)
        except StructError:
            fail(data)
        return seconds * 1_000_000_000 + nanoseconds or None

    return stamp


def _no_stamp(data: bytes) -> None:
    return None
