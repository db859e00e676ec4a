"""The benchmark that loads Prolog files of others: which files it takes, and how it counts."""

import importlib
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
_path = list(sys.path)
sys.path.insert(0, str(HERE.parents[1] / "bench"))
corpus = importlib.import_module("corpus")
sys.path[:] = _path  # the benchmark adds to it as well, and its modules' names are those of test packages

Loaded = corpus.Loaded


def test_files_are_spread_over_a_repository(tmp_path):
    for number in range(10):
        path = tmp_path / "one" / f"{number}.pl"
        path.parent.mkdir(exist_ok=True)
        path.write_text("a.")
    (tmp_path / "one" / "no.txt").write_text("a.")
    (tmp_path / "one" / "empty.pl").write_text("")
    (tmp_path / "two").mkdir()
    found = [str(path) for path in corpus.chosen(tmp_path, 3, "")]
    assert found == ["one/0.pl", "one/3.pl", "one/6.pl"]
    assert corpus.chosen(tmp_path, 3, "one/3") == [Path("one/3.pl")]


def test_a_file_is_loaded_with_what_is_left_out(tmp_path):
    path = tmp_path / "kb.pl"
    path.write_text("p(1).\np(2).\np(.\nq :- p(_).\n")
    found = corpus.load(path, 5.0)
    assert (found.errors, found.clauses) == ([], {"p/1": 2, "q/0": 1})
    assert ["kb.pl:3:3" in one for one in found.omitted] == [True]
    path.write_text("c <- .\n")
    assert len(corpus.load(path, 5.0).errors) == 1


def test_messages_that_differ_in_names_are_of_one_kind():
    assert corpus.kind("a/b.pl:1:2: expected 'x' before \"y\" 12\np(.\n  ^") == "expected _ before _ _"


def test_files_are_counted(capsys):
    comparison = corpus.Comparison()
    comparison.add("one/a.pl", Loaded([], [], {"p/1": 2}), Loaded([], [], {"p/1": 2, "r/1": 1}))
    comparison.add("one/b.pl", Loaded([], [], {"p/1": 2}), Loaded([], ["b.pl:1:1: no"], {"p/1": 1}))
    comparison.add("two/c.pl", Loaded([], [], None), Loaded(["c.pl:1:1: no"], [], None))
    comparison.show()
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines[1] == ["one", "2", "2", "1", "1"]
    assert lines[2] == ["two", "1", "0", "0", "0"]
    assert lines[3][:5] == ["all", "3", "2", "1", "1"]
    assert lines[4][:2] == ["2", "no"]
