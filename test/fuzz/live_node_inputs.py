"""Requests, texts, messages and headers for a live node; ``test/ros1/rostests/malformed_inputs.py`` sends them."""

import json
import random
from typing import Any, Tuple

from retalis import Definitions

from .kinds.base import ARGUMENTS, corpus
from .kinds.messages import valid
from .mutate import mutate_bytes, mutate_text, random_tokens, to_text

EVENTS = (
    "a(X)",
    "a(X,Y)",
    "std_msgs__0__String(S)",
    "b",
    "_",
    "fuzz__0__A(N,T)",
    "'quoted name'(X)",
    "f(X), g(X)",
)
CONDITIONS = (
    "",
    "X > 1",
    "true",
    "member(X,[1,2])",
    "X > 1, \\+ foo(X)",
    "repeat, fail",
    "atom_length(X,_)",
    "X = f(X)",
)
FORMATS = ("_", "got(X)", "h(X,Z)", "std_msgs__0__String('\"x\"')", "[X]", "1", "X.")
NAMES = (
    "t",
    "id1",
    "m1",
    "1",
    "",
    "/robot/out",
    "~private",
    "a b",
    "__import__('os')",
    "../x",
    "é",
    "%s",
    "X",
    "\\",
    "'",
)
SIZES = ("10", "0", "-1", "", "1e3", "100", "999999999999999999999999", "ten", " 7 ", "٣")
TOPICS = ("fuzz_a", "fuzz_b", "tf", "/x/y", "retalisInputEvents", "", "a b", "1", "~p", "/", "é", "x" * 300)
TYPES = (
    "fuzz/A",
    "std_msgs/String",
    "tf/tfMessage",
    "no/Type",
    "String",
    "/",
    "a/b/c",
    "__import__/os",
    "é/é",
    "",
)
FIELDS = {
    "add_output_subscription": (EVENTS, CONDITIONS, FORMATS, NAMES, NAMES),
    "delete_output_subscription": (NAMES, NAMES),
    "add_memory": (EVENTS, CONDITIONS, FORMATS, NAMES, SIZES),
    "delete_memory": (NAMES,),
    "add_input_subscription": (TOPICS, TYPES),
    "delete_input_subscription": (TOPICS,),
}
PIECES = (
    "(",
    ")",
    ",",
    "'",
    '"',
    "\\",
    "X",
    "[",
    "]",
    "|",
    ":-",
    "\n",
    "\0",
    "%",
    "/*",
    ".",
    "{}",
    "0'",
    " ",
    "é",
    "\U0001f600",
)


class Inputs:
    """Inputs of a node, determined by kind, seed and number."""

    def __init__(self, seed: int = 1) -> None:
        self.seed = seed
        self.events = [to_text(data) for data in corpus("event_texts")]
        self.headers = [json.loads(data) for data in corpus("connection_headers") if data.startswith(b"{")]
        self.known = Definitions()
        header = next(candidate for candidate in self.headers if candidate["type"] == "fuzz/A")
        self.definition = self.known.add("fuzz/A", header["message_definition"])

    def rng(self, kind: str, number: Any) -> Any:
        """Return the generator for an input."""
        return random.Random(f"{kind} {self.seed} {number}")

    def request(self, number: Any) -> Tuple[Any, ...]:
        """Return a service and the texts of its fields."""
        rng = self.rng("request", number)
        name = rng.choice(sorted(FIELDS))
        return name, [self._field(rng, texts) for texts in FIELDS[name]]

    def _field(self, rng: Any, texts: Any) -> Any:
        draw = rng.random()
        if draw < 0.75:
            return rng.choice(texts)
        if draw < 0.8:
            return random_tokens(rng, PIECES)
        if draw < 0.85:
            return rng.choice(ARGUMENTS)
        return mutate_text(rng, rng.choice(texts), texts, PIECES)

    def text(self, number: Any) -> str:
        """Return a text for a topic of type String."""
        rng = self.rng("text", number)
        if rng.random() < 0.3:
            return f"event({rng.choice('ab')}({rng.choice(ARGUMENTS)}))"
        return mutate_text(rng, rng.choice(self.events), self.events, PIECES)

    def message(self, number: Any) -> bytes:
        """Return bytes for a topic of type ``fuzz/A``."""
        rng = self.rng("message", number)
        data = valid(rng, self.definition)
        return data if rng.random() < 0.3 else mutate_bytes(rng, data, [data])

    def header(self, number: Any) -> Tuple[Any, ...]:
        """Return type, definition and checksum as a publisher may send them."""
        rng = self.rng("header", number)
        header = dict(rng.choice(self.headers))
        field = rng.choice(("type", "message_definition", "md5sum"))
        header[field] = mutate_text(rng, header[field], [header[field]], PIECES)
        return header["type"], header["message_definition"], header["md5sum"]
