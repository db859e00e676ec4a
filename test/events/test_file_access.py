"""File access of a program's goals, during loading and afterwards."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from python_path import python_path

from retalis import Engine, ProgramErrors, RetalisError, Settings, StreamClock, atom, functor, make_list
from retalis.prolog.terms.types import CONS, NIL

SRC = Path(__file__).resolve().parents[2] / "src"

REFUSED, MISSING, WRONG, TOO_LONG = (
    f"{name}_error" for name in ("permission", "existence", "domain", "representation")
)

SECRET = "tell(secret).\nsecret(1).\n"
"""Goals as well as clauses: every goal that reads a file can do something with it."""


def one(name):
    return lambda path: (functor(name, 1), atom(path))


LOADING = {
    "consult": one("consult"),
    "consult_list": lambda path: (functor("consult", 1), make_list([atom(path)])),
    "list": lambda path: (CONS, atom(path), NIL),
    "use_module": one("use_module"),
    "use_module_2": lambda path: (functor("use_module", 2), atom(path), NIL),
    "ensure_loaded": one("ensure_loaded"),
}
"""Goals that find ``x.pl`` by ``x``."""

EXACT = {name: one(name) for name in ("compile_event_file", "compile_events", "execute_event_stream_file")}
INCLUDING = {
    f"rules_{name}": lambda path, name=name: (
        functor("compile_event_rules", 1),
        make_list([(functor(":-", 1), (functor(name, 1), atom(path)))]),
    )
    for name in ("include", "ensure_loaded")
}
GOALS = {**LOADING, **EXACT, **INCLUDING}


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Make a program's folder with ways out of it, a folder outside, and another one to work in."""
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


def contents(folder):
    return {path.name: (path.read_text(), path.stat().st_mtime_ns) for path in folder.iterdir()}


def cases(place):
    """Return for each name what a goal of an event says to it, and one of a program that is loaded."""
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


def engine_of(place, **settings):
    engine = Engine(StreamClock(), Settings(allow_goals=True, **settings))
    engine.load(rules="secret(0). tell(X) :- event(X).", folder=place / "program")
    return engine


def was_read(engine):
    """Tell whether a file has been taken in: its clause is there, or its event was fired."""
    return len(engine.query("secret(_)")) > 1 or "secret" in engine.fired


def watch(engine):
    engine.fired = []
    engine.on_event(lambda term, start, end: engine.fired.append(engine.show(term)))
    return engine


def told(work):
    """Return the text of the error that work raises, None where it raises none."""
    try:
        work()
    except RetalisError as error:
        return str(error)
    return None


KINDS = {
    REFUSED: "No permission to open source_sink",
    MISSING: "cannot read ",
    WRONG: "Domain error: `source_sink' expected",
    TOO_LONG: "Cannot represent due to `max_path_length'",
}


def check(engine, wanted, text, name):
    if wanted == "any":
        return
    assert was_read(engine) == (wanted is None), name[:50]
    if wanted is None:
        assert (
            text is None or "secret" in text
        )  # it has goals that are no clauses, or clauses that are no goals
    else:
        assert KINDS[wanted] in text, name[:50]
        assert len(text) < 45_000


@pytest.mark.slow
@pytest.mark.parametrize("goal", GOALS)
def test_called_by_the_python_program(place, goal):
    for name, (wanted, _) in cases(place).items():
        for way in ("call", "query"):
            engine = watch(engine_of(place))
            check(engine, wanted, told(lambda: getattr(engine, way)(GOALS[goal](name))), name)  # noqa: B023


WAYS = ("do", "where", "clause", "subscription", "memory", "query", "text")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("goal", "way"),
    [
        *((goal, "do") for goal in GOALS),
        *((goal, way) for goal in ("ensure_loaded", "execute_event_stream_file") for way in WAYS[1:]),
    ],
)
def test_called_by_what_an_event_leads_to(place, caplog, goal, way):
    for name, (wanted, _) in cases(place).items():
        engine = watch(engine_of(place))
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
        }[way]
        if rules:
            engine.load(rules=rules)
        if way == "subscription":
            assert engine.call(f"subscribe(in, [({run})], _, topic, s)")
        if way == "memory":
            assert engine.call(f"memorize(in, [({run})], _, m, 10)")
        if way == "text":
            engine.post_text(run)
        else:
            engine.event("in", 1)
        check(engine, wanted, caplog.text or None, name)


@pytest.mark.slow
@pytest.mark.parametrize("goal", GOALS)
def test_called_while_the_program_is_loaded(place, goal):
    for name, (_, wanted) in cases(place).items():
        for way in ("goals", "directive"):
            engine = watch(engine_of(place))
            text = engine.logic.show(GOALS[goal](name))
            text = (
                text
                if "\\xD" not in text
                else text.replace("\\xD800\\", "\ud800").replace("\\xDC80\\", "\udc80")
            )
            given = {"goals": text} if way == "goals" else {"rules": f":- {text}."}
            try:
                engine.load(source="r", folder=place / "program", **given)
                found = None
            except ProgramErrors as errors:
                found = str(errors)
                assert all(error.place is not None for error in errors.errors), name[:50]
            if wanted is None and goal == "execute_event_stream_file":
                assert "secret" in engine.fired
            else:
                check(engine, wanted, found, name)


@pytest.mark.slow
@pytest.mark.parametrize("goal", LOADING)
def test_an_ending_that_is_added_leads_nowhere_else(place, goal):
    """What a program may not open with the ending it may not open without it."""
    program = place / "program"
    for name, wanted in {
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
        engine = watch(engine_of(place))
        check(engine, wanted, told(lambda: engine.call(GOALS[goal](name))), name)  # noqa: B023
        engine = watch(Engine())
        engine.load(rules="secret(0). tell(X) :- event(X).")
        loaded = told(lambda: engine.load(goals=engine.show(GOALS[goal](name)), folder=program))  # noqa: B023
        if wanted is None or (wanted is REFUSED and not name.startswith("dangling")):
            check(engine, None, loaded, name)


@pytest.mark.slow
def test_files_of_files_that_goals_load_are_as_restricted(place):
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
        engine = watch(engine_of(place))
        assert "No permission to open source_sink" in told(lambda: engine.call(f"consult(more{number})"))  # noqa: B023
        assert not was_read(engine)
        engine.load(goals=f"consult(more{number})", folder=program)
        assert was_read(engine)
        assert "No permission" in told(lambda: engine.call("consult('../outside/in.pl')"))  # noqa: B023


def test_names_of_goals_start_in_the_programs_folder(place):
    engine = watch(engine_of(place))
    assert engine.call("exists_file('in.pl'), exists_file(\"sub/in.pl\"), consult(sub/in)")
    assert was_read(engine)
    (place / "here" / "new.pl").write_text("")
    assert not engine.call("exists_file('new.pl')")
    (place / "here" / "new.pl").unlink()


def test_exists_file(place):
    engine = engine_of(place)
    for name, (wanted, loading) in cases(place).items():
        goal = (functor("exists_file", 1), atom(name))
        irregular = name in ("pipe.pl", "sub", "")
        if wanted in (None, MISSING) or irregular:
            assert engine.call(goal) == (wanted is None)
        else:
            found = told(lambda: engine.call(goal))  # noqa: B023
            assert ("No permission to open" if name == "loop.pl" else KINDS[wanted]) in (
                found or "No permission to open"
            )
            assert name == "loop.pl" or found
        del loading


def test_a_program_without_a_folder_reads_nothing_later(place, monkeypatch):
    monkeypatch.chdir(place / "program")
    engine = watch(Engine())
    engine.load(rules=":- ensure_loaded(in). secret(0).")
    assert was_read(engine)
    for goal in ("ensure_loaded(sub/in)", "exists_file('in.pl')", f"exists_file('{place}/program/in.pl')"):
        assert "No permission to open source_sink" in told(lambda: engine.call(goal))  # noqa: B023


@pytest.mark.slow
def test_settings_allow_folders(place):
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
        engine = watch(engine_of(place, **settings))
        assert engine.call(f"exists_file({outside}), consult({outside})")
        assert was_read(engine)
    beside = engine_of(place, folders=(str(place / "out"),))
    assert "No permission" in told(lambda: beside.call(f"consult({outside})"))
    with pytest.raises(RetalisError, match="expected a list of folders"):
        Engine(settings=Settings(folders="/data"))


def test_a_folder_of_files_that_the_program_names_is_not_its_own(place):
    engine = engine_of(place)
    engine.load(goals="consult('../outside/in.pl')", folder=place / "program")
    assert "No permission" in told(lambda: engine.call("consult('../outside/secret.pl')"))


def test_large_files_are_not_read(place):
    with (place / "program" / "large.pl").open("wb") as file:
        file.truncate(1_000_001)
    engine = engine_of(place, max_file_megabytes=1)
    assert engine.call("catch(consult(large), error(resource_error(file_size), _), true)")
    assert "large.pl has more than 1000000 bytes" in told(lambda: engine.call("consult(large)"))
    assert "more than" in told(lambda: engine.load(goals="consult(large)", folder=place / "program"))


# ---- writing -----------------------------------------------------------------------------------------------


def persistent(place, **settings):
    """Run a program with persistent events from its folder; return it and its warnings."""
    engine = engine_of(place, **settings)
    warnings = []
    engine.rules.on_warning = lambda warning: warnings.append(str(warning))
    engine.load(rules="persistent_event(b(_)). b(X) <- a(X).", folder=place / "program")
    engine.event("a(1)", 1, 1)
    return engine, warnings


WRITTEN = "event(b(1),[1,1]).\n"


def test_nothing_is_written_by_default(place):
    before = sorted(path.name for path in (place / "program").iterdir())
    _, (warning,) = persistent(place)
    assert warning.startswith(
        "1 persistent events could not be written: there is no folder that goals may write to"
    )
    assert sorted(path.name for path in (place / "program").iterdir()) == before


def test_while_it_is_loaded_a_program_writes_into_its_own_folder(place):
    engine = engine_of(place)
    engine.load(goals="assertz(persistent_event(b(_)))\nevent(b(1), [1,1])", folder=place / "program")
    assert (place / "program" / "persistent.txt").read_text() == WRITTEN
    engine.event("b(2)", 2, 2)
    assert (place / "program" / "persistent.txt").read_text() == WRITTEN
    unplaced = Engine()
    unplaced.load(goals="assertz(persistent_event(b(_)))\nevent(b(1), [1,1])")


def make_link(path, place):
    path.symlink_to(place / "outside" / "secret.pl")


def make_dangling(path, place):
    path.symlink_to(place / "outside" / "new.txt")


def make_pipe(path, place):
    os.mkfifo(str(path))


def make_device(path, place):
    path.symlink_to("/dev/full")


@pytest.mark.parametrize(
    "make", [make_link, make_dangling, make_pipe, make_device, lambda path, place: path.mkdir()]
)
def test_what_is_written_goes_through_nothing(place, make):
    folder = place / "out"
    folder.mkdir()
    make(folder / "persistent.txt", place)
    _, (warning,) = persistent(place, write_folders=(folder,))
    assert "No permission to open source_sink" in warning
    assert not (place / "outside" / "new.txt").exists()


def test_a_link_to_a_file_that_may_be_written_is_followed(place):
    folder = place / "out"
    (folder / "more").mkdir(parents=True)
    (folder / "persistent.txt").symlink_to("more/events.txt")
    assert persistent(place, write_folders=(folder,))[1] == []
    assert (folder / "more" / "events.txt").read_text() == WRITTEN


def test_what_has_no_room_is_not_written(place):
    folder = place / "out"
    folder.mkdir()
    path = folder / "persistent.txt"
    with path.open("wb") as file:
        file.truncate(999_990)
    _, (warning,) = persistent(place, write_folders=(folder,), max_file_megabytes=1)
    assert "would have more than 1000000 bytes" in warning
    assert path.stat().st_size == 999_990
    _, (warning,) = persistent(place, write_folders=(place / "missing",))
    assert "No such file or directory" in warning


def test_a_surrogate_in_an_event_is_written_as_its_escape(place):
    folder = place / "out"
    folder.mkdir()
    engine, warnings = persistent(place, write_folders=(folder,))
    engine.event((functor("a", 1), atom("\ud800")), 2, 2)
    assert warnings == []
    assert (folder / "persistent.txt").read_text() == WRITTEN + "event(b('\\xD800\\'),[2,2]).\n"


# ---- swapped between the check and the opening ---------------------------------------------------------------


def swap_file(path, outside):
    if path.exists():
        path.rename(path.with_name("away"))
    path.symlink_to(outside / path.name)


def swap_folder(path, outside):
    path.parent.rename(path.parent.with_name("away"))
    path.parent.symlink_to(outside)


def swap_pipe(path, outside):
    path.unlink()
    os.mkfifo(str(path))


@pytest.mark.slow
@pytest.mark.parametrize("swap", [swap_file, swap_folder, swap_pipe])
@pytest.mark.parametrize("hook", ["lstat", "open"])
@pytest.mark.parametrize("goal", GOALS)
def test_what_is_swapped_before_it_is_opened_is_not_read(place, monkeypatch, goal, swap, hook):
    engine = watch(engine_of(place))
    path = place / "program" / "sub" / "in.pl"
    real = getattr(os, hook)
    calls = []

    def swapping(opened, *arguments, **named):
        if opened == str(path) and not calls:
            calls.append(opened)
            swap(path, place / "outside")
        return real(opened, *arguments, **named)

    with monkeypatch.context() as patch:
        patch.setattr(f"retalis.prolog.files.file_sandbox.os.{hook}", swapping)
        text = told(lambda: engine.call(GOALS[goal]("sub/in.pl")))
    assert calls
    assert "No permission to open source_sink" in text
    assert not was_read(engine)


@pytest.mark.parametrize("is_there", [False, True])
@pytest.mark.parametrize("swap", [swap_file, swap_folder])
@pytest.mark.parametrize("calls_before", [0, 1])
def test_what_is_swapped_before_it_is_opened_is_not_written(place, monkeypatch, swap, is_there, calls_before):
    folder = place / "out"
    folder.mkdir()
    path = folder / "persistent.txt"
    if is_there:
        path.write_text("")
    real = os.open
    calls = []

    def swapping(opened, *arguments, **named):
        if len(calls) == calls_before:
            swap(path, place / "outside")
        calls.append(opened)
        return real(opened, *arguments, **named)

    with monkeypatch.context() as patch:
        patch.setattr("retalis.prolog.files.file_sandbox.os.open", swapping)
        persistent(place, write_folders=(folder,))
    assert calls  # and nothing outside has changed


# ---- every file that is opened -------------------------------------------------------------------------------

SCRIPT = """
import json, os, sys
from events.test_file_access import GOALS, cases, engine_of, one
from pathlib import Path
from retalis import RetalisError, atom, functor

place = Path(sys.argv[1])
names = list(cases(place)) + ["bare", "in", "folder/secret", "../outside/secret"]
goals = {**GOALS, "exists_file": one("exists_file"), "use_foreign": one("use_foreign")}
opened, watching = [], False

def audit(event, arguments):
    if watching and event in ("open", "os.listdir", "os.scandir", "os.mkdir", "os.remove", "os.rename",
                              "os.truncate", "subprocess.Popen", "os.system", "import", "os.exec"):
        opened.append((event, str(arguments[0])))

sys.addaudithook(audit)
engine = engine_of(place, allow_foreign=True)
engine.reports.error = engine.rules.on_error = lambda error, kind=None: None
engine.load(rules="persistent_event(_). done do (nb_getval(goal, t(G)), call(G)) <- in.", folder=place / "program")

def run():
    for goal in goals.values():
        for name in names:
            engine.call((functor("nb_setval", 2), atom("goal"), (functor("t", 1), goal(name))))
            engine.event("in", 1)

run()  # what Python imports and the engine compiles at its first use
watching = True
run()
watching = False
print(json.dumps(opened))
"""


@pytest.mark.slow
def test_goals_of_events_open_nothing_but_files_of_the_programs_folder(place):
    found = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(place)],
        env={
            "PYTHONPATH": python_path(SRC.parent / "test"),
            "PATH": os.environ["PATH"],
        },
        capture_output=True,
        timeout=300,
    )
    assert found.returncode == 0, found.stderr.decode()
    opened = [tuple(one) for one in json.loads(found.stdout.decode())]
    files = {name for event, name in opened if not name.isdigit()}  # a number is a file that is open already
    program = place / "program"
    assert files == {str(program / "in.pl"), str(program / "sub" / "in.pl")}
    assert {event for event, _ in opened} == {"open"}


# ---- streams ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("goal", ["open(F, read, S), read(S, _), close(S)", "see(F), read(_), seen"])
def test_a_goal_reads_where_it_may_load(place, goal):
    engine = engine_of(place)
    for name, (wanted, _) in cases(place).items():
        if wanted is None:
            assert engine.query(goal.replace("F", engine.show(atom(name)))), name[:50]
        elif wanted != "any" and chr(0xD800) not in name and chr(0xDC80) not in name and "\0" not in name:
            text = told(lambda: engine.query(goal.replace("F", engine.show(atom(name)))))  # noqa: B023
            assert text is not None and KINDS[wanted] in text, name[:50]


WRITING = [
    "open(F, write, S), write(S, x), close(S)",
    "open(F, append, S), close(S)",
    "tell(F), write(x), told",
]


@pytest.mark.parametrize("goal", WRITING)
def test_a_goal_writes_only_where_a_folder_is_named(place, goal):
    (place / "out").mkdir()
    (place / "out" / "way.txt").symlink_to(place / "outside" / "in.pl")
    (place / "out" / "away").symlink_to(place / "outside")
    goal = (
        goal.replace("tell(", "append(") if "tell" in goal else goal
    )  # the program here has a tell/1 of its own
    refused, allowed = engine_of(place), engine_of(place, write_folders=[place / "out"])
    for name in ("new.txt", str(place / "out" / "new.txt")):
        assert KINDS[REFUSED] in str(told(lambda: refused.query(goal.replace("F", f"'{name}'"))))  # noqa: B023
    for name in ("new.txt", "../outside/in.pl", "../out/way.txt", "../out/away/new.txt", "/dev/null"):
        assert KINDS[REFUSED] in str(told(lambda: allowed.query(goal.replace("F", f"'{name}'"))))  # noqa: B023
    assert not (place / "program" / "new.txt").exists()
    assert allowed.query(goal.replace("F", "'../out/new.txt'"))
    assert (place / "out" / "new.txt").read_text() == (
        "" if "close(S)" in goal and "write(S" not in goal else "x"
    )


def test_a_text_that_is_read_is_bounded(place):
    (place / "program" / "large.txt").write_text("p(1).\n" * 1000)
    engine = engine_of(place)
    engine.rules.files.sandbox.max_bytes = 5999
    text = told(lambda: engine.query("open('large.txt', read, _)"))
    assert text is not None and "more than 5999 bytes" in text
    engine.rules.files.sandbox.max_bytes = 6000
    assert engine.query("open('large.txt', read, _)")
