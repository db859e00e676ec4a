"""Parts of file names, and resolution of files."""

from pathlib import Path
from typing import Optional

import pytest
from prolog.goal_answers import answers, first, prolog

from retalis import Engine, Settings
from retalis.prolog.system.prolog_system import PrologSystem


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ("file_base_name('/a/b.pl', X)", "'b.pl'"),
        ("file_base_name('/a/b/', X)", "b"),
        ("file_base_name(/, X)", "/"),
        ("file_base_name('', X)", "''"),
        ('file_base_name("x/y", X)', "y"),
        ("file_directory_name('/a/b.pl', X)", "'/a'"),
        ("file_directory_name('/a/b/', X)", "'/a'"),
        ("file_directory_name('/a', X)", "/"),
        ("file_directory_name(a, X)", "'.'"),
        ("file_directory_name('', X)", "'.'"),
        ("file_name_extension(X, pl, 'a.b.pl')", "'a.b'"),
        ("file_name_extension(X, '.pl', 'a.pl')", "a"),
        ("file_name_extension(X, txt, 'a.pl')", None),
        ("file_name_extension(a, X, 'a.pl')", "pl"),
        ("file_name_extension(X, _, 'x.y/a')", "'x.y/a'"),
        ("file_name_extension(X, '', a)", "a"),
        ("file_name_extension(a, pl, X)", "'a.pl'"),
        ("file_name_extension('a.pl', '.pl', X)", "'a.pl'"),
        ("file_name_extension(a, '', X)", "a"),
        ("directory_file_path(a, b, X)", "'a/b'"),
        ("directory_file_path('a/', b, X)", "'a/b'"),
        ("directory_file_path('.', b, X)", "b"),
        ("directory_file_path(a, '/b', X)", "'/b'"),
        ("directory_file_path(X, b, 'a/b')", "a"),
        ("directory_file_path(a, X, 'a/b')", "b"),
        ("directory_file_path(a, X, 'a/b/c')", "'b/c'"),
        ("directory_file_path('a/', X, 'a/b')", "b"),
        ("directory_file_path(/, X, '/a')", "a"),
        ("directory_file_path('.', X, 'a/b')", "'a/b'"),
        ("directory_file_path('.', X, '/a')", None),
        ("directory_file_path(a, X, 'ab')", None),
        ("directory_file_path(\"a\", X, 'a/b')", "b"),
        ("directory_file_path(X, \"b\", 'a/b')", "a"),
        ("directory_file_path(X, b, '/b')", "/"),
        ("directory_file_path(X, b, b)", "'.'"),
        ("directory_file_path(X, b, ab)", None),
        ("directory_file_path(X, b, 'a/b/')", None),
        ("directory_file_path(X, b, 'a//b')", "a"),
        ("directory_file_path(X, b, 'a/c/b')", "'a/c'"),
        ("directory_file_path(_, X, 'a/b/')", "b"),
        ("directory_file_path(X, _, 'a/b/')", "a"),
        ("directory_file_path(_, X, /)", "/"),
        ('directory_file_path(a, b, "a/b"), X = yes', "yes"),
        ("is_absolute_file_name('/a'), \\+ is_absolute_file_name(a), X = yes", "yes"),
    ],
)
def test_file_name_has_parts(goal: str, expected: Optional[str]) -> None:
    assert first(prolog(), goal) == expected


@pytest.mark.parametrize(
    ("goal", "error"),
    [
        ("file_base_name(_, _)", "instantiation_error"),
        ("file_directory_name(f(x), _)", "type_error(text,f(x))"),
        ("file_name_extension(_, _, _)", "instantiation_error"),
        ("absolute_file_name(a, _)", "permission_error(access,source_sink,'.')"),
        ("exists_directory(a)", "permission_error(access,source_sink,'.')"),
    ],
)
def test_invalid_file_name_is_an_error(goal: str, error: str) -> None:
    assert answers(prolog(), goal) == [error]


@pytest.fixture
def logic(tmp_path: Path) -> PrologSystem:
    (tmp_path / "kb.pl").write_text("p(1).\n")
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "hall.pl").write_text("room(hall).\n")
    engine = Engine(settings=Settings(folders=(str(tmp_path),)))
    engine.load_program(tmp_path / "kb.pl")
    return engine.logic


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ("absolute_file_name('maps/../kb.pl', X)", "/kb.pl"),
        ("absolute_file_name('maps/', X)", "/maps/"),
        ("absolute_file_name(maps/hall, X, [file_type(prolog), access(read)])", "/maps/hall.pl"),
        ("absolute_file_name(kb, [extensions([pl])], X)", "/kb.pl"),
        ("absolute_file_name(maps, X, [file_type(directory), access(exist)])", "/maps"),
        ("absolute_file_name('.', X, [relative_to('/other')])", "other"),
        ("absolute_file_name('hall.pl', X, [relative_to(maps)])", "/maps/hall.pl"),
    ],
)
def test_file_name_is_resolved_in_program_folder(
    logic: PrologSystem, tmp_path: Path, goal: str, expected: str
) -> None:
    path = f"{tmp_path}{expected}" if expected.startswith("/") else f"/{expected}"
    assert first(logic, goal) == f"'{path}'"


def test_missing_file_is_reported(logic: PrologSystem, tmp_path: Path) -> None:
    assert answers(logic, "exists_directory(maps)") == [{}]
    assert answers(logic, "exists_directory('kb.pl')") == []
    assert answers(logic, "absolute_file_name(none, _, [access(read)])") == [
        "existence_error(source_sink,none)"
    ]
    assert answers(logic, "absolute_file_name(none, _, [access(read), file_errors(fail)])") == []
    assert answers(logic, "absolute_file_name(library(lists), _)") == []
    (error,) = answers(logic, "exists_directory('/')")
    assert error == "permission_error(open,source_sink,/)"
