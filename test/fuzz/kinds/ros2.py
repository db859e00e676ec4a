"""Definitions of ROS 2 mutated, of services and in IDL, too, and messages in CDR for those that are accepted."""

import struct
from typing import Any, Iterator, List, Tuple

from retalis import Definitions
from retalis.messages.idl_definitions import convert_idl
from retalis.messages.message_to_event_text import make_text_writer
from retalis.messages.type_definition import SerializationFormat
from retalis.messages.type_registry import parse_ros2_type
from retalis.prolog.syntax.event_text import to_text as text_of

from ..mutate import mutate_text, random_tokens, to_bytes, to_text
from ..side_effects import FindingError
from .base import Kind

TYPE_NAMES = """
int32 string wstring string<=10 wstring<=4 byte char float64 bool uint8 octet pkg/msg/Type pkg/Type Type Header
builtin_interfaces/Time builtin_interfaces/msg/Duration std_msgs/msg/Header int64 long pkg/msg/msg/Type pkg/srv/Type
no/msg/Such no_such
"""
TYPES = TYPE_NAMES.split()
ARRAYS = (
    "",
    "",
    "",
    "[]",
    "[3]",
    "[<=3]",
    "[0]",
    "[<=0]",
    "[<=99999999999]",
    "[100000000]",
    "[9]",
    "[<=",
    "[-1]",
    "[<3]",
)
ENDINGS: Tuple[str, ...] = (
    "",
    "",
    "",
    " 5",
    " -0x5",
    ' "a#b"',
    " 'it''s'",
    " [1, 2, 3]",
    ' ["a", "b"]',
    " true",
    " nan",
    "=5",
    " = 0x10",
)
ENDINGS += ('="a = b # c"', "='\\'x'", "=", " # comment", '="unclosed', " 1e999", "=1e999", " é", ' "é∀"')
NAMES = (
    "x",
    "y",
    "z",
    "X",
    "Y",
    "data",
    "class",
    "seq",
    "stamp",
    "x_",
    "_x",
    "1x",
    "é",
    "import",
    "MAX_VALUE",
)
SEPARATOR = "=" * 80 + "\nMSG: "
PIECES = (
    *TYPES,
    *ARRAYS,
    *ENDINGS,
    *NAMES,
    " ",
    "\n",
    "#",
    "<=",
    f"\n{SEPARATOR}pkg/msg/Type\n",
    "\r",
    "\x85",
    "MSG: ",
    "\n---\n",
    f"\n{'=' * 80}\nSRV: pkg/srv/Kind\n",
    f"\n{'=' * 80}\nACTION: pkg/action/Kind\n",
    f"\n{'=' * 80}\nIDL: pkg/msg/Kind\n",
)
MSG_NAMES = (
    "pkg/msg/Kind",
    "pkg/Kind",
    "std_msgs/msg/Header",
    "pkg/msg/Type",
    "pkg/action/Kind",
    "Kind",
    "pkg/msg/é",
    "msg/msg/msg",
    "pkg/srv/Kind_Event",
    "pkg/action/Kind_FeedbackMessage",
    "pkg/action/Kind_GetResult_Event",
)
IDL_PIECES = (
    "module msg {", "module pkg {", "struct Kind {", "struct B : Kind {", "union U switch (long) {", "enum E {",
    "A, B", "@value(3) ", "@bit_bound(8) ", "typedef ", "const long N = ", "1 << 3", "N * 2", "-(N)", "case 1:",
    "sequence<", "string<5>", "wstring ", "long ", "unsigned long long ", "double ", "octet ", "boolean ",
    "long double ",    "std_msgs::msg::Header ", "::pkg::msg::Kind ", "E ", "U ", "B ", "a", "b", "[3]", "[N]",
    ",", ">", ";", "};", "};\n",
    "#include <x>\n", "// c\n", "/* c */", '"s"', "'", "{", "}", "(", ")", "=", "\n",
)  # fmt: skip
IDL_START = "module pkg { module msg { enum E { A, B }; const long N = 3; struct Kind {"
KNOWN_TYPES = {
    "pkg/Type": "int32 found\nstring<=3 name",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
}
CDR = (b"\0\1\0\0", b"\0\0\0\0")


class Inputs(Kind):
    """The first line of an input is the type's name; the definition decides which bytes are tried."""

    block_size = 100

    def setup(self) -> None:
        for encoding in ("utf-16-le", "utf-16-be", "utf-32-le", "utf-32-be"):  # imports the codecs
            "".encode(encoding)
        convert_idl("pkg/Kind", f"{IDL_START}}}; }}; }};", ["pkg/Kind"])  # imports lark

    def generate(self, rng: Any) -> bytes:
        draw = rng.random()
        if draw < 0.05:
            name = rng.choice(("pkg/msg/Kind", "pkg/srv/Kind_Event", "pkg/action/Kind_FeedbackMessage"))
            return to_bytes(f"{name}\n{IDL_START}" + random_tokens(rng, IDL_PIECES, 25) + "}; }; };")
        if draw < 0.1:
            return to_bytes(f"{rng.choice(MSG_NAMES)}\n" + random_tokens(rng, PIECES, 15))
        if draw < 0.4 and self.texts:
            return to_bytes(mutate_text(rng, rng.choice(self.texts), self.texts, PIECES))
        text = self.definition(rng)
        for _ in range(rng.choice((0, 0, 1, 2))):
            name = rng.choice(("pkg/msg/Type", "pkg/Type", "std_msgs/msg/Header", "pkg/msg/Kind", "Type"))
            text += f"{SEPARATOR}{name}\n{self.definition(rng)}"
        if rng.random() < 0.3:
            text = mutate_text(rng, text, [text], PIECES)
        return to_bytes(f"{rng.choice(MSG_NAMES[:4])}\n{text}")

    def definition(self, rng: Any) -> str:
        lines: List[Any] = []
        for number in range(rng.choice((0, 1, 2, 3, 6))):
            is_unusual = rng.random() < 0.15
            kind = rng.choice(TYPES if is_unusual else TYPES[:17])
            array = rng.choice(ARRAYS if is_unusual else ARRAYS[:8])
            name = rng.choice(NAMES) if is_unusual else f"x{number}"
            ending = rng.choice(ENDINGS) if is_unusual else ""
            lines.append(f"{kind}{array} {name}{ending}\n")
        return "".join(lines)

    def run(self, data: Any) -> None:
        # Types that differ in arrays of nested types only have one checksum in ROS, the key of `Definitions`.
        self.known = Definitions()
        name, _, text = to_text(data).partition("\n")
        definition = self.attempt(parse_ros2_type, name, text, KNOWN_TYPES.get, text.startswith("module"))
        if definition is None:
            return
        cdr_decoder = self.attempt(self.known.decoder, definition, SerializationFormat.CDR)
        cdr_encoder = self.attempt(self.known.encoder, definition, SerializationFormat.CDR)
        decoder = self.attempt(self.known.decoder, definition)
        encoder = self.attempt(self.known.encoder, definition)
        if decoder is None or encoder is None:
            return
        write = make_text_writer(decoder)
        for raw in self.messages(data):
            term = self.attempt(cdr_decoder.decode, raw)
            if term is None:
                continue
            repeated = self.attempt(cdr_encoder.encode, term)
            if repeated is not None and text_of(cdr_decoder.decode(repeated)) != text_of(term):
                raise FindingError("difference", "it does not come back from CDR as it was", "ros2")
            # The term is a message of ROS 1, too, and comes back through text and term.
            message = self.attempt(encoder.encode, term)
            if message is None:
                continue
            if text_of(term) != write(message):
                raise FindingError("difference", "text and term do not agree", "ros2")
            repeated = self.attempt(encoder.encode, decoder.lazy(message))
            if repeated is not None and text_of(decoder.decode(repeated)) != text_of(term):
                raise FindingError("difference", "it does not come back as it was", "ros2")

    def messages(self, data: Any) -> Iterator[Any]:
        """Yield messages: zeros of all lengths, counts of one, and the bytes of the input."""
        for head in CDR:
            order = "<" if head == CDR[0] else ">"
            for size in range(0, 80, 4):
                yield head + bytes(size)
                yield head + struct.pack(f"{order}I", 1) * (size // 4)
            yield head + data[:200]
            yield head + struct.pack(f"{order}I", 0xFFFFFFFF) + data[:60]
        yield data[:50]
        yield b""
