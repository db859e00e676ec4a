"""Regular expressions of the package with their worst cases: none takes more than linear time.

A new pattern requires an entry here. Write patterns so that each text has only one match (alternatives, and the
expression after a repetition, begin with different characters), and describe the worst case. Each pattern is run over
texts of 100,000 characters that have a matching beginning, repeat a matching part, and end without a match: a pattern
that starts again at each character would take minutes of processor time.
"""

import ast
import importlib
import re
import signal
from contextlib import contextmanager
from functools import lru_cache
from itertools import product
from typing import Any, Dict, Iterator, List, NamedTuple, Set, Tuple

import pytest
from parsed_sources import FILES

from retalis.prolog.syntax import tokenizer

SIZE = 100_000
MAX_CPU_SECONDS = 20.0
"""Processor time for all texts of a pattern; the slowest pattern takes a tenth of a second."""


class Case(NamedTuple):
    """Method of a pattern, its worst case, and parts of texts: first, repeated and last parts."""

    method: str
    worst: str
    first: Tuple[str, ...]
    repeated: Tuple[str, ...]
    last: Tuple[str, ...] = ("", "!", "\n", "\0")


ESCAPES = (
    "\\",
    "\\\\",
    "\\1e",
    "\\x41",
    "\\x41\\",
    "\\1\\",
    "\\c ",
    "\\c\n",
    "\\\n",
    "''",
    "'",
    "a",
    "a'",
    ". ",
    ".\t",
)
BLANKS = (" ", "\t", "\n", " \n")

CASES: Dict[str, Case] = {
    # testing/expected_names.py
    r"\w+": Case("findall", "one class: each character once", ("",), ("a", "a ", " ")),
    # prolog/syntax/parser_stack.py
    r"[/\w]+": Case("match", "one class: each character once", ("",), ("/", "a", "/a", " ", ".")),
    r"\w+\.[a-z]\w*": Case(
        "match",
        "a word, a full stop and a word: each character once",
        ("", "a", "a."),
        ("a", "a.", "1", ".a", " "),
    ),
    # cli/check_command.py
    r"`[^`]*`|\*\*([A-Z])\*\*": Case(
        "sub",
        "code that is not closed: it is read once, as its text has no other mark",
        ("", "`"),
        ("`", "**", "**A", "**A**", "`a`"),
    ),
    # editing/language_features.py
    r"\w+|[-+*/\\^<>=~:.?@#&$]+": Case(
        "finditer", "two classes: each character once", ("",), ("a", "+", "a+", " ")
    ),
    # editing/rule_verbalization.py
    r"\w+\{\w+\}\Z": Case(
        "match", "two classes with a bracket between", ("", "a{"), ("a", "a{", "{", "}"), ("}", "!")
    ),
    r"`[^`]*`|\b([A-Z][A-Za-z]*)( seconds)?\b": Case(
        "sub",
        "code that is not closed: it is read once, as its text has no other mark; a name is read from its start",
        ("", "`"),
        ("`", "A ", "A", "`a`", "A seconds", " seconds"),
    ),
    # editing/symbol_uses.py
    r"<!--[\s\S]*?(?:-->|\Z)|<(\w+)\b([^<>]*)>?": Case(
        "finditer",
        "a comment that is not closed extends to the end; an element ends at the next bracket",
        ("", "<!--", "<subscribe_to "),
        ("<!--", "--", "<subscribe_to ", "<publish_to", "a", " ", "<", "->"),
    ),
    r"""\b(\w+)\s*=\s*(?:"([^"]*)"|'([^']*)')""": Case(
        "finditer",
        "a value without its closing quote: the next quote of another kind begins no value",
        ("", 'name="', "name"),
        ("name=", "name ", "event='", 'name="', " ", "=", "a"),
    ),
    # editing/completion_context.py
    r"[\w.-]*": Case("match", "one class: each character once", ("",), ("a", ".", "a-", " ")),
    r"""\s+([\w.-]+)\s*=\s*(?:"[^"]*|'[^']*)""": Case(
        "match",
        "blanks before a name, or a name without its value: each is read once",
        ("", " ", " name", ' name="'),
        (" ", "a", "\n", " a", "=", "'", '"'),
    ),
    # events/checks/check_runner.py
    r"%\s*retalis:\s*ignore(-file)?=\s*(RT\d{4}(?:\s*,\s*RT\d{4})*)": Case(
        "findall",
        "blanks after a percent sign, or codes that end in a comma: each is read once",
        ("", "%", "% retalis: ignore=", "% retalis: ignore=RT1001"),
        ("%", " ", "% ", ", RT1001", ",", "RT1001, "),
    ),
    (
        "[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u061c\u180e\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"
        "\ufffe\uffff\ud800-\udfff\U000e0000-\U000e007f]|(?<![^\x00-\x7f])[\u200c\u200d]"
    ): Case("search", "each character once", ("",), ("\x1b", "a", "\u200d", "é\u200d", "a\u200d")),
    r"&(?=#?\w+;)": Case("search", "each character once", ("", "&"), ("&", "&#", "a", "&a", "a;")),
    r"event\(retalis_latched\('([0-9a-f]{32})','([0-9a-f]{32})',([01])\)\)": Case(
        "match",
        "each character once",
        ("event(retalis_latched('", "event(retalis_latched('" + 32 * "0" + "','"),
        ("0", "','", "'", ")"),
    ),
    r"(\0(?:,\0)*|'(?:[^\0'\"]*')*)": Case(
        "split",
        "each place once, and what stands between two quotes once more",
        ("", "\0", "'", "p("),
        ("\0", "\0,", "'", "'a", "''", "'a'", "'\0", "'\"", ","),
    ),
    r"(?:[^e]*\.[0-9]+e(?:-[0-9]{1,3}|\+?[0-9]{1,2})(?![0-9]))*[^e]*": Case(
        "fullmatch",
        "the digits before an exponent that is none once more",
        ("", "1.0e5", "."),
        ("1", "1.1", ".", "e", "1.0e-5,", "1.0e123", "1e5", "1.0e"),
    ),
    # visualization/timeline.py
    r"'(?:[^'\\]|\\.|'')*'|[^(]*": Case(
        "match", "a quote that is never closed: all once more", ("", "'"), ("a", "''", "\\'")
    ),
    # visualization/program_graph.py
    r"\b\w+?__0__": Case(
        "search", "one run of word characters: it begins at none inside", ("",), ("a", "_", "a ")
    ),
    # events/program/event_file_loader.py
    r"<-|'rule:'|'?\b(?:do|iff|IFF|event_rule_property|include)\b": Case(
        "search",
        "a word that begins as one of these",
        ("",),
        ("<", "'", "d", "do_", "'rule", "event_rule_propert "),
    ),
    r"[:?]-\s*(?:\(\s*)?([a-z]\w*)": Case(
        "search",
        "the blanks before and behind a bracket once more",
        ("", ":-", ":- ("),
        (" ", ":-", ":- ", ":- (", "(", "A", "a"),
    ),
    # prolog/syntax/event_text.py
    r"([(,\[|] *)"
    r"(-?(?:[0-9]{1,200}(?:\.[0-9]{1,200}(?:[eE](?:-[0-9]{1,3}|\+?[0-9]{1,2}))?)?|inf|nan))"
    r"(?=[,)\]|])": Case(
        "search",
        "at a number that is none: the blanks before it once more, and its 400 digits some times",
        ("", "(", ",", "(1.", ",-"),
        (" ", ", ", "1", ",1", ",1.5e-3", ",-", "0.0", ",inf", ",1e", "(" + "1" * 199),
    ),
    "['\"]": Case("search", "one look at each character", ("",), ("a", "'", '"')),
    r"(?:^|[(\[{,|])\s*(?:'|\"\")\s*(?=$|[)\]},|])": Case(
        "search",
        "at a quote that something else follows: the blanks before and behind it once more",
        ("", ",", ",'", ',""'),
        (*BLANKS, ",", ",'", ",''", ", ' ", ',""'),
    ),
    '[\0\']|""': Case("search", "one look at each character", ("",), ("\0", "'", '"', "a")),
    "\0([(,\\[|] *)\0": Case(
        "search", "the blanks behind a comma once more", ("", "\0,"), (" ", "\0", "\0,", "\0, ")
    ),
    # foundation/ros_name_checks.py
    r"([^/]+)/(?:msg|srv|action)/([^/]+)": Case(
        "match", "each part once", ("", "a/", "a/msg/"), ("a", "/", "a/msg/", "/msg", "msg")
    ),
    # prolog/terms/byte_texts.py
    "[\0-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]": Case(
        "search", "one look at each character", ("",), ("a", "\n", "ü")
    ),
    # messages/idl_definitions.py
    r"\w+|.": Case("match", "the word once", ("",), ("a", " ", "_", "\n")),
    # messages/ros2_definitions.py
    r"\s*(?P<type>[\w/]+)(?P<bound><=[0-9]+)?(?P<array>\[(?:<=)?[0-9]*\])?\s+"
    r"(?P<name>\w+)(?P<rest>(?:[\s=#].*)?)$": Case(
        "match",
        "each part once more: none of them begins with what may end the one before",
        ("", "a<=", "a[", "a[<=", "a ", "a a", "a a=", "int32<=1[1] x "),
        ("a", "1", " ", "a ", "/", "=", "#", "<=", "["),
    ),
    r"""\s*(?:"((?:[^"\\]|\\.)*)"|'((?:[^'\\]|\\.)*)')\s*(?:#.*)?$""": Case(
        "match",
        "a quote that is never closed: all once more",
        ("", '"', "'", '"a"'),
        ("a", "\\", '\\"', " ", "#", "'"),
    ),
    r"\\(.)": Case("search", "two characters", ("",), ("\\", "a", "\\\n")),
    r"^={20,}[ \t\r]*\n(MSG|SRV|ACTION|IDL):[ \t]*(\S*)": Case(
        "search",
        "a line of '=', blanks, and a name once more",
        ("", "=" * 20, "=" * 20 + "\nMSG:"),
        ("=", " ", "\n", "a", "=" * 20 + "\n", "MSG:"),
    ),
    # prolog/syntax/literals.py
    r"[^\W\d_]\w*\Z|[-+*/\\^<>=~:.?@#&$]+\Z|\[\]\Z|\{\}\Z|[!;]\Z": Case(
        "match",
        "a name with a blank at its end: its characters once more",
        ("", "a", "+"),
        ("a", "_", "1", "+", "[]", "!"),
    ),
    r"""[^ -&(-\[\]-~]|[\\'"`]""": Case(
        "search", "one look at each character", ("",), ("a", "'", "\\", "\n")
    ),
    r"""\\(?: x([0-9a-fA-F]+)\\?
          | ([0-7]+)\\?
          | u([0-9a-fA-F]{4}) | U([0-9a-fA-F]{8})
          | (\n)
          | (c)\s*
          | ([\s\S]?) )
      | (['"`])\8""": Case(
        "search", "an escape is read once", ("", "\\x", "\\1", "\\c", "\\u"), (*ESCAPES, "4", " ")
    ),
    r"\\(?:x[0-9a-fA-F]+\\?|[0-7]+\\?|c\s*|[\s\S])": Case(
        "match",
        "an escape is read once: whatever follows fits",
        ("", "\\x", "\\1", "\\c"),
        (*ESCAPES, "4", " "),
    ),
    r"[^'\\\n]*": Case("match", "one run", ("",), ESCAPES),
    r'[^"\\\n]*': Case("match", "one run", ("",), (*ESCAPES, '"', '""')),
    r"[^`\\\n]*": Case("match", "one run", ("",), (*ESCAPES, "`", "``")),
    r"[^\\\n]*": Case("match", "one run", ("",), ESCAPES),
    # _inputs.py
    r"datime\((\d{1,9}),(\d{1,9}),(\d{1,9}),(\d{1,9}),(\d{1,9}),(\d{1,9}),": Case(
        "match", "60 characters", ("", "datime(", "datime(1,1,1,1,1,"), ("1", "1,", ",")
    ),
    r"\d{1,9}\)": Case("match", "ten characters", ("",), ("1",)),
    # cli
    r"^\| \[(\w+)\]\((\w+/README\.md)\) \| (.+) \|$": Case(
        "finditer",
        "a row that does not end with a bar: each character of the line once, and back to the last bar",
        ("", "| [a](a/README.md) | ", "| [", "| [a]("),
        ("a", "| ", " |", "| [a](a/README.md) | ", "\n| ["),
    ),
    r"^\| ([^|\n]+) \| \[([^|\n]+)\]\(([^()|\n]+)\) \| `([^`|\n]+)` <!-- ([^|\n]+) --> \|$": Case(
        "finditer",
        "a row that does not end as it should: each character of a cell once, and back",
        ("", "| ", "| a | [", "| a | [a](", "| a | [a](a) | `", "| a | [a](a) | `a` <!-- "),
        ("a", "|", "| ", "](", "](a", "[", "`", "` <!-- ", " -->", "| a | [a](a) | `a` <!-- ", "\n| a"),
    ),
    r"\[([^\[\]]*)\]\([^()]*\)": Case(
        "search", "each character once more", ("", "[", "[]("), ("a", "[", "]", "(", "](", "[](")
    ),
    r"[\"`]|\b(?:inf|nan|True|False)\b": Case(
        "search", "five looks at each character", ("",), ("inf", "a", "Tru ", "nan_")
    ),
    r"[a-z]\w*\Z": Case(
        "match", "a name with a blank at its end: its characters once more", ("", "a"), ("a", "_")
    ),
    # stored_field_types.py
    r"<[\w.]+ object at 0x[0-9a-f]+>": Case(
        "sub", "one run after each <", ("", "<"), ("a", ".", "<a", "<a object at 0x1")
    ),
    # codegen.py, rosnames.py
    r"[A-Za-z_][A-Za-z0-9_]{0,30}\Z": Case("match", "31 characters", ("",), ("a", "_", "1")),
    r"[A-Za-z][A-Za-z0-9_]*": Case("match", "one run", ("", "a"), ("a", "_", "1")),
    r"[A-Za-z][A-Za-z0-9_]*/[A-Za-z][A-Za-z0-9_]*": Case(
        "match", "two runs", ("", "a/"), ("a", "1", "/", "a/")
    ),
    r"[a-z][a-z0-9_+]*": Case("findall", "one run", ("", "a"), ("a", "_", "1")),
    r"[A-Za-z/~][A-Za-z0-9_/]*": Case("match", "one run", ("", "~"), ("a", "/", "_")),
    r"[^A-Za-z0-9_/~]": Case("search", "one look at each character", ("",), ("a", "!")),
    r"""<\?xml[^>]{0,100}\sencoding\s*=\s*["']([A-Za-z][A-Za-z0-9._-]{0,30})["']""": Case(
        "match",
        "the first 200 characters a hundred times",
        ("", "<?xml", "<?xml encoding=", '<?xml encoding="'),
        (" ", "a", " encoding", " encoding =", "="),
    ),
    # messages/type_definition.py: one line each
    r"#.*": Case("search", "the rest of the line is one run", ("",), ("#", "a", "\n")),
    r"\s*string\s+(?P<name>\w+)\s*=(?P<value>.*)": Case(
        "match",
        "a constant without =: blanks, name and blanks once more",
        ("", "string", "string ", "string a", "string a "),
        (*BLANKS, "a", "string ", "="),
    ),
    r"\s*(?P<type>[\w/]+)\s+(?P<name>\w+)\s*=(?P<value>.*)": Case(
        "match",
        "a constant without =: type, blanks, name and blanks once more",
        ("", "a", "a ", "a a", "a a "),
        (*BLANKS, "a", "/", "a ", "="),
    ),
    r"\s*(?P<type>[\w/]+)(?P<array>\[\s*(?:[0-9]+\s*)?\])?\s+(?P<name>\w+)\s*$": Case(
        "match",
        "a bracket that is never closed: its blanks and digits once more",
        ("", "a", "a[", "a[1", "a[1 ", "a[1] ", "a a", "a a "),
        (*BLANKS, "a", "1", "1 ", "[ ", "a "),
    ),
    # messages/message_to_event_text.py
    r"(^|,)(-?[0-9]+)e": Case(
        "search",
        "a number without an exponent: its digits once more",
        ("", ","),
        (",", "-", "1", ",1", ",-1", "e"),
    ),
    # prolog/terms/byte_texts.py
    r"[ -~\t\n\r\v\f]*\Z": Case(
        "match", "bytes that cannot be shown at the end: all once more", ("",), ("a", "\n")
    ),
    # logic
    r"^% defines: (.*)$": Case(
        "search", "each line once", ("", "% defines: "), ("% defines: ", "\n", "a", "%", "\n%")
    ),
    r"(\d{4})-(\d\d)-(\d\d)(?:[T ](\d\d):(\d\d)(?::(\d\d(?:\.\d+)?))?(Z|[+-]\d\d:?\d\d)?)?$": Case(
        "match",
        "the digits of the fraction once more",
        ("", "2000-01-01T10:10:10.", "2000-01-01"),
        ("1", "T", "-", "+"),
    ),
    r"%(\d{0,2})f": Case("search", "three characters at each", ("", "%"), ("%", "1", "%1", "%12")),
    # prolog/syntax/tokenizer.py, by the name of the token
    "LAYOUT": Case("match", "one run", ("",), BLANKS),
    "LINE_COMMENT": Case("match", "one run", ("%",), ("%", "a", " ")),
    "BLOCK_COMMENT": Case(
        "match", "a comment that is never closed: all of it, once in a text", ("/*",), ("*", "/*", "* ", "\n")
    ),
    "BAD_COMMENT": Case("match", "one run", ("/*",), ("*", "/*", "*/", "\n")),
    "END": Case("match", "two characters", ("",), (".", ". ", ".%")),
    "WORD": Case("match", "one run", ("", "_"), ("a", "1", "_", "\u00e9")),
    "NUMBER": Case(
        "match",
        "digits of a number that has neither radix, fraction nor exponent: once for each of these",
        ("", "0", "0'\\x", "0'\\", "1'", "0x", "0x1", "0b", "0o", "1.", "1.0e", "1e", "1_"),
        ("1", "f", "_1", "1_", "_ ", " ", "_ 1", "1 ", "1'", "1.", "1.1", "1e", "\\", "4\\"),
    ),
    "QUOTED": Case(
        "match", "a quote that is not closed on its line: once more", ("'", '"', "`"), (*ESCAPES, '"', "`")
    ),
    "QUOTE": Case("match", "one character", ("",), ESCAPES),
    "SYMBOL": Case("match", "one run", ("",), ("+", ".", "\\", "+ ")),
    "SOLO": Case("match", "one character", ("",), ("!",)),
    "PUNCTUATION": Case("match", "one character", ("",), ("(", ",")),
    "BAD_CHAR": Case("match", "one character", ("",), ("a",)),
}

USES = frozenset(("compile", "match", "fullmatch", "search", "sub", "subn", "split", "findall", "finditer"))
TOKENS = "prolog/syntax/tokenizer.py"
"""The module that compiles the patterns of all tokens as one; they are tested one by one."""


def calls_of_re(path: str) -> List[ast.Call]:
    """Return the calls of functions of ``re`` with a pattern in a file."""
    file = FILES[path]
    names = [name for base, name in file.imports if base == "re"]
    assert not any(names), path
    if not names:
        return []
    return [
        node
        for node in file.nodes
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and isinstance(node.func.value, ast.Name)
        and node.func.value.id == "re"
        and node.func.attr in USES
    ]


def patterns_in(value: Any) -> Iterator[str]:
    """Yield the patterns that a global of a module holds."""
    if isinstance(value, re.Pattern):
        yield value.pattern if isinstance(value.pattern, str) else value.pattern.decode()
    elif isinstance(value, dict):
        for item in value.values():
            yield from patterns_in(item)
    elif isinstance(value, (list, tuple, set, frozenset)):
        for item in value:
            yield from patterns_in(item)


def patterns_of(path: str) -> Set[str]:
    """Return the patterns of a file: literals in calls, and values of the module."""
    calls = calls_of_re(path)
    if not calls:
        return set()
    module = importlib.import_module(f"retalis.{path[: -len('.py')].replace('/', '.')}")
    module_patterns = [pattern for value in vars(module).values() for pattern in patterns_in(value)]
    patterns = set(module_patterns)
    unread_count = 0
    for call in calls:
        try:
            value = ast.literal_eval(call.args[0])
        except ValueError:
            unread_count += 1
        else:
            patterns.add(value if isinstance(value, str) else value.decode())
    assert unread_count <= len(module_patterns), f"{path}: a pattern that a function returns cannot be tested"
    return patterns


@lru_cache(maxsize=1)
def all_patterns() -> Dict[str, Any]:
    """Return every pattern of the package by its text, or by its name if it is that of a token."""
    patterns: Dict[str, Any] = {}
    for path in sorted(FILES):
        if path != TOKENS:
            for text in patterns_of(path):
                verbose = re.VERBOSE if "\n " in text else 0
                patterns[text] = re.compile(text, verbose | (re.MULTILINE if text[0] == "^" else 0))
    for name, pattern in tokenizer.TOKEN_PATTERNS.items():
        patterns[name] = re.compile(pattern)
    return patterns


def test_each_pattern_has_a_case() -> None:
    assert set(all_patterns()) == set(CASES)


def test_patterns_of_tokens_are_compiled_once() -> None:
    assert len(calls_of_re(TOKENS)) == 1


def texts(case: Case, size: int) -> Iterator[str]:
    for first, repeated, last in product(case.first, case.repeated, case.last):
        yield first + repeated * (size // len(repeated)) + last


class TooSlowError(Exception):
    pass


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Raise `TooSlowError` after some seconds of processor time, which does not depend on other processes."""

    def stop(number: int, frame: Any) -> None:
        raise TooSlowError

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def run(pattern: Any, method: str, text: str) -> None:
    if method == "match":
        pattern.match(text)
        pattern.fullmatch(text)
    else:
        for _ in pattern.finditer(text):
            pass


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(CASES))
def test_long_text_takes_linear_time(name: Any) -> None:
    with at_most(MAX_CPU_SECONDS):
        for text in texts(CASES[name], SIZE):
            run(all_patterns()[name], CASES[name].method, text)


@pytest.mark.parametrize("name", sorted(CASES))
def test_parts_of_other_patterns_take_linear_time(name: Any) -> None:
    """Short texts show exponential time: 200 characters would take forever."""
    repeated = {part for case in CASES.values() for part in case.repeated}
    case = CASES[name]._replace(repeated=tuple(sorted(repeated)))
    with at_most(MAX_CPU_SECONDS):
        for text in texts(case, 200):
            run(all_patterns()[name], case.method, text)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pattern", "text"),
    [
        (r"'(?:''|\\x[0-9a-f]+|\\[\s\S]|[^'\\])*'", "'" + "\\x41" * 50),
        (r"\[\s*\d*\s*\]", "[" + " " * SIZE),
    ],
)
def test_slow_pattern_is_detected(pattern: str, text: str) -> None:
    """A pattern with exponential and one with quadratic time."""
    with pytest.raises(TooSlowError), at_most(0.5):
        run(re.compile(pattern), "match", text)
