"""Snippets of ``CONTRIBUTING.md``: each extension is added to a copy of the source tree, and used as users do."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from contributing_snippets import ROOT, SNIPPETS

pytestmark = [pytest.mark.docs, pytest.mark.slow]

COPIED = ("src", "docs", "test", "examples", "CONTRIBUTING.md", "README.md", "package.xml", "pyproject.toml")
"""Folders and files that the commands of the sections need."""


class Tree:
    """Copy of the source tree with the snippets of some sections.

    Attributes:
        folder: root of the copy.
    """

    def __init__(self, folder: Path, *sections: str):
        self.folder = folder
        for name in COPIED:
            if (ROOT / name).is_dir():
                ignored = shutil.ignore_patterns("__pycache__", "_build", "bags", ".hypothesis")
                shutil.copytree(str(ROOT / name), str(folder / name), ignore=ignored)
            else:
                shutil.copy(str(ROOT / name), str(folder / name))
        for section in sections:
            for snippet in SNIPPETS[section]:
                snippet.add_to(folder)

    def run(self, *arguments: str, text: str = "") -> "subprocess.CompletedProcess[str]":
        """Run Python with the copy of the package; return the ended process."""
        folders = [str(self.folder / "src"), str(self.folder / "test"), os.environ.get("PYTHONPATH", "")]
        return subprocess.run(
            [sys.executable, *arguments],
            cwd=str(self.folder),
            env={
                "PYTHONPATH": os.pathsep.join(filter(None, folders)),
                "PATH": "/usr/bin:/bin",
                "HOME": str(self.folder),
            },
            input=text,
            capture_output=True,
            text=True,
            timeout=300,
        )

    def output(self, *arguments: str, text: str = "") -> str:
        """Return the output of a process that succeeds without errors."""
        process = self.run(*arguments, text=text)
        assert (process.returncode, process.stderr) == (0, ""), process.stdout + process.stderr
        return process.stdout

    def run_tests(self, *arguments: str) -> None:
        """Run tests of the copy; all of them pass."""
        process = self.run("-m", "pytest", "-q", "-p", "no:cacheprovider", "-n", "0", *arguments)
        assert process.returncode == 0, process.stdout + process.stderr


OPERATOR_PROGRAM = """
import logging
import sys

from retalis import Engine, ProgramErrors, StreamClock
from retalis.explanation.event_and_output_explanations import explain, record_origins
from retalis.prolog.terms.timestamps import SECOND
from retalis.prolog.terms.types import functor

EVENTS = (("a(1)", 1, 4), ("a(2)", 2, 5), ("b(3)", 3, 6), ("b(4)", 5, 6), ("a(5)", 0, 4), ("b(6)", 1, 5))
RULES = "o(X, Y) <- a(X) 'STRADDLES' b(Y) where X > 0. p(X) <- a(X) straddles b(X)."


def emitted_events(engine, events):
    emitted = []
    engine.on_event(
        lambda term, start, end: emitted.append((engine.show(term), start // SECOND, end // SECOND))
    )
    for event in events:
        engine.event(*event)
    return [event for event in emitted if event[0][0] == "o"]


for policy in ("recent", "recent_2", "chronological", "chronological_2", "unrestricted"):
    results = set()
    for position in range(len(EVENTS)):
        engine = Engine(clock=StreamClock(1000 * SECOND))
        engine.load(goals="set_etalis_flag(event_consumption_policy, %s)" % policy, rules=RULES)
        first = emitted_events(engine, EVENTS[:position])
        restored = Engine.restore(engine.snapshot(), clock=StreamClock(1000 * SECOND))
        results.add(tuple(first + emitted_events(restored, EVENTS[position:])))
    (result,) = results
    print(policy, *("%s@%d-%d" % event for event in result))

engine = Engine(clock=StreamClock(1000 * SECOND))
record_origins(engine)
engine.load(rules="p(X) <- a(X) straddles b(X).")
engine.event("a(7)", 1, 2)
engine.event("b(7)", 3, 4)
lines = explain(engine, (functor("p", 1), 7)).lines
print(*(text.strip() for line in lines for text in line.indented() if "straddles:" in text))

logging.basicConfig(stream=sys.stdout, format="%(message)s")
for rule in ("p <- a stradles b.", "p <- a besides b.", "straddles(X, Y) <- a(X, Y)."):
    try:
        engine.load(rules=rule)
    except ProgramErrors as errors:
        print(errors.errors[0].message)
"""
OPERATOR_OUTPUT = """\
recent o(2,3)@2-6 o(5,6)@0-5
recent_2 o(2,3)@2-6 o(5,6)@0-5
chronological o(1,3)@1-6 o(5,6)@0-5
chronological_2 o(1,3)@1-6 o(5,6)@0-5
unrestricted o(1,3)@1-6 o(2,3)@2-6 o(5,3)@0-6 o(5,6)@0-5
- straddles: none of the first overlaps one of the second
expected an operator or a full stop before "stradles"; did you mean "straddles"?
expected an operator or a full stop before "besides"; "besides" is not an operator; two patterns are joined with \
"or", "par", "and", "straddles", "seq", "forall_seq", "equals", "meets", "during", "starts" or "finishes"
text:1:1: no pattern can match this event: in patterns straddles is an operator, and is written after the \
arrow: Head <- Pattern where Goal
straddles(X, Y) <- a(X, Y).
^
"""


def test_operator_is_added(tmp_path: Path) -> None:
    """The operator is parsed, matched, stored and explained, under each policy and at each position."""
    tree = Tree(tmp_path, "An operator (`meets`)")
    assert tree.output("-c", OPERATOR_PROGRAM).splitlines() == OPERATOR_OUTPUT.splitlines()
    tree.output("docs/editors/make.py")
    tree.run_tests(
        "test/events/language/test_event_operators.py",
        "test/test_operators_page.py",
        "test/events/test_operator_table.py",
        "test/test_syntax_highlighting.py",
        "-k",
        "straddles or test_syntax_highlighting or page or covers or cover",
    )
    assert "0 differ" in tree.output("-m", "oracle.comparison", "--cases", "50")


STREAM_RULES = """\
span(R) <- aggregate(range(X), a(X), R, last(5)).
span_after(Y, R) <- b(Y) seq aggregate(range(X), a(X), R).
third(X) <- (a(X) with every_third(1)).
"""
STREAM = "event(b(0),[0,0]).\n" + "".join(f"event(a({value}),[{value},{value}]).\n" for value in (1, 2, 4, 8))
STREAM_OUTPUT = """\
event(span(0),[1,1]).
event(span(1),[1,2]).
event(span(3),[1,4]).
event(span(4),[4,8]).
event(span_after(0,0),[0,1]).
event(span_after(0,1),[0,2]).
event(span_after(0,3),[0,4]).
event(span_after(0,7),[0,8]).
event(third(4),[4,4]).
"""


def test_aggregate_and_rate_operator_are_added(tmp_path: Path) -> None:
    """Both are parsed and evaluated; ``test_extension_snapshots`` tests snapshots of both."""
    tree = Tree(tmp_path, "An aggregate (`avg`)", "A rate operator (`burst`)")
    (tmp_path / "rules.txt").write_text(STREAM_RULES)
    (tmp_path / "stream.txt").write_text(STREAM)
    output = tree.output("-m", "retalis", "events", "--rules", "rules.txt", "--stream", "stream.txt")
    assert sorted(set(output.splitlines()) - set(STREAM.splitlines())) == STREAM_OUTPUT.splitlines()


BUILTIN_GOALS = """\
atom_reverse(abc, A).
atom_reverse(12, '21').
atom_reverse(abc, abc).
atom_reverse(_, C).
atom_reverse(f(x), C).
atom_revers(abc, A).
help(atom_reverse).
"""
BUILTIN_OUTPUT = """\
A = cba.
true.
false.
atom_reverse(+Text, -Atom)
    Atom has the characters of Text in reverse order.
"""
BUILTIN_ERRORS = """\
error: Arguments are not sufficiently instantiated (in atom_reverse/2)
error: Type error: `text' expected, found `f(x)' (in atom_reverse/2)
error: Unknown procedure: atom_revers/2: did you mean atom_reverse/2?
"""
BUILTIN_SEARCH = """\
atom_reverse(+Text, -Atom)
  meaning  Atom has the characters of Text in reverse order.
  example  ?- atom_reverse(abc, A).
"""


def test_builtin_is_added(tmp_path: Path) -> None:
    tree = Tree(tmp_path, "A built-in (`atom_length`)")
    console = tree.run("-m", "retalis", "console", text=BUILTIN_GOALS)
    assert (console.stdout, console.stderr) == (BUILTIN_OUTPUT, BUILTIN_ERRORS)
    assert tree.output("-m", "retalis", "help", "atom_reverse").startswith(BUILTIN_SEARCH)
    (tmp_path / "rules.txt").write_text("palindrome(X) <- word(X) where atom_reverse(X, X).\n")
    (tmp_path / "stream.txt").write_text("event(word(abc), [1, 1]).\nevent(word(aba), [2, 2]).\n")
    events = tree.output("-m", "retalis", "events", "--rules", "rules.txt", "--stream", "stream.txt")
    assert events.splitlines()[2:] == ["event(palindrome(aba),[2,2])."]
    tree.run_tests("-m", "", "test/test_predicates_page.py", "-k", "atom_reverse or exactly or invalid")


MESSAGE_PROGRAM = """
from retalis import BagWriter, Definitions, MessageError, atom, functor
from retalis.messages.message_to_event_text import make_text_writer
from retalis.messages.message_dictionaries import make_message_term, read_message_term

definitions = Definitions()
half = definitions.add("lab/Half", "float16 MAX=65504.0\\nfloat16 x\\nfloat16[3] y\\nfloat16[] z\\n")
decoder, encoder = definitions.decoder(half), definitions.encoder(half)
message = encoder.encode(make_message_term(half, {"x": 0.5, "y": [1, 2, 3], "z": range(9)}))
print(message.hex(), half.constants[0].value)
print(read_message_term(half, decoder.decode(message)))
print(make_text_writer(decoder)(message))
for value in (1e6, atom("much")):
    try:
        encoder.encode(functor("lab__0__Half", 3)(value, atom("[]"), atom("[]")))
    except MessageError as error:
        print(error)
with BagWriter("half.bag") as bag:
    bag.write(bag.add("/half", half), 10**9, message)
"""
MESSAGE_OUTPUT = """\
0038003c00400042090000000000003c0040004200440045004600470048 65504.0
{'x': 0.5, 'y': [1.0, 2.0, 3.0], 'z': [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]}
lab__0__Half(0.5,[1.0,2.0,3.0],[0.0,1.0,2.0,3.0,4.0,5.0,6.0,7.0,8.0])
lab/Half, slot x: 1000000.0 is too large for float16
lab/Half, slot x: expected float16, got the atom much
"""
READING_PROGRAM = """
from retalis import BagReader, Definitions, Engine

with BagReader("twice.bag") as bag:
    for record in bag.records():
        definitions = Definitions()
        half = definitions.add("lab/Half", record.topic.definition)
        print(record.topic.name, Engine().show(definitions.decoder(half).decode(record.data)))
"""
TWICE = "lab__0__Half(1.0,[0.0,0.0,0.0],[0.0,1.0,2.0,3.0,4.0,5.0,6.0,7.0,8.0])"
TOPICS = """\
<publish_subscribe>
  <subscribe_to name="half" msg_type="lab/Half"/>
  <publish_to name="twice" msg_type="lab/Half"/>
</publish_subscribe>
"""
GOALS = """\
compile_event_file('rules.txt')
subscribe(lab__0__Half(_, [0.0|_], _), [], _, twice, s1)
"""
RULES = "lab__0__Half{x: Y, y: [0, 0, 0], z: Z} <- lab__0__Half{x: X, y: [1.0|_], z: Z} where X < 1, Y is 2 * X.\n"


def test_wire_format_is_added(tmp_path: Path) -> None:
    """Messages with slots of the type are read from a bag, matched by rules, and published."""
    tree = Tree(tmp_path, "A wire format: a type of slots in messages (`bool`)")
    assert tree.output("-c", MESSAGE_PROGRAM) == MESSAGE_OUTPUT
    for name, text in {"pub_sub.xml": TOPICS, "goalPredicates.txt": GOALS, "rules.txt": RULES}.items():
        (tmp_path / name).write_text(text)
    output = tree.output("-m", "retalis", "bag", "half.bag", "--program", ".", "--output", "twice.bag")
    assert output == f"output({TWICE},twice).\n"
    assert tree.output("-c", READING_PROGRAM) == f"/twice {TWICE}\n"
    tree.run_tests("-m", "", "test/messages/test_round_trip.py", "-k", "random_type")


def test_command_is_added(tmp_path: Path) -> None:
    tree = Tree(tmp_path, "A command (`demo`)")
    retalis = ("-m", "retalis")
    assert tree.output(*retalis, "operator", "seq") == "two patterns, and how their intervals lie\n"
    failure = tree.run(*retalis, "operator", "seqq")
    assert (failure.returncode, failure.stdout) == (1, "")
    assert failure.stderr == "retalis: operator: there is no operator 'seqq'; did you mean seq?\n"
    assert tree.run(*retalis, "operator").returncode == 2
    assert tree.output(*retalis, "operator", "--help").startswith("usage: retalis operator [options] NAME\n")
    assert "\n    operator " in tree.output(*retalis, "--help")
    assert tree.output(*retalis, "complete", "words", "1", "retalis", "oper") == "operator\n"
    tree.output("docs/commands.py")
    assert "\n## retalis operator\n" in (tmp_path / "docs" / "reference" / "commands.md").read_text()
    tree.run_tests("test/cli/test_command_line.py", "test/test_commands_page.py")
