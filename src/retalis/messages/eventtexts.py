"""Message bytes to the text of their event terms, without making the terms where their form allows it."""

import re
from typing import Callable, List

from ..foundation import codegen
from ..prolog.syntax import float_text, to_text
from ..prolog.terms import Term
from ._frame_code import FrameSource, Unsuited
from .decoding import Decoder

_MARK = 10**40
_PLACE = re.compile(r"1(0{30}\d{10})(?=[,\])])")
_CODE = re.compile(r"(?<!\d)\d*[a-zA-Z?]")


def text_writer(decoder: Decoder) -> Callable[[bytes], str]:
    """Return the function from the bytes of a message to the text of its event term.

    Messages that are numbers, then texts, then numbers are written by the text of their type with the values
    put in; of others the term is made and written. The function raises `MessageError` as the decoder does.
    """

    def general(data: bytes) -> str:
        return to_text(decoder.decode(data))

    code = _TextSource()
    try:
        lines = code.build(decoder.definition, general)
    except Unsuited:
        return general
    made: Callable[[bytes], str] = codegen.function(
        lines, code.names, f"text of {decoder.definition.name}", "decode"
    )
    return made


class _TextSource(FrameSource):
    """Source of a function that gives the message's text, not its term."""

    def finish(self, result: str) -> str:
        """Return an f-string: the pieces of the term's text by their names, and between them the values."""
        places = {name: f"{{{name}}}" for name in self.texts}
        for names, layout in ((self.before[1], self.before[0]), (self.targets, self.format)):
            for name, kind in zip(names, _CODE.findall(layout)):
                if kind[-1] in "s?c":  # not the value itself stands in the term
                    raise Unsuited
                places[name] = f"{{real({name})}}" if kind in "fd" else f"{{{name}}}"
        self.names["real"] = float_text
        pieces = _PLACE.split(self._template(result, list(places)))
        values = list(places.values())
        pieces[::2] = [f"{{{self.name('p', text)}}}" for text in pieces[::2]]
        pieces[1::2] = [values[int(place)] for place in pieces[1::2]]
        return f'f"{"".join(pieces)}"'

    def _template(self, result: str, names: List[str]) -> str:
        """Return the text of the term, with a number for each value that comes in later."""
        lines = [f"def made({', '.join(names)}):", f"    return {result}"]
        make = codegen.function(lines, self.names, "a term with marks")
        return to_text(make(*(_MARK + at for at in range(len(names)))))

    def kept(self, text: Term) -> object:
        return to_text(text)
