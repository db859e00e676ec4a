"""Text streams: reading and writing files, and terminal input."""

from typing import Any, List, Tuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from prolog.goal_answers import answers, first, prolog
from recorded_calls import recording

from retalis import Operators, String, SyntaxFault, atom
from retalis.prolog.builtins import text_streams
from retalis.prolog.builtins.text_streams import MAX_OPEN_STREAMS, InputStream, streams_of
from retalis.prolog.machine.errors import existence_error, permission_error
from retalis.prolog.syntax.term_reader import read_program
from retalis.prolog.syntax.term_writer import write_term
from retalis.prolog.syntax.tokenizer import ReadFlags
from retalis.prolog.terms.term_traversal import variant_key


class FileStore:
    """Files in a dictionary; those whose names begin with ``no`` are not allowed."""

    def __init__(self, **files: Any) -> None:
        self.files = files

    def to_read(self, name: Any, encoding: str = "utf-8") -> Tuple[Any, ...]:
        name = atom(name.text) if isinstance(name, String) else name
        self._require(name)
        if name.name not in self.files:
            raise existence_error("source_sink", name)
        text = self.files[name.name]
        return name.name, text if encoding == "utf-8" else text.encode().decode(encoding)

    def to_write(self, name: Any, more: Any) -> Any:
        self._require(name)
        if not more or name.name not in self.files:
            self.files[name.name] = ""
        return name.name

    def add(self, path: Any, text: Any, encoding: str = "utf-8") -> None:
        self.files[path] += text.encode(encoding).decode()

    @staticmethod
    def _require(name: Any) -> None:
        if name.name.startswith("no"):
            raise permission_error("open", "source_sink", name)


@pytest.fixture
def written() -> List[str]:
    """Return the texts that are written to ``user_output``."""
    return []


@pytest.fixture
def logic(written: List[str]) -> Any:
    system: Any = prolog(
        "... --> [] | [_], ... . "
        "copy(S) :- get_char(S,C), (C = end_of_file -> true ; open(out, append, O), write(O, C), close(O), copy(S))."
    )
    system.output = written.append
    system.files = FileStore(
        terms="a(1). b(X, Y, X).\nfoo bar. c.\nrest\nlast line",
        empty="",
        facts="p(1).\np(2).\n",
        accents="\u00e9",
    )
    return system


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ("open(terms, read, S), read(S, T), close(S)", "a(1)"),
        (
            "open(terms, read, S), read(S, _), read_term(S, T, [variable_names(['X' = 7, 'Y' = y])])",
            "b(7,y,7)",
        ),
        (
            "open(terms, read, S), read(S, _), read(S, _), catch(read(S, _), error(E, _), true), read(S, T)",
            "c",
        ),
        ("open(empty, read, S), read(S, T)", "end_of_file"),
        ("read_file_to_terms(facts, T, [])", "[p(1),p(2)]"),
        ("read_file_to_string(facts, T, [])", '"p(1).\\np(2).\\n"'),
        ("read_file_to_codes(empty, T, [])", "[]"),
        ("open(facts, read, S), read_line_to_string(S, T), close(S)", '"p(1)."'),
        ("open(facts, read, S), read_line_to_codes(S, L, []), atom_codes(T, L)", "'p(1).\\n'"),
        ("open(empty, read, S), get_char(S, T), at_end_of_stream(S)", "end_of_file"),
        ("open(empty, read, S), peek_code(S, T)", "-1"),
        ("open(empty, read, S), read_line_to_string(S, T)", "end_of_file"),
        ("open(empty, read, S), read_line_to_codes(S, T)", "end_of_file"),
        ("open(facts, read, S), read_string(S, 3, T)", '"p(1"'),
        ("open(facts, read, S), read_string(S, T, _)", "12"),
        ('open(facts, read, S), read_string(S, "\\n", ".p", 10, T)', '"(1)"'),
        ('open(empty, read, S), read_string(S, "\\n", "", T, "")', "-1"),
        ("open(facts, read, S), get_char(S, _), peek_string(S, 2, T), get_char(S, '(')", '"(1"'),
        ("phrase_from_file(([0'p,T], ...), facts)", "40"),
        ("open(facts, read, S), read(S, _), phrase_from_stream(([10,T], ...), S)", "112"),
        ("open(terms, read, S), get_char(S, _), peek_char(S, T), get_char(S, T)", "'('"),
        (
            "open(facts, read, S), read(S, _), read_line_to_codes(S, []), read_line_to_codes(S, T)",
            "[112,40,50,41,46]",
        ),
        ("open(facts, read, S), read(S, _), get_char(S, _), line_count(S, T)", "2"),
        ("see(facts), read(p(T)), seen, read(end_of_file)", "1"),
        ("see(facts), read(_), seeing(S), see(user), read(end_of_file), see(facts), read(p(T)), seen", "2"),
        ("open(facts, read, S, [alias(in)]), read(in, p(T)), close(in)", "1"),
        (
            "open(facts, read, S), set_input(S), read(p(T)), current_input(S), close(S), current_input(user_input)",
            "1",
        ),
        ("open(facts, read, S), stream_property(S, file_name(T))", "facts"),
        ("open(facts, read, S, [alias(x)]), stream_property(S, alias(T))", "x"),
        ("open(facts, read, S), stream_property(S, position(T))", "'$stream_position'(0,1,0,0)"),
        (
            "open(facts, read, S), read(S, _), get_char(S, _), get_char(S, _), stream_property(S, position(T))",
            "'$stream_position'(7,2,1,7)",
        ),
        (
            "open(facts, read, S), read(S, _), stream_property(S, position(P)), read(S, _), "
            "set_stream_position(S, P), read(S, T)",
            "p(2)",
        ),
        ("open(facts, read, S), stream_property(S, end_of_stream(T))", "not"),
        ("open(empty, read, S), stream_property(S, end_of_stream(T))", "at"),
        ("open(empty, read, S), get_char(S, _), stream_property(S, end_of_stream(T))", "past"),
        ("open(empty, read, S, [eof_action(reset)]), stream_property(S, eof_action(T))", "reset"),
        ("open(accents, read, S, [type(binary)]), get_byte(S, _), peek_byte(S, T)", "169"),
        ("open(accents, read, S, [encoding(octet)]), get_char(S, _), peek_code(S, T)", "169"),
        ("open(accents, read, S, [type(binary)]), stream_property(S, type(T))", "binary"),
        ("findall(A, stream_property(_, alias(A)), T)", "[user_input,user_output,user_error]"),
        (
            "findall(A, (open(facts, read, _, [alias(p)]), stream_property(_, alias(A)), A == p, "
            "open(empty, read, _, [alias(q)]), fail), T)",
            "[]",
        ),
        ("stream_property(user_input, eof_action(T))", "reset"),
        ("stream_property(user_output, mode(T))", "append"),
        ("open(facts, read, S), read(S, _), character_count(S, T)", "5"),
        ("open(facts, read, S), read(S, _), line_position(S, T)", "5"),
        ("open(out, write, S), write(S, abc), line_position(S, T)", "3"),
        ("write(abc), line_position(user_output, T)", "3"),
        ("line_position(user_input, T)", "0"),
        ("see(facts), skip(0'(), get0(C), get(_), skip('\\n'), get(T), seen", "112"),
        ("open(facts, read, S), skip(S, x), get_char(S, T)", "end_of_file"),
        ("open(facts, read, S), findall(X, (repeat, read(S, X), X == end_of_file, !), [T])", "end_of_file"),
    ],
)
def test_input_stream_has_value(logic: Any, goal: str, expected: str) -> None:
    (answer,) = answers(logic, goal, 1)
    assert answer["T"] == expected


@pytest.mark.parametrize(
    ("goal", "text"),
    [
        ("open(out, write, S), write(S, a), nl(S), close(S)", "a\n"),
        ("open(out, write, S), format(S, '~w-~q~n', [x, 'Y']), close(S)", "x-'Y'\n"),
        ("open(out, write, S), writeq(S, 'A b'), put_char(S, '.'), close(S)", "'A b'."),
        (
            "open(facts, append, S), write(S, more), close(S), open(facts, read, R), copy(R)",
            "p(1).\np(2).\nmore",
        ),
        ("tell(out), write(a), print(b), told, write(c)", "ab"),
        ("tell(out), write(a), tell(user), write(b), tell(out), write(c), told", "ac"),
        ("append(facts), write(x), told, open(facts, read, R), copy(R)", "p(1).\np(2).\nx"),
        ("open(out, write, S), with_output_to(string(_), write(a)), write(S, b), close(S)", "b"),
        ("with_output_to(string(_), (write(a), tell(out), write(b), told, write(c)))", "b"),
        ("open(out, write, S), set_output(S), write(a), write(user_output, u), close(S), write(b)", "a"),
        ("open(out, write, S), write(S, a), flush_output(S)", "a"),
        ("open(facts, read, R), open(out, write, S), copy_stream_data(R, S, 4), close(S)", "p(1)"),
        ("open(facts, read, R), open(out, write, S), copy_stream_data(R, S), close(S)", "p(1).\np(2).\n"),
        ("open(out, write, S), put_code(S, 0'a), set_output(S), put_code(0'b), close(S)", "ab"),
        (
            "open(out, write, S, [type(binary)]), put_byte(S, 195), set_output(S), put_byte(169), close(S)",
            "\u00e9",
        ),
        ("open(out, write, S), portray_clause(S, f(X)), print_message_lines(S, '', []), close(S)", "f(_).\n"),
    ],
)
def test_output_stream_writes_text(logic: Any, goal: str, text: str) -> None:
    assert answers(logic, goal)
    assert logic.files.files["out"] == text


def test_user_output_is_not_redirected(logic: Any, written: List[str]) -> None:
    answers(logic, "tell(out), write(a), write(user_output, u), told, write(b)")
    assert "".join(written) == "ub"


def test_line_is_written_at_its_end(logic: Any) -> None:
    answers(logic, "open(out, write, S, [alias(out)]), write(S, one), nl(S), write(S, two)")
    assert logic.files.files["out"] == "one\n"
    answers(logic, "close(out)")
    assert logic.files.files["out"] == "one\ntwo"


def test_streams_have_separate_columns(logic: Any, written: List[str]) -> None:
    answers(logic, "write(abc), tell(out), format('x~t~5|y~n'), told, format('~t~5|y')")
    assert logic.files.files["out"] == "x    y\n"
    assert "".join(written) == "abc  y"


@pytest.mark.parametrize(
    ("goal", "error"),
    [
        ("open(_, read, _)", "instantiation_error"),
        ("open(f, _, _)", "instantiation_error"),
        ("open(f, 1, _)", "type_error(atom,1)"),
        ("open(f, up, _)", "domain_error(io_mode,up)"),
        ("open(f, read, s)", "uninstantiation_error(s)"),
        ("open(f, read, _, [type(pictures)])", "domain_error(stream_option,type(pictures))"),
        ("open(f, read, _, [eof_action(sing)])", "domain_error(stream_option,eof_action(sing))"),
        ("close(user_input, [softly(true)])", "domain_error(close_option,softly(true))"),
        ("get_byte(_)", "permission_error(input,text_stream,user_input)"),
        ("get_byte(user_input, 256)", "type_error(in_byte,256)"),
        ("get_char(1)", "type_error(character,1)"),
        ("peek_code(x)", "type_error(integer,x)"),
        ("get_code(-2)", "representation_error(character_code)"),
        ("put_code(-1)", "representation_error(character_code)"),
        ("put_byte(97)", "permission_error(output,text_stream,current_output)"),
        ("put_byte(user_output, 97)", "permission_error(output,text_stream,user_output)"),
        ("put_byte(user_output, 256)", "type_error(byte,256)"),
        ("put_byte(user_output, _)", "instantiation_error"),
        ("current_input(a)", "existence_error(stream,a)"),
        ("current_output(1)", "domain_error(stream_or_alias,1)"),
        ("stream_property(1, _)", "domain_error(stream,1)"),
        ("stream_property(a, _)", "domain_error(stream,a)"),
        ("stream_property(_, colour(_))", "domain_error(stream_property,colour(A))"),
        ("stream_property(_, 7)", "domain_error(stream_property,7)"),
        ("set_stream_position(user_input, _)", "instantiation_error"),
        ("set_stream_position(user_input, a)", "domain_error(stream_position,a)"),
        (
            "open(out, write, S), set_stream_position(S, '$stream_position'(0,1,0,0))",
            "permission_error(reposition,stream,'$stream'(1))",
        ),
        (
            "open(empty, read, S, [eof_action(error)]), get_char(S, _), peek_char(S, _)",
            "permission_error(input,past_end_of_stream,'$stream'(1))",
        ),
        (
            "open(empty, read, S, [eof_action(error)]), read(S, _), read(S, _)",
            "permission_error(input,past_end_of_stream,'$stream'(1))",
        ),
        ("open(none, read, _)", "permission_error(open,source_sink,none)"),
        ("open(missing, read, _)", "existence_error(source_sink,missing)"),
        ('open("missing", read, _)', 'existence_error(source_sink,"missing")'),
        ("open(facts, read, _, [alias(user_input)])", "permission_error(open,source_sink,alias(user_input))"),
        ("see(none)", "permission_error(open,source_sink,none)"),
        ("tell(none)", "permission_error(open,source_sink,none)"),
        ("close(_)", "instantiation_error"),
        ("close(x)", "existence_error(stream,x)"),
        ("close(1)", "domain_error(stream_or_alias,1)"),
        ("read('$stream'(77), _)", "existence_error(stream,'$stream'(77))"),
        ("write('$stream'(77), x)", "existence_error(stream,'$stream'(77))"),
        ("read(user_output, _)", "permission_error(input,stream,user_output)"),
        ("write(user_input, x)", "permission_error(output,stream,user_input)"),
        ("set_output(user_input)", "permission_error(output,stream,user_input)"),
        ("open(facts, read, S), write(S, x)", "permission_error(output,stream,'$stream'(1))"),
        ("open(out, write, S), read(S, _)", "permission_error(input,stream,'$stream'(1))"),
        ("open(facts, read, S), close(S), read(S, _)", "existence_error(stream,'$stream'(1))"),
    ],
)
def test_invalid_stream_operation_is_an_error(logic: Any, goal: str, error: str) -> None:
    assert answers(logic, goal) == [error]


def test_number_of_open_streams_is_limited(logic: Any) -> None:
    goal = "forall(between(1, {}, _), open(facts, read, _))"
    assert answers(logic, goal.format(MAX_OPEN_STREAMS)) == [{}]
    assert answers(logic, goal.format(1)) == ["resource_error(streams)"]


def test_terminal_input_is_read_until_term_ends(logic: Any) -> None:
    lines = iter(["\n", "point(1,\n", "  2). % so\n", "next. 'it''s'\n", ".\n", "wrong wrong.\n", "x"])
    logic.ask = lambda: next(lines, None)
    assert first(logic, "read(X)") == "point(1,2)"
    assert first(logic, "read(X)") == "next"
    assert first(logic, "read(X)") == "'it\\'s'"
    (error,) = answers(logic, "read(X)")
    assert error.startswith("syntax_error")
    assert first(logic, "get_char(_), get_char(X)") == "x"
    assert first(logic, "read(X)") == "end_of_file"


def test_text_of_many_terms_is_parsed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    reads: List[Any] = []
    monkeypatch.setattr(text_streams, "read_program", recording(reads, read_program))
    stream = InputStream("many", "p(1).\n" * 2000)
    operators, read = Operators.prolog(), 0
    while stream.read_term(operators, ReadFlags()) is not None:
        read += 1
    assert (read, len(reads)) == (2000, 1)


TERMS = st.sampled_from(
    ["a", "f(X, 'b c')", "[1, 2]", '"text"', "- 1", "a :- b, c", "'it''s'", "0'a", "{x}", "% no\nq"]
)


@settings(max_examples=60)
@given(
    st.lists(st.tuples(TERMS, st.sampled_from([".\n", ". ", ".\n\n% c\n", " .\n"])), max_size=8), st.data()
)
def test_reading_by_characters_advances_to_same_offset(parts: List[Any], data: st.DataObject) -> None:
    text = "".join(term + end for term, end in parts)
    whole, mixed = InputStream("whole", text), InputStream("mixed", text)
    operators, flags = Operators.prolog(), ReadFlags()

    def text_of(entry: Any) -> Any:
        assert not isinstance(entry, SyntaxFault)
        return None if entry is None else variant_key(entry.term)

    for term, _ in parts:
        entry = text_of(whole.read_term(operators, flags))
        assert entry is not None
        if data.draw(st.booleans()):  # to the end of the term by characters
            while mixed.offset < whole.offset:
                assert mixed.read_character(True) == text[mixed.offset - 1]
        else:
            assert text_of(mixed.read_term(operators, flags)) == entry
        assert mixed.offset == whole.offset, term
    assert whole.read_term(operators, flags) is None
    assert mixed.read_character(False) == text[mixed.offset : mixed.offset + 1]


def test_streams_are_separate_per_program(logic: Any) -> None:
    answers(logic, "open(facts, read, _)")
    assert len(streams_of(logic.machine).open_streams) == 1
    assert not streams_of(prolog().machine).open_streams


@given(st.text("ab\n", max_size=30), st.lists(st.integers(0, 30), max_size=12))
def test_position_has_line_and_column(text: str, places: List[Any]) -> None:
    stream = InputStream("any", text)
    for place in places:
        if not stream.set_position(place):
            assert place > len(text)
            continue
        before = text[:place]
        assert stream.position == (place, before.count("\n"), len(before.rpartition("\n")[2]))
        assert stream.line == before.count("\n") + 1


def test_lines_of_long_text_are_counted_once() -> None:
    class Text(str):
        looked = 0

        def count(self, pattern: str, *limits: Any) -> int:
            first, last = limits
            Text.looked += last - first
            return super().count(pattern, first, last)

    stream = InputStream("long", Text("p(1).\n" * 1000))
    for offset in range(0, 6000, 6):
        stream.offset = offset
        assert stream.line == offset // 6 + 1
    assert 0 < Text.looked <= 6000


@pytest.mark.parametrize(
    ("goal", "captured", "written"),
    [
        ("writeln(user, x)", "", "x\n"),
        ("(writeln(user_output, x), write(y))", "y", "x\n"),
        ('(write(a), nl(user), put_char(user, b), format(user, "~w", [c]), tab(user, 1))', "a", "\nbc "),
        ("(with_output_to(string(_), (write(user, x), write(y))), write(z))", "z", "x"),
        ("(current_output(S), with_output_to(string(_), (write(S, x), write(y))))", "x", ""),
        ("(current_output(S), write(S, x), S \\== user_output)", "x", ""),
        ("(current_output(S), set_output(S), write(x), line_position(S, 1))", "x", ""),
        ("(current_output(S), tell(out), write(b), set_output(S), write(c))", "c", ""),
        ("(tell(out), write(b), write(user, u))", "", "u"),
        ("(current_output(S), stream_property(S, mode(M)), write(M), close(S))", "append", ""),
    ],
)
def test_user_output_is_not_captured(goal: str, captured: str, written: str) -> None:
    """Output to the user by name is not captured, as in SWI-Prolog; a capture has a stream of its own."""
    logic: Any = prolog()
    folder = FileStore(out="")
    logic.files = folder
    texts: List[Any] = []
    logic.output = texts.append
    assert first(logic, f"with_output_to(string(Text), {goal}), Caught = Text, \\+ Text = 1") is not None
    assert answers(logic, f"with_output_to(atom(Text), {goal})")[0]["Text"] == f"{write_term(atom(captured))}"
    assert "".join(texts) == 2 * written
    assert answers(logic, "write(after)") == [{}]
    assert texts[-1] == "after"


@pytest.mark.parametrize(
    ("goal", "text"),
    [
        ("(with_output_to(string(_), write(S, abc)), format('~t~w~6|', [x]))", "abc  x"),
        ("(with_output_to(string(_), (write(q), write(S, cd), line_position(S, P))), write(P))", "cd2"),
        ("(tell(out), write(q), write(S, ab), line_position(S, P), told, write(P))", "ab2"),
        ("(with_output_to(string(_), (tell(out), write(S, ab), told)), format('~t~w~4|', [x]))", "ab x"),
        ("(write(ab), line_position(user_output, P), write(P))", "ab0"),
    ],
)
def test_capture_keeps_its_column(goal: str, text: str) -> None:
    logic: Any = prolog()
    logic.files = FileStore(out="")
    answer = first(logic, f"with_output_to(string(Text), (current_output(S), {goal}))")
    assert answer["Text"] == f'"{text}"'


def test_ended_capture_is_no_stream() -> None:
    logic = prolog()
    assert answers(logic, "with_output_to(string(_), current_output(S)), catch(nl(S), error(E, _), true)")[0][
        "E"
    ].startswith("existence_error(stream,")
    assert first(logic, "with_output_to(string(T), format('~w~t~4|~w', [a, b]))") == '"a   b"'
