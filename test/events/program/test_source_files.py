"""Source files of a program: modules, files loaded once, included files, libraries, permissions."""

from pathlib import Path
from typing import Any, List

import pytest
from asserting_accessors import place_of
from events.program_runner import ProgramRunner, format_events
from recording_reports import RecordingReports

from retalis import Engine, ProgramErrors, PrologError, RetalisError, Settings, StreamClock, atom
from retalis.prolog.files.source_files import SourceFiles


def write(folder: Any, **texts: Any) -> None:
    for name, text in texts.items():
        path = folder / name.replace("__", "/")
        path.parent.mkdir(exist_ok=True)
        path.with_suffix(".pl").write_text(text, encoding="utf-8")


def errors_of(operation: Any) -> List[str]:
    with pytest.raises(ProgramErrors) as caught:
        operation()
    return [
        f"{place_of(error).source}:{place_of(error).line}:{place_of(error).column}: {error.message}"
        for error in caught.value.errors
    ]


@pytest.mark.parametrize("form", [":- use_module({})", "use_module({})", ":- ensure_loaded({})"])
@pytest.mark.parametrize("name", ["'sub/one.pl'", '"sub/one.pl"', "sub/one", "'sub/one'"])
def test_used_file_is_loaded_before_rules(
    program: ProgramRunner, tmp_path: Path, form: str, name: str
) -> None:
    write(tmp_path, main=f"d <- c.\n{form.format(name)}.", sub__one=":- use_module(two).", sub__two="c <- a.")
    program.engine.program.loader.load_file(tmp_path / "main.pl")
    assert program.feed("a@1") == "c@1-1 d@1-1"


def test_ensured_file_is_loaded_once(program: ProgramRunner, tmp_path: Path) -> None:
    write(
        tmp_path,
        one="c <- a.",
        main=":- ensure_loaded(one). :- ensure_loaded('./one.pl').",
        more="use_module(one).",
    )
    program.engine.program.loader.load_file("main.pl")
    assert program.engine.call("ensure_loaded(one)")
    assert program.feed("a@1") == "c@1-1"
    program.engine.program.loader.load_file("more.pl")
    assert program.feed("a@2") == "c@2-2 c@2-2"


@pytest.mark.parametrize(
    "goal", ["consult('sub/one')", "consult(sub/one)", "[sub/one]", "consult([sub/one])"]
)
def test_consulted_file_is_relative_to_directive(program: ProgramRunner, tmp_path: Path, goal: str) -> None:
    write(tmp_path, inner__main=f":- {goal}. d <- c.")
    (tmp_path / "inner" / "sub").mkdir()
    write(tmp_path / "inner", sub__one="c <- a.")
    program.engine.program.loader.load_file("inner/main.pl")
    assert program.feed("a@1") == "c@1-1 d@1-1"


def test_directive_of_used_file_is_relative_to_it(program: ProgramRunner, tmp_path: Path) -> None:
    write(
        tmp_path,
        main=":- use_module('sub/one.pl').",
        sub__one=":- compile_event_file('two.pl').",
        sub__two="c <- a.",
    )
    program.engine.program.loader.load_file("main.pl")
    assert program.feed("a@1") == "c@1-1"


def test_files_that_ensure_each_other_are_loaded_once(program: ProgramRunner, tmp_path: Path) -> None:
    write(tmp_path, one=":- ensure_loaded(two). c <- a.", two=":- ensure_loaded(one). d <- a.")
    program.engine.program.loader.load_file("one.pl")
    assert program.feed("a@1") == "d@1-1 c@1-1"


def test_refused_file_may_be_loaded_again(program: ProgramRunner, tmp_path: Path) -> None:
    write(tmp_path, one="c <- a. :- no_such_goal.")
    errors_of(lambda: program.engine.load(rules=":- ensure_loaded(one)."))
    write(tmp_path, one="c <- a.")
    program.engine.load(rules=":- ensure_loaded(one).")
    assert program.feed("a@1") == "c@1-1"


def test_reset_allows_loading_file_again(program: ProgramRunner, tmp_path: Path) -> None:
    write(tmp_path, one="c <- a.")
    assert program.engine.call("ensure_loaded(one), reset_etalis, ensure_loaded(one)")
    assert program.feed("a@1") == "c@1-1"


def test_included_file_is_read_in_place(program: ProgramRunner, tmp_path: Path) -> None:
    write(tmp_path, sub__more=":- op(700, xfx, ===>). :- include(yet). f(a ===> b).", sub__yet="d <- a.")
    program.engine.load(rules="c <- a. :- include(sub/more). e <- a. g(x ===> y).")
    assert program.feed("a@1") == "c@1-1 d@1-1 e@1-1"
    assert program.engine.call("f(===>(a,b)), g(===>(x,y))")


def test_compiled_terms_may_include_files(program: ProgramRunner, tmp_path: Path) -> None:
    write(tmp_path, one="c <- a.")
    assert program.engine.call("compile_event_rules([(:- include(one)), (d <- a)])")
    assert program.feed("a@1") == "c@1-1 d@1-1"


def test_errors_of_files_are_in_order(program: ProgramRunner, tmp_path: Path) -> None:
    write(tmp_path, one="x <- (.\ny <- a ntimes z.", two="ok <- a.\nz <- a not b.")
    rules = "v <- b ntimes q.\n:- include(one).\n:- use_module(two).\n:- include(none).\nw <- .\n"
    errors = errors_of(lambda: program.engine.load(rules=rules, source="r"))
    assert [text.split(": ")[0] for text in errors] == [
        "one.pl:1:7",
        "one.pl:2:15",
        "r:1:15",
        "r:4:4",
        "r:5:6",
        "two.pl:2:8",
    ]
    assert errors[3] == "r:4:4: cannot read none: No such file or directory"
    assert program.engine.rules.rules == []


@pytest.mark.parametrize("form", ["include", "use_module"])
def test_cycle_of_files_is_one_error(program: ProgramRunner, tmp_path: Path, form: str) -> None:
    write(tmp_path, one=f"c <- a.\n:- {form}(two).", two=f":- {form}(one).\nd <- a.")
    errors = errors_of(lambda: program.engine.program.loader.load_file("one.pl"))
    assert errors == ["two.pl:1:4: one.pl loads itself"]
    text = (tmp_path / "one.pl").read_text()
    assert errors_of(lambda: program.engine.load_rules(text, "one.pl", tmp_path)) == [
        f"{tmp_path}/two.pl:1:4: one.pl loads itself"
    ]


@pytest.mark.parametrize(
    "name",
    ["lists", "apply", "assoc", "pairs", "ordsets", "aggregate", "random", "yall", "dcg/basics"],
)
def test_libraries_are_available(program: ProgramRunner, name: str) -> None:
    program.engine.load(rules=f":- use_module(library({name})). use_module(library({name})). c <- a.")
    program.engine.load(
        goals=f"use_module(library({name}))\nuse_module(library({name}), [])\nensure_loaded(library({name}))"
    )
    assert program.warnings == []
    assert program.feed("a@1") == "c@1-1"


@pytest.mark.parametrize(
    ("form", "column"),
    [(":- use_module", 4), ("use_module", 1), (":- ensure_loaded", 4), (":- true, use_module", 10)],
)
def test_unknown_library_is_refused(program: ProgramRunner, form: str, column: int) -> None:
    (error,) = errors_of(lambda: program.engine.load(rules=f"c <- a.\n{form}(library(clpfd)).", source="r"))
    assert error.startswith(f"r:2:{column}: ")
    assert "Unknown library: clpfd" in error


@pytest.mark.parametrize("name", ["X", "17", "f(x)", "library(X)", "''", "'a\\\\0\\\\b'"])
@pytest.mark.parametrize("form", ["include", "use_module", "ensure_loaded"])
def test_invalid_file_name_is_one_error(program: ProgramRunner, form: str, name: str) -> None:
    (error,) = errors_of(lambda: program.engine.load(rules=f":- {form}({name}).", source="r"))
    assert error.startswith("r:1:4: ")


# ---- goal files ------------------------------------------------------------------------------------------


def test_paths_of_goal_files_are_relative(program: ProgramRunner, tmp_path: Path) -> None:
    write(
        tmp_path,
        sub__rules="c <- a.",
        sub__goals="ensure_loaded(rules)\n:- ensure_loaded(rules).\nassert(f(1))\n",
    )
    program.engine.call_goals("include(sub/goals)\n:- include('sub/goals.pl').\n", "goals.txt", tmp_path)
    assert program.feed("a@1") == "c@1-1"
    assert len(program.engine.query("f(1)")) == 2


def test_errors_of_goal_files_have_positions(program: ProgramRunner, tmp_path: Path) -> None:
    write(
        tmp_path,
        sub__more="true\nfail\ninclude('../goals.pl')\ncompile_event_file(none)\n",
        sub__bad="x <- (.",
    )
    write(tmp_path, goals="include(sub/more)")
    goals = "include(nothing)\ninclude(sub/more)\nensure_loaded(sub/bad)"
    errors = errors_of(lambda: program.engine.call_goals(goals, str(tmp_path / "goals.pl"), tmp_path))
    assert [text.replace(f"{tmp_path}/", "") for text in errors] == [
        "goals.pl:1:1: cannot read nothing: No such file or directory",
        "sub/more.pl:2:1: this goal fails",
        "sub/more.pl:3:1: goals.pl loads itself",
        "sub/more.pl:4:1: cannot read sub/none: No such file or directory (in compile_event_file/1)",
        "sub/bad.pl:1:7: expected a term before the end of the clause",
    ]


# ---- permissions ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "goal", ["ensure_loaded({})", "use_module({})", "compile_event_rules([(:- include({}))])"]
)
def test_goal_opens_files_in_allowed_folders_only(tmp_path: Path, goal: str) -> None:
    write(tmp_path, inside__one="c <- a.", outside__one="c <- a.")
    engine = Engine(settings=Settings(folders=(str(tmp_path / "inside"),)))
    with pytest.raises(Exception, match="No permission to open source_sink"):
        engine.call(goal.format(f"'{tmp_path}/outside/one.pl'"))
    assert engine.rules.rules == []
    assert engine.call(goal.format(f"'{tmp_path}/inside/one.pl'"))
    assert len(engine.rules.rules) == 1


@pytest.mark.parametrize("mode", ["write", "append"])
def test_invalid_file_name_is_not_written(tmp_path: Path, mode: str) -> None:
    engine = Engine(settings=Settings(write_folders=(str(tmp_path),)))
    for name, error in (("'a\\0\\b'", "Domain error: `source_sink'"), ("x" * 256, "max_path_length")):
        with pytest.raises(PrologError, match=error):
            engine.query(f"open({name}, {mode}, _)")
    assert list(tmp_path.iterdir()) == []


def _warnings_of_persistent_rule(write_folders: Any = (), **settings: Any) -> List[str]:
    reports = RecordingReports()
    engine = Engine(StreamClock(), Settings(write_folders=write_folders, **settings), reports)
    engine.load(rules="persistent_event(b(_)). b(X) <- a(X).")
    for number in range(4):
        engine.event(f"a({number})", number, number)
    return reports.texts


EXPECTED_FILE = "".join(f"event(b({number}),[{number},{number}]).\n" for number in range(4))


def test_unrestricted_events_are_in_working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert _warnings_of_persistent_rule(None) == []
    assert (tmp_path / "persistent.txt").read_text() == EXPECTED_FILE


def test_persistent_events_are_in_allowed_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here").mkdir()
    (tmp_path / "program").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert _warnings_of_persistent_rule((str(tmp_path / "program"),)) == []
    assert (tmp_path / "program" / "persistent.txt").read_text() == EXPECTED_FILE
    for settings in ({}, {"folders": (str(tmp_path),)}, {"folders": None}):
        reported = _warnings_of_persistent_rule(**settings)
        assert [text.partition(" ")[0] for text in reported] == ["1", "2", "4"]
        assert "no folder" in reported[0]
    assert list((tmp_path / "here").iterdir()) == []


@pytest.mark.parametrize("fact", ["print_trigger", "external_trigger", "spy_event", "persistent_event"])
def test_events_named_by_facts_are_logged_or_written(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, fact: str
) -> None:
    caplog.set_level("INFO", "retalis")
    program = ProgramRunner()
    program.engine.rules.files.sandbox.allow([tmp_path], [tmp_path])
    program.engine.load(rules=f"{fact}(b(1)). b(X) <- a(X).")
    assert program.engine.call(f"assertz({fact}(c/0))")
    program.feed("a(1)@1 a(2)@2 c@3")
    written = tmp_path / "persistent.txt"
    text = written.read_text() if written.exists() else caplog.text
    assert "event(b(1),[1,1])" in text
    assert "event(c,[3,3])" in text
    assert "b(2)" not in text
    assert program.engine.call(f"exists_file('{written}')") == (fact == "persistent_event")


def test_failed_write_of_persistent_event_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "persistent.txt").mkdir()
    assert "Is a directory" in _warnings_of_persistent_rule(None)[0]
    assert "Is a directory" in _warnings_of_persistent_rule([tmp_path])[0]


def test_refused_file_keeps_library_predicates(program: ProgramRunner) -> None:
    for rules in (
        "memberchk(zz, _) :- true. c <- a ntimes z.",
        "memberchk(zz, _) :- true. min(1, 2, 3) :- true. d <- a. :- no_such_goal.",
    ):
        errors_of(lambda rules=rules: program.engine.load(rules=rules))
        assert program.engine.call("memberchk(1, [1]), min(1, 2, 1)")
    program.engine.load(rules="memberchk(zz, _) :- true.")
    assert not program.engine.call("memberchk(1, [1])")
    assert format_events(program.events) == ""


@pytest.mark.parametrize(
    "goal",
    ["consult({})", "[{}]", "use_module({})", "compile_event_file({})", "execute_event_stream_file({})"],
)
def test_missing_file_is_existence_error(goal: str, tmp_path: Path) -> None:
    engine = Engine(settings=Settings(folders=(str(tmp_path),)))
    name = f"'{tmp_path}/no.txt'"
    caught = f"catch({goal.format(name)}, error(existence_error(source_sink, Name), _), true)"
    (answer,) = engine.query(caught)
    assert engine.show(answer["Name"]) == name
    with pytest.raises(PrologError, match=f"cannot read {tmp_path}/no.txt: No such file or directory"):
        engine.call(goal.format(name))


def test_reload_limits_omissions() -> None:
    files = SourceFiles()
    with files.reloading({"one.pl": 2}):
        assert (files.max_omitted("one.pl"), files.max_omitted("two.pl")) == (2, 0)
    assert (files.max_omitted("one.pl"), files.max_omitted("two.pl")) == (None, None)


def test_file_without_omissions_is_not_recorded() -> None:
    files = SourceFiles()
    for number in (2, 0):
        files.record_omitted("one.pl", number)
        assert files.omitted == ({"one.pl": 2} if number else {})


def test_names_are_relative_to_loaded_file_or_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in ("sub", "own", "here"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / f"{folder}.pl").write_text("")
    monkeypatch.chdir(tmp_path / "here")
    files = SourceFiles()
    files.sandbox.add_program_folder(tmp_path / "own")

    def is_relative_to(folder: str) -> bool:
        assert files.absolute("../x") == str(tmp_path / "x")
        assert files.absolute("x") == str(tmp_path / folder / "x")
        assert files.is_folder(f"../{folder}")
        assert not files.is_folder("x")
        assert files.is_readable(f"{folder}.pl")
        assert not files.is_readable("x.pl")
        assert files.to_read(atom(f"{folder}.pl")) == (str(files.find(atom(folder))), "")
        for operation in (files.absolute, files.is_readable, files.is_folder, files.resolve):
            with pytest.raises(PrologError, match="source_sink"):
                operation("\0")
        return True

    files.sandbox.allow([tmp_path], [tmp_path / "own"])
    assert is_relative_to("own")
    files.sandbox.allow(None, [])
    assert is_relative_to("here")
    with files.relative_to(tmp_path / "sub"):
        assert is_relative_to("sub")
        with files.relative_to(None):
            assert is_relative_to("sub")
    assert is_relative_to("here")
    with files.loading(tmp_path / "sub"):
        assert is_relative_to("sub")
    assert is_relative_to("here")


def test_written_file_is_emptied_or_appended(tmp_path: Path) -> None:
    files = SourceFiles()
    files.sandbox.allow([], [tmp_path])
    with files.relative_to(tmp_path):
        for more, text in ((False, "one"), (True, "one"), (True, "oneone"), (False, "")):
            path = files.to_write(atom("new.txt"), more)
            assert path == str(tmp_path / "new.txt")
            assert files.to_read(atom("new.txt")) == (path, "" if not more else text)
            files.add(path, "one")


def test_second_file_of_module_is_reported(tmp_path: Path) -> None:
    files, warnings = SourceFiles(), []
    assert files.record_module("nothing_is_loaded") == ""
    first, second, other = (tmp_path / name for name in ("one.pl", "two.pl", "other.pl"))
    for path, name in ((first, "m"), (other, "n"), (first, "m"), (second, "m")):
        with files.loading_file(path):
            warnings.append(files.record_module(name))
            assert files.module(path) == name
    warning = f"Warning: {first} is module m as well; what {second} has of it is added to that\n"
    assert warnings == ["", "", "", warning]
    assert files.module(tmp_path / "none.pl") == ""
    assert files.has_loaded(first)
    assert not files.has_loaded(tmp_path / "none.pl")
    files.loaded.clear()
    assert files.module(first) == ""
    with files.loading_file(second):
        assert files.record_module("m") == ""


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("eventrules.txt", ": did you mean eventRules.txt?"),
        ("event_rules.txt", ": did you mean eventRules.txt?"),
        ("other.pl", ""),
    ],
)
def test_missing_file_is_reported_with_similar_name(tmp_path: Path, name: str, hint: str) -> None:
    (tmp_path / "eventRules.txt").write_text("a <- b.")
    (tmp_path / "goalPredicates.txt").write_text(f"compile_event_file('{name}')")
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe/>")
    with pytest.raises(RetalisError) as caught:
        Engine().load_program(tmp_path)
    assert f"cannot read {tmp_path}/{name}: No such file or directory{hint}" in str(caught.value)
