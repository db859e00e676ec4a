"""Source of decoding functions for messages that are numbers, then texts, then numbers."""

from struct import Struct
from typing import Callable, List, Optional, Tuple

from ..foundation import Cache
from ..prolog.terms import Term
from .decode_code import DecoderSource
from .definition import Definition, Field
from .textcache import keep_text, read_texts, text_cache


class Unsuited(Exception):
    """The type is not numbers, texts, numbers."""


class FrameSource(DecoderSource):
    """Source for types that are numbers, then texts, then numbers.

    An array of messages at the end is taken to have one element.
    """

    def __init__(self) -> None:
        super().__init__()
        self.texts: List[str] = []
        self.before: Tuple[str, List[str]] = ("", [])
        self.count: Optional[str] = None
        self.closed = False

    def fixed(self, code: str) -> str:
        """Add a number, before the texts or behind them."""
        if self.closed:
            raise Unsuited
        return super().fixed(code)

    def string(self) -> str:
        """Add a text, which stands beside the others."""
        if self.closed or (self.texts and self.format):
            raise Unsuited
        if not self.texts:
            self.before = self.format, self.targets
            self.format, self.targets = "", []
        self.texts.append(self.name("t"))
        return self.texts[-1]

    def variable(self, slot: Field) -> str:
        """Add the array of messages, if it is the only one and before all texts."""
        if slot.definition is None or self.texts or self.count:
            raise Unsuited
        self.count = self.fixed("I")
        element = self.message(slot.definition)
        self.closed = True
        return self.only(element)

    def only(self, element: str) -> str:
        """Return the source of the list of one element."""
        return f"(C, {element}, N)"

    def elements(self, slot: Field, number: str) -> str:
        """Refuse: elements that differ in size are not of this shape."""
        raise Unsuited

    def build(self, definition: Definition, general: Callable[[bytes], object]) -> List[str]:
        """Return the source of the whole function, which falls back on ``general``.

        Raises:
            Unsuited: where the type is not of this shape.
        """
        if definition.measure.may_be_bare:  # which have to be counted first
            raise Unsuited
        result = self.message(definition)
        head, tail = Struct("<" + self.before[0]), Struct("<" + self.format)
        if not self.texts or not (head.size or tail.size):
            raise Unsuited
        result = self.finish(result)
        self.names.update(head=head.unpack_from, tail=tail.unpack_from, general=general)
        self._cache_texts()
        key = f"data[{head.size}:{-tail.size if tail.size else ''}]"
        lines = ["def decode(data):", "  try:"]
        if self.before[1]:
            lines.append(f"    {', '.join(self.before[1])}, = head(data)")
        if self.count:
            lines.append(f"    if {self.count} != 1: return general(data)")
        lines += [
            f"    k = known({key})",
            "    if k is None:",
            f"      k = learn({key})",
            "      if k is None: return general(data)",
        ]
        if tail.size:
            lines.append(f"    {', '.join(self.targets)}, = tail(data, {-tail.size})")
        lines += ["  except StructError:", "    return general(data)"]
        lines.append(f"  {', '.join(self.texts)}{'' if len(self.texts) == 1 else ','} = k")
        return [*lines, f"  return {result}"]

    def _cache_texts(self) -> None:
        """Have ``known`` and ``learn`` give all texts of a message by the bytes that they make up."""
        cache: Cache[bytes, object] = text_cache()
        number = len(self.texts)
        kept = self.kept

        def learn(key: bytes) -> object:
            read = read_texts(key, number)
            if read is None:
                return None
            texts = tuple(kept(text) for text in read)
            return keep_text(cache, key, texts if number > 1 else texts[0])

        self.names.update(known=cache.get, learn=learn)

    def finish(self, result: str) -> str:
        """Return the source of what the function gives, from the source of the message's term."""
        return result

    def kept(self, text: Term) -> object:
        """Return what stands for a text in it."""
        return text
