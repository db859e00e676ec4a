"""Headers of connections, from the type that is asked for to the decoder of the messages."""

import json
from typing import Any

from retalis import Definitions
from retalis.messages.type_registry import InstalledTypes

from ..mutate import mutate_text, to_bytes, to_text
from .base import Kind
from .message_definitions import PIECES

FIELDS = ("type", "message_definition", "md5sum", "callerid", "topic")


class Inputs(Kind):
    """An input is a JSON object: the header, with the type that is asked for as ``wanted``."""

    block_size = 100

    def setup(self) -> None:
        self.installed = InstalledTypes()
        self.installed.text("no_such_package/Type")
        self.headers = [json.loads(data) for data in self.corpus if data.startswith(b"{")]
        self.values = {
            field: [str(header.get(field, "")) for header in self.headers] for field in (*FIELDS, "wanted")
        }

    def reset(self) -> None:
        self.known = Definitions(self.installed)

    def generate(self, rng: Any) -> bytes:
        header = dict(rng.choice(self.headers))
        for _ in range(rng.randint(1, 3)):
            field = rng.choice((*FIELDS, "message_definition", "wanted"))
            draw = rng.random()
            if draw < 0.1:
                header.pop(field, None)
            elif draw < 0.3:
                header[field] = rng.choice(self.values[field])
            else:
                texts = self.values[field]
                header[field] = mutate_text(rng, str(header.get(field, "")), texts, PIECES)
        return to_bytes(json.dumps(header))

    def run(self, data: Any) -> None:
        try:
            header = json.loads(to_text(data))
        except ValueError:  # an input that was shortened too far
            return
        self.attempt(self.process_header, header)

    def process_header(self, header: Any) -> bool:
        """Process a header as the ROS interface does for a connection."""
        requested_type = header.get("wanted", "pkg/Type")
        text, md5sum = header.get("message_definition", ""), header.get("md5sum", "*")
        is_known = requested_type in self.known
        definition = self.known.received(requested_type, header.get("type", "*"), text, md5sum)
        decoder = self.known.decoder(definition)
        for message in (b"", bytes(64)):
            self.attempt(decoder.decode, message)
        return is_known
