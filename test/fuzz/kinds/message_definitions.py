"""Texts of message definitions."""

from typing import Any, Tuple

from retalis import Definitions
from retalis.messages.message_to_event_text import make_text_writer
from retalis.messages.type_registry import InstalledTypes

from ..mutate import mutate_text, random_tokens, to_bytes, to_text
from ..side_effects import FindingError
from .base import Kind

PIECES: Tuple[str, ...] = (
    "int32 ",
    "string ",
    "float64[] ",
    "uint8[",
    "bool[3] ",
    "time ",
    "Header ",
    "pkg/Type ",
    "=",
    "#",
    "\n",
    "=" * 80 + "\nMSG: pkg/Type\n",
    "[1000]",
    "[0]",
    "[-1]",
    "[]",
    "x",
    "import",
    "X=1",
    "const_=",
    "0x",
    "1e9",
    "[99999999999]",
    "MSG: ",
    "class ",
    "é",
    "\r",
    "\x0b",
    "\x85",
    "std_msgs/Header h",
    "string S= a # b ",
    "/",
)


class Inputs(Kind):
    """The first line of an input is the type's name."""

    block_size = 100

    def setup(self) -> None:
        self.installed = InstalledTypes()
        self.installed.text("no_such_package/Type")

    def reset(self) -> None:
        self.known = Definitions(self.installed)

    def generate(self, rng: Any) -> bytes:
        if rng.random() < 0.2:
            return to_bytes("pkg/Soup\n" + random_tokens(rng, PIECES, 12))
        return to_bytes(mutate_text(rng, rng.choice(self.texts), self.texts, PIECES))

    def run(self, data: Any) -> None:
        name, _, text = to_text(data).partition("\n")
        definition = self.attempt(self.known.add, name, text)
        if definition is None:
            return
        again = self.attempt(self.known.add, name, definition.full_text)
        if again is None or again.md5sum != definition.md5sum:
            raise FindingError("difference", "the full text is not that of the same type", "definitions")
        decoder = self.attempt(self.known.decoder, definition)
        encoder = self.attempt(self.known.encoder, definition)
        if decoder is None or encoder is None:
            return
        write = make_text_writer(decoder)
        for size in (0, 64):
            message = bytes(size)
            self.attempt(decoder.stamp, message)
            self.attempt(write, message)
            term = self.attempt(decoder.decode, message)
            if term is not None and encoder.encode(term) != message:
                raise FindingError("difference", "zeros do not come back", "definitions")
