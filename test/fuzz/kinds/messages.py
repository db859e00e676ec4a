"""Bytes of messages of many types, and terms that are to become messages."""

import random
import struct
from typing import Any, Dict, Tuple

from retalis import Definitions
from retalis.messages.message_to_event_text import make_text_writer
from retalis.prolog.syntax.event_text import EventReader
from retalis.prolog.syntax.event_text import to_text as text_of

from ..mutate import mutate_bytes, mutate_text, to_bytes, to_text
from ..side_effects import FindingError
from .base import CORPUS, Kind

SIZES = {"bool": "?", "int8": "b", "byte": "b", "uint8": "B", "char": "B", "int16": "h", "uint16": "H"}
SIZES.update(int32="i", uint32="I", int64="q", uint64="Q", float32="f", float64="d")
TEXTS: Tuple[bytes, ...] = (
    b"",
    b"/map",
    b"base_link",
    "é".encode(),
    b'a "quoted" \\ one',
    b"\xff\xfe",
    b"it's\n",
    b"x" * 300,
)
# Beyond ASCII: several scripts, separators, controls of C1, cut, overlong and surrogate sequences, long texts.
TEXTS += tuple(
    text.encode()
    for text in ("Küche \u65e5\u672c", "\u2028", "\x85", "\U0001f600'", "e\u0301", "\ufeffa", 'é"\\')
)
TEXTS += (
    b"\xc3",
    b"\xc0\x80",
    b"\xed\xa0\x80",
    "ü".encode() * 700,
    "ü".encode() * 700 + b"\xc3",
    "FFFFFFFFFFü".encode(),
)
PIECES: Tuple[str, ...] = (
    "nan",
    "inf",
    "-inf",
    "1e400",
    "-1",
    "4294967296",
    "99999999999999999999",
    "true",
    "X",
    "[]",
    "[1,2|T]",
)
PIECES += (
    "'\"t\"'",
    "a",
    '"s"',
    "{}",
    "f(x)",
    "[1,2,3]",
    "(a,b)",
    "std_msgs__0__Header(0,[0,0],'\"\"')",
    "'\"é∀\"'",
    "'\"\\x85\\\"'",
    "é",
)


def valid(rng: Any, definition: Any) -> bytes:
    """Return the bytes of a random message."""
    return b"".join(_slot(rng, slot) for slot in definition.fields)


def _slot(rng: Any, slot: Any) -> Any:
    if slot.length is None:
        return _element(rng, slot)
    number = rng.choice((0, 1, 2, 5, 40)) if slot.length < 0 else slot.length
    start = struct.pack("<I", number) if slot.length < 0 else b""
    return start + b"".join(_element(rng, slot) for _ in range(number))


def _element(rng: Any, slot: Any) -> Any:
    if slot.definition is not None:
        return valid(rng, slot.definition)
    if slot.type == "string":
        text = rng.choice(TEXTS)
        return struct.pack("<I", len(text)) + text
    if slot.type in ("time", "duration"):
        return struct.pack("<II", rng.randrange(1 << 31), rng.randrange(10**9))
    return bytes(rng.randrange(256) for _ in range(struct.calcsize(SIZES[slot.type])))


class Inputs(Kind):
    block_size = 5000

    def setup(self) -> None:
        self.known = Definitions()
        self.types = {}
        for path in sorted((CORPUS / "message_definitions").glob("*.msg")):
            name, _, text = path.read_text().partition("\n")
            self.types[name] = self.known.add(name, text)
        self.names = sorted(self.types)
        self.writers = {name: make_text_writer(self.known.decoder(kind)) for name, kind in self.types.items()}
        self.valid: Dict[Any, Any] = {}

    def reset(self) -> None:
        self.reader = EventReader()

    def generate(self, rng: Any) -> bytes:
        if not self.valid:
            self._create_messages()
        name = rng.choice(self.names)
        data = rng.choice(self.valid[name])
        if rng.random() < 0.7:
            return f"decode {name}\n".encode() + mutate_bytes(rng, data, self.valid[rng.choice(self.names)])
        texts = self.written[name]
        return f"encode {name}\n".encode() + to_bytes(mutate_text(rng, rng.choice(texts), texts, PIECES))

    def _create_messages(self) -> None:
        rng = random.Random(1)
        for name, kind in self.types.items():
            self.valid[name] = [valid(rng, kind) for _ in range(20)]
        self.written = {name: [self.writers[name](data) for data in self.valid[name]] for name in self.names}

    def run(self, data: Any) -> None:
        head, _, body = data.partition(b"\n")
        work, _, name = head.decode().partition(" ")
        definition = self.types[name]
        decoder, encoder = self.known.decoder(definition), self.known.encoder(definition)
        if work == "decode":
            self.decode(decoder, encoder, self.writers[name], body)
        else:
            term = self.attempt(self.reader.read, to_text(body))
            message = None if term is None else self.attempt(encoder.encode, term, "/topic")
            if message is not None:
                text_of(decoder.decode(message))

    def decode(self, decoder: Any, encoder: Any, write: Any, data: Any) -> None:
        self.attempt(decoder.stamp, data)
        text = self.attempt(write, data)
        term = self.attempt(decoder.decode, data)
        if (text is None) != (term is None):
            raise FindingError(
                "difference", "text and term do not agree on whether it is a message", "messages"
            )
        if term is None:
            return
        if text_of(term) != text:
            raise FindingError("difference", f"{text_of(term)[:100]} is no {text[:100]}", "messages")
        read = self.attempt(self.reader.read, text)
        if read is not None:
            message = self.attempt(encoder.encode, read)
            if message is not None and text_of(decoder.decode(message)) != text:
                raise FindingError("difference", "its text does not come back as the message", "messages")
        lazy = decoder.lazy(data)
        repeated = encoder.encode(lazy)
        if text_of(decoder.decode(repeated)) != text:
            raise FindingError("difference", "it does not come back as it was", "messages")
