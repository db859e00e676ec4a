"""Names with unusual characters, in all places that accept a name.

A name is returned unchanged or refused with a documented error. It has a mark, which must not occur in generated
source.
"""

import json
import re
from typing import Any, List

from asserting_accessors import compound

from retalis import Definitions, atom, functor, to_python
from retalis.messages.message_to_event_text import make_text_writer
from retalis.messages.type_definition import functor_name
from retalis.messages.type_registry import InstalledTypes
from retalis.prolog.syntax.event_text import EventReader
from retalis.prolog.syntax.event_text import to_text as text_of
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.syntax.term_writer import writeq

from ..mutate import random_tokens, to_bytes, to_text
from ..side_effects import FindingError
from .base import LOGGED, Kind, create_silent_engine

WORDS = r"""
' " \ { } %s %(x)s {0} {x!r} ''' # ; : ( ) __import__('os').system('true') ../ /etc/passwd ~/ $(true) `true` é ٣ ﬁ K
None def lambda class self term data _ __0__ __class__ 0 1e9 / - + = . .. * [ ] \u0027 \x27 | ! [] {} , < & ~private
/abs x.y 0'a /* %
"""
OTHERS = (
    '"""',
    " ",
    "\n",
    "\0",
    "\r",
    "\t",
    "\u2028",
    "\ud800",
    "\U0001f600",
    "');import os#",
    "\\N{DEGREE SIGN}",
)
PIECES = (*WORDS.split(), *OTHERS, "a" * 300)
MARK = "zq"
GOALS_OF_FILES = """
consult({}) ensure_loaded({}) include({}) [{}] exists_file({}) consult(foo/{}) compile_event_file({})
compile_events({}) execute_event_stream_file({}) open({},write,_) see({}) tell({})
set_etalis_flag(output_temporary_files,{}) read_term({},X,[]) shell({})
"""


class Inputs(Kind):
    """An input is a JSON object: the place, the name, and its mark."""

    block_size = 50

    def setup(self) -> None:
        self.installed = InstalledTypes()
        self.installed.text("no_such_package/Type")
        self.places = sorted(name[3:] for name in dir(self) if name.startswith("in_"))
        for number, data in enumerate(self.corpus):
            if not data.startswith(b"{"):
                self.corpus[number] = self._input(
                    self.places[number % len(self.places)], to_text(data), number
                )

    def reset(self) -> None:
        self.known = Definitions(self.installed)
        self.engine = create_silent_engine()
        self.outputs: List[Any] = []
        self.engine.on_output(lambda term, topic, name: self.outputs.append((term, topic, name)))
        self.reader = EventReader()

    def generate(self, rng: Any) -> Any:
        draw = rng.random()
        if draw < 0.3:
            name = random_tokens(rng, PIECES, 2)
        elif draw < 0.6:
            name = "a" + random_tokens(rng, PIECES, 3)
        else:
            name = random_tokens(rng, PIECES, 6)
        return self._input(rng.choice(self.places), name, rng.randrange(10**9))

    def _input(self, place: Any, name: Any, number: Any) -> Any:
        mark = f"{MARK}{number}"
        position = number % (len(name) + 1)
        return to_bytes(
            json.dumps({"place": place, "name": name[:position] + mark + name[position:], "mark": mark})
        )

    def marker_of(self, data: Any) -> Any:
        match = re.search(rb'"mark": "(zq\d+)"', data)
        return match[1].decode() if match else ""

    def run(self, data: Any) -> None:
        try:
            record = json.loads(to_text(data))
            work, name = getattr(self, f"in_{record['place']}"), str(record["name"])
        except (ValueError, KeyError, TypeError, AttributeError):  # an input that was shortened too far
            return
        self.attempt(work, name)
        LOGGED.check()

    def check_equal(self, result: Any, name: Any) -> None:
        if result != name:
            raise FindingError("difference", f"{name!r} came back as {result!r}", "names")

    # ---- messages ------------------------------------------------------------------------------------

    def _use(self, definition: Any) -> Any:
        decoder, encoder = self.known.decoder(definition), self.known.encoder(definition)
        term = decoder.decode(bytes(4))
        text = make_text_writer(decoder)(bytes(4))
        self.check_equal(text, text_of(term))
        self.check_equal(encoder.encode(self.reader.read(text)), bytes(4))
        self.attempt(decoder.decode, b"")
        self.attempt(encoder.encode, atom("x"), "/t")
        return term

    def in_type(self, name: Any) -> None:
        term = self._use(self.known.add(f"pkg/{name}", "int32 x"))
        self.check_equal(term[0].name, functor_name(f"pkg/{name}"))

    def in_package(self, name: Any) -> None:
        term = self._use(self.known.add(f"{name}/Type", "int32 x"))
        self.check_equal(term[0].name, functor_name(f"{name}/Type"))

    def in_field(self, name: Any) -> None:
        definition = self.known.add("pkg/Type", f"int32 {name}")
        self._use(definition)
        if definition.fields[0].name not in name:
            raise FindingError("difference", f"{name!r} became {definition.fields[0].name!r}", "names")

    def in_constant(self, name: Any) -> None:
        self._use(self.known.add("pkg/Type", f"int32 x\nint32 {name}=1"))

    def in_constant_text(self, name: Any) -> None:
        definition = self.known.add("pkg/Type", f"int32 x\nstring X={name}")
        self._use(definition)

    def in_nested_type(self, name: Any) -> None:
        nested = f"{'=' * 80}\nMSG: pkg/{name}\nint32 y"
        definition = self.known.add("pkg/Type", f"{name} x\n{nested}")
        self._use(definition)

    def in_message_text(self, name: Any) -> None:
        definition = self.known.find("std_msgs/String")
        raw = name.encode("utf-8", "surrogatepass")
        data = len(raw).to_bytes(4, "little") + raw
        decoder = self.known.decoder(definition)
        text = make_text_writer(decoder)(data)
        term = self.reader.read(text)
        self.check_equal(text_of(term), text_of(decoder.decode(data)))
        self.check_equal(self.known.encoder(definition).encode(decoder.decode(data)), data)
        self.engine.post(decoder.decode(data))

    # ---- logic ---------------------------------------------------------------------------------------

    def in_atom(self, name: Any) -> None:
        text = writeq(atom(name), self.engine.operators)
        solutions = self.engine.query(f"X = {text}")
        self.check_equal(solutions[0]["X"], atom(name))
        self.check_equal(compound(self.reader.read(text_of((functor("f", 1), atom(name)))))[1], atom(name))

    def in_functor(self, name: Any) -> None:
        text = writeq((functor(name, 1), 1), self.engine.operators)
        self.engine.load(rules=f"{text} :- true.\ncalls(X) :- {text}, X = 1.")
        self.check_equal(len(self.engine.query(text)), 1)
        self.check_equal(self.engine.query("calls(X)")[0]["X"], 1)
        self.engine.query(f"retractall({text})")

    def in_event(self, name: Any) -> None:
        text = writeq((functor(name, 1), 1), self.engine.operators)
        quoted = writeq(atom(name), self.engine.operators)
        self.engine.load(rules=f"{quoted}(X) <- fuzz_a(X) seq fuzz_b({quoted}) where X > 0.")
        self.engine.load(goals=f"subscribe({quoted}(_), [], _, t, fuzz)")
        try:
            self.engine.event("fuzz_a(1)", 1)
            self.engine.event(f"fuzz_b({quoted})", 2)
            self.engine.post_text(
                f"event({text},[datime(2014,10,19,19,50,5,1),datime(2014,10,19,19,50,5,1)])"
            )
        finally:
            self.engine.call("delete_subscription(t, fuzz)")
        self.outputs.clear()

    def in_variable(self, name: Any) -> None:
        read = read_term(f"f(_{name})", self.engine.operators)
        for variable in read.names:
            if variable not in f"_{name}":
                raise FindingError("difference", f"{name!r} became {variable!r}", "names")
        self.engine.query(f"V{name} = 1, X = V{name}")
        self.engine.load(rules=f"v{MARK}(V{name}) <- a(V{name}) where V{name} > 1.")

    def in_string(self, name: Any) -> None:
        text = writeq(atom(name), self.engine.operators)
        solutions = self.engine.query(f'atom_string({text}, S), atom_length(S, N), string_concat(S, "", S)')
        self.check_equal(to_python(solutions[0]["S"]), name)
        self.engine.load(rules=f"s({text}) <- a(X) where X = {text}.")
        self.engine.event(f"a({text})", 1)

    def in_operator(self, name: Any) -> None:
        quoted = writeq(atom(name), self.engine.operators)
        self.engine.call(f"op(700, xfx, {quoted})")
        try:
            term = (functor(name, 2), 1, atom(name))
            self.check_equal(
                writeq(
                    read_term(
                        writeq(term, self.engine.operators),
                        self.engine.operators,
                    ).term
                ),
                writeq(term),
            )
        finally:
            self.engine.call(f"op(0, xfx, {quoted})")

    def in_flag(self, name: Any) -> None:
        quoted = writeq(atom(name), self.engine.operators)
        self.attempt(self.engine.call, f"set_prolog_flag({quoted}, {quoted})")
        self.attempt(self.engine.call, f"set_etalis_flag({quoted}, {quoted})")
        self.attempt(self.engine.call, f"create_prolog_flag({quoted}, {quoted}, [])")
        self.attempt(self.engine.call, f"current_prolog_flag({quoted}, X)")
        self.attempt(self.engine.call, f"b_setval({quoted}, 1), b_getval({quoted}, X), X == 1")

    # ---- programs ------------------------------------------------------------------------------------

    def in_label(self, name: Any) -> None:
        quoted = writeq(atom(name), self.engine.operators)
        self.engine.load(rules=f"{quoted} : l{MARK}(X) <- a(X) seq b(X).")
        self.engine.event("a(1)", 1)
        self.engine.call(f"del_event_rule({quoted})")

    def in_topic(self, name: Any) -> None:
        quoted = writeq(atom(name), self.engine.operators)
        self.engine.load(goals=f"subscribe(e(_), [], _, {quoted}, id)")
        self.engine.event("e(1)", 1)
        if not self.outputs:
            raise FindingError("difference", f"{name!r} gets no output", "names")
        self.check_equal(self.outputs.pop()[1], name)
        self.engine.call(f"delete_subscription({quoted}, id)")

    def in_subscription(self, name: Any) -> None:
        quoted = writeq(atom(name), self.engine.operators)
        self.engine.load(goals=f"subscribe(e(_), [], _, topic, {quoted})")
        self.engine.event("e(1)", 1)
        self.check_equal(self.outputs.pop()[2], atom(name))
        self.engine.call(f"delete_subscription(topic, {quoted})")

    def in_memory(self, name: Any) -> None:
        quoted = writeq(atom(name), self.engine.operators)
        self.engine.load(goals=f"memorize(m(X), [], X, {quoted}, 3)")
        self.engine.event("m(1)", 1)
        self.engine.call(f"delete_memory({quoted})")

    def in_node(self, name: Any) -> None:
        header = {"callerid": name, "type": "pkg/Type", "md5sum": "*", "message_definition": "int32 x"}
        definition = self.known.received(
            "pkg/Type", header["type"], header["message_definition"], header["md5sum"]
        )
        self._use(definition)

    def in_module(self, name: Any) -> None:
        quoted = writeq(atom(name), self.engine.operators)
        for goal in (
            "use_module({})",
            "use_module(library({}))",
            "use_foreign({})",
            "use_swi({0}, [{0}/1])",
            "module({0}, [{0}/1])",
            "{}:true",
        ):
            self.attempt(self.engine.call, goal.format(quoted))
        self.attempt(self.engine.load_rules, f":- module({quoted}, [foo/1]).\nfoo(1).")

    def in_file(self, name: Any) -> None:
        quoted = writeq(atom(name), self.engine.operators)
        for goal in GOALS_OF_FILES.split():
            self.attempt(self.engine.call, goal.format(quoted))
