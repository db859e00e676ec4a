"""SWI-Prolog for these tests. Without RETALIS_TEST_SWI=1 they are skipped; with it they fail if it is missing."""

import os
from pathlib import Path
from typing import Any

import pytest

from retalis import Engine, Limits, Settings, UsageError
from retalis.prolog.swi.libswipl import SwiLibrary, find_library

SWI_VARIABLE = "RETALIS_TEST_SWI"
"""Environment variable that enables these tests."""

KB = """\
:- module(kb, [inc/2, upto/2, echo/2, forever/0, stubborn/0, retrying/0, sleeps/0, bad/1, hard/1, piles/0,
               third/1, stream/1, constrained/1, curious/1, cyclic/1, asks/2, asks_safely/2, marks/2, noted/1,
               halts/0, swi_dict/1, both/2, half_open/2, reach/2, count/2, forgets/0, fd/2,
               engines/1, pokes/1, pokes_later/1]).
:- use_module(library(clpfd)).
:- use_module(library(process)).
:- dynamic noted/1.
inc(X, Y) :- Y is X + 1.
upto(N, X) :- between(1, N, X).
echo(X, X).
both(X, X).
half_open(X, f(X, Y, Y)).
forever :- forever.
stubborn :- catch(forever, _, true), stubborn.
retrying :- repeat, catch(forever, _, fail).
sleeps :- sleep(60).
bad(X) :- throw(my_ball(X, "text", _)).
hard(X) :- atom_length(X, _).
piles :- between(1, inf, X), assertz(noted(f(X, "some text that takes room", g(X)))), fail.
third(X) :- X is 1 rdiv 3.
stream(X) :- current_output(X).
constrained(X) :- X #> 3.
curious(X) :- X = f().
cyclic(X) :- X = f(X).
asks(Goal, Found) :- findall(Goal, retalis(Goal), Found).
asks_safely(Goal, Error) :- catch(retalis(Goal), Error, true).
marks(X, Y) :- setup_call_cleanup(true, member(X, [1, 2, 3]), assertz(noted(Y))).
halts :- halt.
swi_dict(X) :- X = _{a: 1}.
fd(X, Y) :- [X, Y] ins 1..3, X #< Y, label([X, Y]).
edge(X, Y) :- between(1, 40, X), Y is X + 1.
:- table reach/2.
reach(X, Y) :- edge(X, Y).
reach(X, Y) :- reach(X, Z), edge(Z, Y).
count(X, N) :- aggregate_all(count, reach(X, _), N).
forgets :- retractall(noted(_)).
engines(X) :- engine_create(A, member(A, [1, 2]), E), engine_next(E, X), engine_destroy(E).
poke :- current_prolog_flag(pid, P), process_kill(P, alrm).
pokes(X) :- poke, retalis(near(a, X)).
pokes_later(X) :- retalis(near(a, X)), poke, X == c.
"""


@pytest.fixture(scope="session")
def swi() -> SwiLibrary:
    """Return the library of SWI-Prolog; fail if these tests are enabled and it is missing."""
    try:
        return find_library()
    except UsageError as error:
        if os.environ.get(SWI_VARIABLE):
            pytest.fail(f"{SWI_VARIABLE} is set: {error}")
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def folder(swi: SwiLibrary, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the file for SWI-Prolog; all tests of the process share both."""
    path = tmp_path_factory.mktemp("swi")
    (path / "kb.pl").write_text(KB)
    return path


@pytest.fixture
def program(folder: Path) -> Any:
    """Return a function that creates an engine with the file for SWI-Prolog and rules."""

    def make(rules: str = "", **limits: Any) -> Engine:
        engine = Engine(settings=Settings(allow_swi=True))
        engine.load(rules=f":- use_swi('kb.pl').\n{rules}", folder=folder)
        engine.logic.limits = Limits(**limits)  # after loading, which has no limits
        return engine

    return make


@pytest.fixture
def engine(program: Any) -> Any:
    return program("near(a, b).\nnear(a, c).\n")


def pytest_collection_modifyitems(items: Any) -> None:
    """Skip these tests outside a process of their own.

    SWI-Prolog and its signal handlers stay until the process ends.
    """
    if os.environ.get(SWI_VARIABLE):
        return
    skip = pytest.mark.skip(reason=f"in a process of their own: {SWI_VARIABLE}=1 pytest test/prolog/swi")
    for item in items:
        if "prolog/swi/" in item.nodeid:
            item.add_marker(skip)
