"""Message bytes to the text of their event terms, without making the terms where their form allows it."""

import re
from typing import Any, Callable, Dict, List

from ..syntax import float_text, to_text
from ..terms import Term
from ._compile import compile_function
from ._frame_code import FrameCode, Unsuited
from .decoding import Decoder

_MARK = 10**40
_PLACE = re.compile(r"1(0{30}\d{10})(?=[,\])])")
_CODE = re.compile(r"\d*[a-zA-Z?]")


def text_writer(decoder: Decoder) -> Callable[[bytes], str]:
    """Return the function from the bytes of a message to the text of its event term.

    Messages that are numbers, then texts, then numbers are written by the text of their type with the values
    put in; of others the term is made and written. The function raises `MessageError` as the decoder does.
    """

    def general(data: bytes) -> str:
        return to_text(decoder.decode(data))

    code = _TextCode()
    try:
        lines = code.build(decoder.definition, general)
    except Unsuited:
        return general
    made: Callable[[bytes], str] = compile_function(
        "decode", f"text of {decoder.definition.name}", lines, code.names
    )
    return made


class _TextCode(FrameCode):
    """Source of a function that gives the message's text, not its term."""

    def finish(self, result: str) -> str:
        """Return an f-string: the text of the term with marks for values, each mark replaced by its value."""
        places = {name: f"{{{name}}}" for name in self.texts}
        for names, layout in ((self.before[1], self.before[0]), (self.targets, self.format)):
            for name, kind in zip(names, _CODE.findall(layout)):
                if kind[-1] in "s?c":  # not the value itself stands in the term
                    raise Unsuited
                places[name] = f"{{real({name})}}" if kind in "fd" else f"{{{name}}}"
        self.names["real"] = float_text
        return _f_string(self._template(result, list(places)), list(places.values()))

    def _template(self, result: str, names: List[str]) -> str:
        """Return the text of the term, with a number for each value that comes in later."""
        marks: Dict[str, Any] = {name: _MARK + at for at, name in enumerate(names)}
        return to_text(eval(result, dict(self.names), marks))

    def kept(self, text: Term) -> Any:
        return to_text(text)


def _f_string(template: str, values: List[str]) -> str:
    pieces = _PLACE.split(template)
    pieces[::2] = [
        text.replace("\\", "\\\\").replace('"', '\\"').replace("{", "{{").replace("}", "}}")
        for text in pieces[::2]
    ]
    pieces[1::2] = [values[int(place)] for place in pieces[1::2]]
    return 'f"' + "".join(pieces) + '"'
