"""Source of decoding functions for messages that are numbers, then texts, then numbers."""

from struct import Struct
from typing import Any, Callable, List, NamedTuple, Optional, Tuple

from ..foundation import Cache
from ..prolog.terms import SECOND, Term
from .decode_code import DecoderSource
from .definition import Definition, Field
from .textcache import TEXT_COST, keep_text, read_texts, text_cache

_BESIDE = 400
"""Bytes of what is kept beside the texts under one name."""


class Unsuited(Exception):
    """The type is not numbers, texts, numbers."""


class Watch(NamedTuple):
    """Who looks at the stamps of messages while these are read: their frames are looked up then in any case.

    Attributes:
        texts: how many texts of a message name its frames, which have to be all that it has.
        get: gives for the bytes of these texts what has the attribute ``second``, which is known; None for none.
            What it gives no more has a negative one from then on.
        look_all: looks at a message that is read in another way. What it raises comes out.
        look: the same for a message of another second, of which the frames' bytes and the time are known.
    """

    texts: int
    get: Callable[[bytes], Any]
    look_all: Callable[[bytes], object]
    look: Callable[[bytes, int], object]


class _Nothing:
    """What is known of frames that nobody has looked at."""

    second = -1


_NOTHING = _Nothing()


class FrameSource(DecoderSource):
    """Source for types that are numbers, then texts, then numbers.

    An array of messages at the end is taken to have one element.

    Args:
        watch: looks at the stamps of messages that are read.
    """

    def __init__(self, watch: Optional[Watch] = None) -> None:
        super().__init__()
        self.watch = watch
        self.texts: List[str] = []
        self.before: Tuple[str, List[str]] = ("", [])
        self.count: Optional[str] = None
        self.beside: List[str] = []
        """Variables whose values are kept beside the texts of a message's frames, None at first."""

    def string(self) -> str:
        """Add a text, which stands beside the others."""
        if self.texts and self.format:
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
        return self.only(element)

    def only(self, element: str) -> str:
        """Return the source of the list of one element."""
        return f"(C, {element}, N)"

    def elements(self, slot: Field, number: str) -> str:
        """Refuse: elements that differ in size are not of this shape."""
        raise Unsuited

    def build(self, definition: Definition, general: Callable[[bytes], object]) -> List[str]:
        """Return the source of the whole function, which falls back on ``general``, which looks by itself.

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
        lines = ["def decode(data):", "  try:"]
        if self.before[1]:
            lines.append(f"    {', '.join(self.before[1])}, = head(data)")
        if self.count:
            lines.append(f"    if {self.count} != 1: return general(data)")
        lines += [
            f"    key = data[{head.size}:{-tail.size if tail.size else ''}]",
            "    k = known(key)",
            "    if k is None:",
            "      k = learn(key)",
            "      if k is None: return general(data)",
        ]
        if tail.size:
            lines.append(f"    {', '.join(self.targets)}, = tail(data, {-tail.size})")
        lines += ["  except StructError:", "    return general(data)"]
        found = list(self.texts)
        if self.watch is not None:
            found.append("f")
        found[len(self.texts) : len(self.texts)] = self.beside
        lines.append(f"  {', '.join(found)}{'' if len(found) == 1 else ','} = k")
        if self.watch is not None:
            lines += self._look(self.watch)
        lines += self.prepare(tail.size)
        return [*lines, f"  return {result}"]

    def _look(self, watch: Watch) -> List[str]:
        """Return the lines that have a message looked at whose second is not known of its frames.

        Raises:
            Unsuited: where the frames are not all texts, or no stamp stands where a header has it.
        """
        at = 2 if self.count else 1  # behind ``seq``
        code, targets = self.before
        if len(self.texts) != watch.texts or code[: at + 2] != "I" * (at + 2):
            raise Unsuited
        get, look_at = watch.get, watch.look

        def look(key: bytes, second: int, nanosecond: int, known: List[object]) -> None:
            """Have a message looked at, and keep what is known of its frames beside the texts."""
            seen = get(key)
            try:
                if seen is None or seen.second != second:
                    look_at(key, second * SECOND + nanosecond)
                    seen = get(key)
            finally:
                known[-1] = seen or _NOTHING

        self.names["look"] = look
        second, nanosecond = targets[at : at + 2]
        return [f"  if f.second != {second}: look(key, {second}, {nanosecond}, k)"]

    def _cache_texts(self) -> None:
        """Have ``known`` and ``learn`` give all texts of a message by the bytes that they make up."""
        more = _BESIDE * len(self.beside)
        cache: Cache[bytes, object] = Cache(2048, 2 << 20, 1024 + more) if more else text_cache()
        number = len(self.texts)
        kept, watched, beside = self.kept, self.watch is not None, [None] * len(self.beside)

        def learn(key: bytes) -> object:
            read = read_texts(key, number)
            if read is None:
                return None
            texts = [kept(text) for text in read]
            if watched or beside:
                known = [*texts, *beside, *([_NOTHING] if watched else ())]
                return cache.keep(key, known, TEXT_COST * len(key) + more)
            return keep_text(cache, key, tuple(texts) if number > 1 else texts[0])

        self.names.update(known=cache.get, learn=learn)

    def prepare(self, tail: int) -> List[str]:
        """Return the lines that make what the result needs besides, ``tail`` being the bytes behind the texts.

        They find what is known of the frames in ``k``, and in it, after the texts, what is kept `beside` them.
        """
        return []

    def finish(self, result: str) -> str:
        """Return the source of what the function gives, from the source of the message's term."""
        return result

    def kept(self, text: Term) -> object:
        """Return what stands for a text in it."""
        return text
