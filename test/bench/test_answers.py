"""The benchmark that asks Prolog files of others the same goals here and in SWI-Prolog."""

import importlib
import json
import shutil
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
_path = list(sys.path)
sys.path.insert(0, str(HERE.parents[1] / "bench"))
answers = importlib.import_module("answers")
sys.path[:] = _path  # the benchmark adds to it as well, and its modules' names are those of test packages

Answer = answers.Answer
TEXT = """\
% ?- p(X, b).
/* Ask
   ?- p(a, Y), q(Y).
   ?- p(a, Y), q(Y). */
p(a, b). % ?-p(a, b).
p(b, "?- no").
q(b) :- write(hello).
here(1.5).
"""


def test_queries_are_those_of_comments():
    assert answers.queries(TEXT, 9) == ["p(X, b)", "p(a, Y), q(Y)", "p(a, b)"]
    assert answers.queries(TEXT, 1) == ["p(X, b)"]


def test_answers_are_read():
    said = "x\n@@begin load\nhi\n@@result loaded\n@@end\n\n@@begin p(A)\n\n@@result [p(1)]\n@@end\n"
    said += "\n@@begin q\nbye\n@@end\n"
    assert dict(answers.parts(said)) == {
        "load": Answer("hi", "loaded"),
        "p(A)": Answer("", "[p(1)]"),
        "q": Answer("bye", "halted"),
    }


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (Answer("_G12 is\n", "[]"), Answer("_345 is", "[]")),
        (Answer("", "error(syntax_error(a))"), Answer("", "error(syntax_error(b(1)))")),
        (
            Answer("", "error(existence_error(procedure,:(m,/(p,1))))"),
            Answer("", "error(existence_error(procedure,/(p,1)))"),
        ),
        (Answer("", "error(permission_error(halt,process,true))"), Answer("", "halted")),
    ],
)
def test_what_is_free_to_differ(one, other):
    assert one.plain == other.plain


def test_differences_have_kinds():
    some, none = Answer("", "[p]"), Answer("", "[]")
    assert answers.difference(some, Answer("", "limit")) == "limit"
    assert answers.difference(some, none) == "fails here"
    assert answers.difference(none, some) == "fails there"
    assert answers.difference(some, Answer("", "[q]")) == "other solutions"
    assert answers.difference(some, Answer("a", "[p]")) == "prints something else"
    assert answers.difference(some, Answer("", "error(oops)")) == "error here: oops)"
    assert answers.difference(Answer("", "error(oops)"), some) == "error there: oops)"


def test_files_and_goals_are_counted(capsys):
    table = answers.Table()
    alike, other = {"p": Answer("", "[p]")}, {"p": Answer("", "[]")}
    missing = {answers.LIBRARIES: Answer("", "chr")}
    table.add("one/a.pl", alike, alike)
    table.add("one/b.pl", alike, other)
    table.add("one/c.pl", alike, {**other, **missing})
    table.add("two/silent.pl", {"load": Answer("", "loaded")}, {})
    table.show()
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines[1] == ["one", "3", "1", "3", "1", "2", "1", "2", "1"]
    assert lines[2][0] == "all"
    assert lines[3][-4:] == ["33.3%", "33.3%", "50.0%", "50.0%"]
    assert [line[0] for line in lines[4:]] == ["1", "1"]


@pytest.mark.slow
def test_a_file_is_asked_here(tmp_path, capfd):
    path = tmp_path / "kb.pl"
    path.write_text(":- use_module(library(chr)).\n:- write(hi).\n" + TEXT)
    answers.tell(path, ["p(A,B)", "here(A)", "nowhere(A)", "p(", "halt", "throw(f(A))"], 5.0)
    assert dict(answers.parts(capfd.readouterr().out)) == {
        "load": Answer("hi", "loaded"),
        answers.LIBRARIES: Answer("", "chr"),
        "p(A,B)": Answer("", '[p(a,b),p(b,"?- no")]'),
        "here(A)": Answer("", "[here(1.5)]"),
        "nowhere(A)": Answer("", "error(existence_error(procedure,/(nowhere,1)))"),
        "p(": Answer("", "unread"),
        "halt": Answer("", "error(permission_error(halt,process,true))"),
        "throw(f(A))": Answer("", "ball(f(A))"),
    }


@pytest.mark.slow
def test_both_are_asked(tmp_path, capsys, monkeypatch):
    if shutil.which("swipl") is None or not answers.is_closed():
        pytest.skip("SWI-Prolog is not installed, or no process without network can be started")
    (tmp_path / "some").mkdir()
    (tmp_path / "some" / "kb.pl").write_text(
        ":- module(m, [p/2]).\n" + TEXT + "d(X) :- dif(X, a).\nr :- write(hi), halt.\n"
    )
    details, kept = tmp_path / "details.json", tmp_path / "swi.json"
    command = [
        "answers.py",
        str(tmp_path),
        "--details",
        str(details),
        "--swi-results",
        str(kept),
        "--goals",
        "9",
    ]
    monkeypatch.setattr(sys, "argv", command)
    assert answers.main() == 0
    out = capsys.readouterr().out.splitlines()
    known = json.loads(kept.read_text())["some/kb.pl"]
    assert known[":(m,','(p(a,A),q(A)))"] == ["hello", "[','(p(a,b),q(b))]"]
    assert known[":(m,r)"] == ["hi", "halted"]
    assert list(json.loads(details.read_text())["some/kb.pl"]["wrong"]) == [":(m,d(A))"]
    assert out[1].split() == ["some", "1", "0", "9", "8", "1", "0", "9", "8"]
