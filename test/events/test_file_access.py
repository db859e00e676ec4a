"""File access of a program's goals, during loading and afterwards."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, Dict, Iterator, List, Tuple

import pytest
from recording_engine import RecordingEngine
from recording_reports import RecordingReports
from subprocess_python_path import python_path

from retalis import Engine, ProgramErrors, RetalisError, Settings, StreamClock, atom, functor, make_list
from retalis.prolog.terms.types import CONS, NIL

SRC = Path(__file__).resolve().parents[2] / "src"

REFUSED, MISSING, WRONG, TOO_LONG = (
    f"{name}_error" for name in ("permission", "existence", "domain", "representation")
)

SECRET = "tell(secret).\nsecret(1).\n"
"""A text that is valid both as goals and as clauses, so that each goal can load it."""


def unary_goal(name: str) -> Any:
    return lambda path: (functor(name, 1), atom(path))


LOADING_GOALS = {
    "consult": unary_goal("consult"),
    "consult_list": lambda path: (functor("consult", 1), make_list([atom(path)])),
    "list": lambda path: (CONS, atom(path), NIL),
    "use_module": unary_goal("use_module"),
    "use_module_2": lambda path: (functor("use_module", 2), atom(path), NIL),
    "ensure_loaded": unary_goal("ensure_loaded"),
}
"""Goals that find ``x.pl`` by the name ``x``."""

EXACT_GOALS = {
    name: unary_goal(name) for name in ("compile_event_file", "compile_events", "execute_event_stream_file")
}
INCLUDING_GOALS = {
    f"rules_{name}": lambda path, name=name: (
        functor("compile_event_rules", 1),
        make_list([(functor(":-", 1), (functor(name, 1), atom(path)))]),
    )
    for name in ("include", "ensure_loaded")
}
GOALS = {**LOADING_GOALS, **EXACT_GOALS, **INCLUDING_GOALS}


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Create the folder of a program with links out of it, a folder outside, and a working folder."""
    program, outside = tmp_path / "program", tmp_path / "outside"
    for folder in (program, program / "sub", outside, tmp_path / "here"):
        folder.mkdir()
    for path in (program / "in.pl", program / "sub" / "in.pl", outside / "secret.pl", outside / "in.pl"):
        path.write_text(SECRET)
    (program / "same.pl").symlink_to("sub/in.pl")
    (program / "link.pl").symlink_to(outside / "secret.pl")
    (program / "folder").symlink_to(outside)
    (program / "bare.pl").symlink_to("../outside/secret.pl")
    (program / "dangling.pl").symlink_to(outside / "none.pl")
    (program / "loop.pl").symlink_to("loop.pl")
    (program / "null.pl").symlink_to("/dev/null")
    os.mkfifo(str(program / "pipe.pl"))
    monkeypatch.chdir(tmp_path / "here")
    before = contents(outside), contents(tmp_path / "here")
    yield tmp_path
    assert (contents(outside), contents(tmp_path / "here")) == before


def contents(folder: Any) -> Dict[Any, Any]:
    return {path.name: (path.read_text(), path.stat().st_mtime_ns) for path in folder.iterdir()}


def cases(place: Any) -> Dict[str, Any]:
    """Return for each name the expected errors of a goal of an event and of a loading goal."""
    return {
        "in.pl": (None, None),
        "sub/../in.pl": (None, None),
        "same.pl": (None, None),
        str(place / "program" / "in.pl"): (None, None),
        "../outside/secret.pl": (REFUSED, None),
        "../program/in.pl": (None, None),
        "../outside/none.pl": (REFUSED, MISSING),
        "none.pl": (MISSING, MISSING),
        "in.pl/more.pl": (MISSING, MISSING),
        str(place / "outside" / "secret.pl"): (REFUSED, None),
        "/etc/hostname": (REFUSED, "any"),
        "link.pl": (REFUSED, None),
        "folder/secret.pl": (REFUSED, None),
        "folder/../program/in.pl": (None, None),
        "dangling.pl": (REFUSED, MISSING),
        "loop.pl": (REFUSED, REFUSED),
        "null.pl": (REFUSED, REFUSED),
        "/dev/zero": (REFUSED, REFUSED),
        "pipe.pl": (REFUSED, REFUSED),
        "sub": (REFUSED, REFUSED),
        "": (REFUSED, REFUSED),
        "a\0b.pl": (WRONG, WRONG),
        "../outside/secret.pl\0": (WRONG, WRONG),
        f"{chr(0xD800)}.pl": (WRONG, WRONG),
        f"{chr(0xDC80)}.pl": (WRONG, WRONG),
        "x" * 10_000: (TOO_LONG, TOO_LONG),
        "x/" * 5_000: (TOO_LONG, TOO_LONG),
    }


def engine_of(place: Any, **settings: Any) -> RecordingEngine:
    engine = RecordingEngine(clock=StreamClock(), allow_goals=True, **settings)
    engine.load(rules="secret(0). tell(X) :- event(X).", folder=place / "program")
    return engine


def was_read(engine: Any) -> bool:
    """Return whether a file has been loaded: its clause is defined, or its event was emitted."""
    return len(engine.query("secret(_)")) > 1 or "secret" in engine.event_texts


def unused_engine(engine: Any, place: Path) -> Any:
    """Return an engine that has read no file: the given one, or a new one if that has, or is None."""
    return engine_of(place) if engine is None or was_read(engine) else engine


def error_text(function: Any, *args: Any, **options: Any) -> str:
    """Return the text of the error that a call raises, or "" if it raises none."""
    try:
        function(*args, **options)
    except RetalisError as error:
        return str(error)
    return ""


ERROR_TEXTS = {
    REFUSED: "No permission to open source_sink",
    MISSING: "cannot read ",
    WRONG: "Domain error: `source_sink' expected",
    TOO_LONG: "Cannot represent due to `max_path_length'",
}


def check_access(engine: Any, expected_error: Any, text: Any, name: Any) -> None:
    if expected_error == "any":
        return
    assert was_read(engine) == (expected_error is None), name[:50]
    if expected_error is None:
        # Goals that are no clauses, and clauses that are no goals, have errors.
        assert not text or "secret" in text
    else:
        assert ERROR_TEXTS[expected_error] in text, name[:50]
        assert len(text) < 45_000


@pytest.mark.slow
@pytest.mark.parametrize("goal", GOALS)
def test_file_access_of_python_calls(place: Path, goal: Any) -> None:
    engine = None
    for name, (expected_error, _) in cases(place).items():
        for method in ("call", "query"):
            engine = unused_engine(engine, place)
            check_access(engine, expected_error, error_text(getattr(engine, method), GOALS[goal](name)), name)


TRIGGERS = ("do", "where", "clause", "subscription", "memory", "query", "text")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("goal", "trigger"),
    [
        *((goal, "do") for goal in GOALS),
        *(
            (goal, trigger)
            for goal in ("ensure_loaded", "execute_event_stream_file")
            for trigger in TRIGGERS[1:]
        ),
    ],
)
def test_file_access_of_goals_of_events(
    place: Path, caplog: pytest.LogCaptureFixture, goal: Any, trigger: Any
) -> None:
    for name, (expected_error, _) in cases(place).items():
        engine = engine_of(place)
        caplog.clear()
        assert engine.call((functor("nb_setval", 2), atom("goal"), (functor("t", 1), GOALS[goal](name))))
        run = "nb_getval(goal, t(G)), call(G)"
        rules = {
            "do": f"done do ({run}) <- in.",
            "where": f"done <- in where ({run}).",
            "clause": f"run :- {run}. done do run <- in.",
            "subscription": "",
            "memory": "",
            "query": f"run :- {run}. synchronized(done, run, []) <- in.",
            "text": "",
        }[trigger]
        if rules:
            engine.load(rules=rules)
        if trigger == "subscription":
            assert engine.call(f"subscribe(in, [({run})], _, topic, s)")
        if trigger == "memory":
            assert engine.call(f"memorize(in, [({run})], _, m, 10)")
        if trigger == "text":
            engine.post_text(run)
        else:
            engine.event("in", 1)
        check_access(engine, expected_error, caplog.text or None, name)


@pytest.mark.slow
@pytest.mark.parametrize("goal", GOALS)
def test_file_access_of_loading_goals(place: Path, goal: Any) -> None:
    engine = None
    for name, (_, expected_error) in cases(place).items():
        for place_of_goal in ("goals", "directive"):
            engine = unused_engine(engine, place)
            text = engine.logic.show(GOALS[goal](name))
            text = (
                text
                if "\\xD" not in text
                else text.replace("\\xD800\\", "\ud800").replace("\\xDC80\\", "\udc80")
            )
            program = {"goals": text} if place_of_goal == "goals" else {"rules": f":- {text}."}
            try:
                engine.load(source="r", folder=place / "program", **program)
                text_of_errors = None
                places: List[Any] = []
            except ProgramErrors as errors:
                text_of_errors = str(errors)
                places = [error.place for error in errors.errors]
            assert None not in places, name[:50]
            if expected_error is None and goal == "execute_event_stream_file":
                assert "secret" in engine.event_texts
            else:
                check_access(engine, expected_error, text_of_errors, name)


@pytest.mark.slow
@pytest.mark.parametrize("goal", LOADING_GOALS)
def test_added_suffix_does_not_extend_access(place: Path, goal: str) -> None:
    """A file that may not be opened by its name with the suffix may not be opened without it either."""
    program = place / "program"
    for name, expected_error in {
        "bare": REFUSED,
        "bare.pl": REFUSED,
        "dangling": REFUSED,
        "folder/secret": REFUSED,
        "../outside/secret": REFUSED,
        str(place / "outside" / "secret"): REFUSED,
        "in": None,
        "same": None,
        "pipe": MISSING,
        "y" * 254: MISSING,
    }.items():
        engine = engine_of(place)
        check_access(engine, expected_error, error_text(engine.call, GOALS[goal](name)), name)
        engine = RecordingEngine()
        engine.load(rules="secret(0). tell(X) :- event(X).")
        text_of_errors = error_text(engine.load, goals=engine.show(GOALS[goal](name)), folder=program)
        if expected_error is None or (expected_error is REFUSED and not name.startswith("dangling")):
            check_access(engine, None, text_of_errors, name)


@pytest.mark.slow
def test_files_loaded_by_files_are_restricted(place: Path) -> None:
    program = place / "program"
    for number, text in enumerate(
        (
            ":- ensure_loaded('../outside/secret.pl').",
            ":- include('../outside/secret.pl').",
            ":- ensure_loaded('sub/other.pl').",
            "use_module('link.pl').",
            ":- execute_event_stream_file('folder/secret.pl').",
        )
    ):
        (program / "sub" / "other.pl").write_text(":- compile_event_file('../../outside/secret.pl').")
        (program / f"more{number}.pl").write_text(text)
        engine = engine_of(place)
        assert "No permission to open source_sink" in error_text(engine.call, f"consult(more{number})")
        assert not was_read(engine)
        engine.load(goals=f"consult(more{number})", folder=program)
        assert was_read(engine)
        assert "No permission" in error_text(engine.call, "consult('../outside/in.pl')")


def test_names_are_relative_to_program_folder(place: Path) -> None:
    engine = engine_of(place)
    assert engine.call("exists_file('in.pl'), exists_file(\"sub/in.pl\"), consult(sub/in)")
    assert was_read(engine)
    (place / "here" / "new.pl").write_text("")
    assert not engine.call("exists_file('new.pl')")
    (place / "here" / "new.pl").unlink()


def test_exists_file_has_access_of_loading(place: Path) -> None:
    engine = engine_of(place)
    for name, (expected_error, _) in cases(place).items():
        goal = (functor("exists_file", 1), atom(name))
        irregular = name in ("pipe.pl", "sub", "")
        if expected_error in (None, MISSING) or irregular:
            assert engine.call(goal) == (expected_error is None)
        elif name == "loop.pl":
            # A link to itself has no target that could be checked; versions of Python report it differently.
            text = error_text(engine.call, goal)
            assert not text or "No permission to open" in text
        else:
            assert ERROR_TEXTS[expected_error] in error_text(engine.call, goal), name[:50]


def test_program_without_folder_reads_no_files(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(place / "program")
    engine = RecordingEngine()
    engine.load(rules=":- ensure_loaded(in). secret(0).")
    assert was_read(engine)
    for goal in ("ensure_loaded(sub/in)", "exists_file('in.pl')", f"exists_file('{place}/program/in.pl')"):
        assert "No permission to open source_sink" in error_text(engine.call, goal)


@pytest.mark.slow
def test_settings_allow_folders(place: Path) -> None:
    outside = f"'{place}/outside/secret.pl'"
    for settings in (
        {"folders": (str(place / "outside"),)},
        {"folders": (place / "outside",)},
        {"folders": (str(place / "program" / "folder"),)},
        {"folders": ("/",)},
        {"folders": None},
        {"write_folders": (str(place / "outside"),)},
        {"write_folders": None},
    ):
        engine = engine_of(place, **settings)
        assert engine.call(f"exists_file({outside}), consult({outside})")
        assert was_read(engine)
    beside = engine_of(place, folders=(str(place / "out"),))
    assert "No permission" in error_text(beside.call, f"consult({outside})")
    with pytest.raises(RetalisError, match="expected a list of folders"):
        Engine(settings=Settings(folders="/data"))  # type: ignore[arg-type]


def test_folder_of_loaded_file_is_not_allowed(place: Path) -> None:
    engine = engine_of(place)
    engine.load(goals="consult('../outside/in.pl')", folder=place / "program")
    assert "No permission" in error_text(engine.call, "consult('../outside/secret.pl')")


def test_large_files_are_refused(place: Path) -> None:
    with (place / "program" / "large.pl").open("wb") as file:
        file.truncate(1_000_001)
    engine = engine_of(place, max_file_megabytes=1)
    assert engine.call("catch(consult(large), error(resource_error(file_size), _), true)")
    assert "large.pl has more than 1000000 bytes" in error_text(engine.call, "consult(large)")
    assert "more than" in error_text(engine.load, goals="consult(large)", folder=place / "program")


# ---- writing -----------------------------------------------------------------------------------------------


def run_persistent_program(place: Any, **settings: Any) -> Tuple[Any, ...]:
    """Run a program with persistent events from its folder; return the engine and its warnings."""
    reports = RecordingReports()
    engine = engine_of(place, reports=reports, **settings)
    engine.load(rules="persistent_event(b(_)). b(X) <- a(X).", folder=place / "program")
    engine.event("a(1)", 1, 1)
    return engine, reports.texts


WRITTEN = "event(b(1),[1,1]).\n"


def test_no_file_is_written_by_default(place: Path) -> None:
    before = sorted(path.name for path in (place / "program").iterdir())
    _, (warning,) = run_persistent_program(place)
    assert warning.startswith(
        "1 persistent events could not be written: there is no folder that goals may write to"
    )
    assert sorted(path.name for path in (place / "program").iterdir()) == before


def test_loading_program_writes_to_its_folder(place: Path) -> None:
    engine = engine_of(place)
    engine.load(goals="assertz(persistent_event(b(_)))\nevent(b(1), [1,1])", folder=place / "program")
    assert (place / "program" / "persistent.txt").read_text() == WRITTEN
    engine.event("b(2)", 2, 2)
    assert (place / "program" / "persistent.txt").read_text() == WRITTEN
    # A program without a folder writes no file; the fixture checks the working folder.
    Engine().load(goals="assertz(persistent_event(b(_)))\nevent(b(1), [1,1])")


def make_link(path: Any, place: Any) -> None:
    path.symlink_to(place / "outside" / "secret.pl")


def make_dangling(path: Any, place: Any) -> None:
    path.symlink_to(place / "outside" / "new.txt")


def make_pipe(path: Any, place: Any) -> None:
    os.mkfifo(str(path))


def make_device(path: Any, place: Any) -> None:
    path.symlink_to("/dev/full")


@pytest.mark.parametrize(
    "make", [make_link, make_dangling, make_pipe, make_device, lambda path, place: path.mkdir()]
)
def test_special_file_is_not_written(place: Path, make: Any) -> None:
    folder = place / "out"
    folder.mkdir()
    make(folder / "persistent.txt", place)
    _, (warning,) = run_persistent_program(place, write_folders=(folder,))
    assert "No permission to open source_sink" in warning
    assert not (place / "outside" / "new.txt").exists()


def test_link_to_writable_file_is_followed(place: Path) -> None:
    folder = place / "out"
    (folder / "more").mkdir(parents=True)
    (folder / "persistent.txt").symlink_to("more/events.txt")
    assert run_persistent_program(place, write_folders=(folder,))[1] == []
    assert (folder / "more" / "events.txt").read_text() == WRITTEN


def test_file_beyond_size_limit_is_not_written(place: Path) -> None:
    folder = place / "out"
    folder.mkdir()
    path = folder / "persistent.txt"
    with path.open("wb") as file:
        file.truncate(999_990)
    _, (warning,) = run_persistent_program(place, write_folders=(folder,), max_file_megabytes=1)
    assert "would have more than 1000000 bytes" in warning
    assert path.stat().st_size == 999_990
    _, (warning,) = run_persistent_program(place, write_folders=(place / "missing",))
    assert "No such file or directory" in warning


def test_surrogate_in_event_is_written_as_escape(place: Path) -> None:
    folder = place / "out"
    folder.mkdir()
    engine, warnings = run_persistent_program(place, write_folders=(folder,))
    engine.event((functor("a", 1), atom("\ud800")), 2, 2)
    assert warnings == []
    assert (folder / "persistent.txt").read_text() == WRITTEN + "event(b('\\xD800\\'),[2,2]).\n"


# ---- replaced between the check and the opening ---------------------------------------------------------------


def swap_file(path: Any, outside: Any) -> None:
    if path.exists():
        path.rename(path.with_name("away"))
    path.symlink_to(outside / path.name)


def swap_folder(path: Any, outside: Any) -> None:
    path.parent.rename(path.parent.with_name("away"))
    path.parent.symlink_to(outside)


def swap_pipe(path: Any, outside: Any) -> None:
    path.unlink()
    os.mkfifo(str(path))


@pytest.mark.slow
@pytest.mark.parametrize("swap", [swap_file, swap_folder, swap_pipe])
@pytest.mark.parametrize("hook", ["lstat", "open"])
@pytest.mark.parametrize("goal", GOALS)
def test_file_replaced_before_opening_is_not_read(
    place: Path, monkeypatch: pytest.MonkeyPatch, goal: Any, swap: Any, hook: str
) -> None:
    engine = engine_of(place)
    path = place / "program" / "sub" / "in.pl"
    real = getattr(os, hook)
    calls: List[Any] = []

    def swapping(opened: Any, *arguments: Any, **named: Any) -> Any:
        if opened == str(path) and not calls:
            calls.append(opened)
            swap(path, place / "outside")
        return real(opened, *arguments, **named)

    with monkeypatch.context() as patch:
        patch.setattr(f"retalis.prolog.files.file_sandbox.os.{hook}", swapping)
        text = error_text(engine.call, GOALS[goal]("sub/in.pl"))
    assert calls
    assert "No permission to open source_sink" in text
    assert not was_read(engine)


@pytest.mark.parametrize("is_there", [False, True])
@pytest.mark.parametrize("swap", [swap_file, swap_folder])
@pytest.mark.parametrize("calls_before", [0, 1])
def test_file_replaced_before_opening_is_not_written(
    place: Path, monkeypatch: pytest.MonkeyPatch, swap: Any, is_there: bool, calls_before: int
) -> None:
    folder = place / "out"
    folder.mkdir()
    path = folder / "persistent.txt"
    if is_there:
        path.write_text("")
    real = os.open
    calls: List[Any] = []

    def swapping(opened: Any, *arguments: Any, **named: Any) -> Any:
        if len(calls) == calls_before:
            swap(path, place / "outside")
        calls.append(opened)
        return real(opened, *arguments, **named)

    with monkeypatch.context() as patch:
        patch.setattr("retalis.prolog.files.file_sandbox.os.open", swapping)
        run_persistent_program(place, write_folders=(folder,))
    assert calls  # the fixture checks that no file outside has changed


# ---- every file that is opened -------------------------------------------------------------------------------

SCRIPT = """
import json, os, sys
from events.test_file_access import GOALS, cases, engine_of, unary_goal
from pathlib import Path
from recording_reports import RecordingReports
from retalis import RetalisError, atom, functor

place = Path(sys.argv[1])
names = list(cases(place)) + ["bare", "in", "folder/secret", "../outside/secret"]
goals = {**GOALS, "exists_file": unary_goal("exists_file"), "use_foreign": unary_goal("use_foreign")}
opened, watching = [], False

def audit(event, arguments):
    if watching and event in ("open", "os.listdir", "os.scandir", "os.mkdir", "os.remove", "os.rename",
                              "os.truncate", "subprocess.Popen", "os.system", "import", "os.exec"):
        opened.append((event, str(arguments[0])))

sys.addaudithook(audit)
engine = engine_of(place, allow_foreign=True, reports=RecordingReports())
engine.load(rules="persistent_event(_). done do (nb_getval(goal, t(G)), call(G)) <- in.", folder=place / "program")

def run():
    for goal in goals.values():
        for name in names:
            engine.call((functor("nb_setval", 2), atom("goal"), (functor("t", 1), goal(name))))
            engine.event("in", 1)

run()  # imports and compilation at first use are not recorded
watching = True
run()
watching = False
print(json.dumps(opened))
"""


@pytest.mark.slow
def test_goals_open_files_of_program_folder_only(place: Path) -> None:
    process = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(place)],
        env={
            "PYTHONPATH": python_path(SRC.parent / "test"),
            "PATH": os.environ["PATH"],
        },
        capture_output=True,
        timeout=300,
    )
    assert process.returncode == 0, process.stderr.decode()
    opened = [tuple(entry) for entry in json.loads(process.stdout.decode())]
    files = {name for event, name in opened if not name.isdigit()}  # numbers are open file descriptors
    program = place / "program"
    assert files == {str(program / "in.pl"), str(program / "sub" / "in.pl")}
    assert {event for event, _ in opened} == {"open"}


# ---- streams ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("goal", ["open(F, read, S), read(S, _), close(S)", "see(F), read(_), seen"])
def test_streams_read_files_that_may_be_loaded(place: Path, goal: str) -> None:
    engine = engine_of(place)
    for name, (expected_error, _) in cases(place).items():
        if expected_error is None:
            assert engine.query(goal.replace("F", engine.show(atom(name)))), name[:50]
        elif (
            expected_error != "any"
            and chr(0xD800) not in name
            and chr(0xDC80) not in name
            and "\0" not in name
        ):
            text = error_text(engine.query, goal.replace("F", engine.show(atom(name))))
            assert ERROR_TEXTS[expected_error] in (text or ""), name[:50]


WRITING_GOALS = [
    "open(F, write, S), write(S, x), close(S)",
    "open(F, append, S), close(S)",
    "tell(F), write(x), told",
]


@pytest.mark.parametrize("goal", WRITING_GOALS)
def test_streams_write_to_allowed_folders_only(place: Path, goal: str) -> None:
    (place / "out").mkdir()
    (place / "out" / "way.txt").symlink_to(place / "outside" / "in.pl")
    (place / "out" / "away").symlink_to(place / "outside")
    goal = goal.replace("tell(", "append(") if "tell" in goal else goal  # the program defines its own tell/1
    refused, allowed = engine_of(place), engine_of(place, write_folders=[place / "out"])
    for name in ("new.txt", str(place / "out" / "new.txt")):
        assert ERROR_TEXTS[REFUSED] in str(error_text(refused.query, goal.replace("F", f"'{name}'")))
    for name in ("new.txt", "../outside/in.pl", "../out/way.txt", "../out/away/new.txt", "/dev/null"):
        assert ERROR_TEXTS[REFUSED] in str(error_text(allowed.query, goal.replace("F", f"'{name}'")))
    assert not (place / "program" / "new.txt").exists()
    assert allowed.query(goal.replace("F", "'../out/new.txt'"))
    assert (place / "out" / "new.txt").read_text() == (
        "" if "close(S)" in goal and "write(S" not in goal else "x"
    )


def test_size_of_text_files_is_limited(place: Path) -> None:
    (place / "program" / "large.txt").write_text("p(1).\n" * 1000)
    engine = engine_of(place)
    engine.rules.files.sandbox.max_bytes = 5999
    text = error_text(engine.query, "open('large.txt', read, _)")
    assert "more than 5999 bytes" in (text or "")
    engine.rules.files.sandbox.max_bytes = 6000
    assert engine.query("open('large.txt', read, _)")
