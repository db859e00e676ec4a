"""Index of a program: its files, and the uses of symbols in all of them."""

import os
from pathlib import Path
from typing import Dict, List, Tuple

import pytest

from retalis.editing.program_index import ProgramIndex, ProgramIndexes
from retalis.editing.symbol_uses import SymbolKind, SymbolUse

GOALS = "compile_event_file('eventRules.txt')\nmemorize(seen(X), [], seen(X), last_seen, 3)\n"
RULES = """\
:- include('lib/more.txt').
seen(X) <- camera(X).
p(M, X) :- q(M, X).
r(X) :- p(last_seen, X), prev(last_seen, X, _, _, 3).
"""
TOPICS = (
    '<publish_subscribe><subscribe_to name="cam" msg_type="my/Cam" event="camera"/></publish_subscribe>\n'
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "lib").mkdir()
    for name, text in {
        "goalPredicates.txt": GOALS,
        "eventRules.txt": RULES,
        "pub_sub.xml": TOPICS,
        "lib/more.txt": "q(_, _).\n",
        "alone.txt": "z <- seen(_).\n",
    }.items():
        (tmp_path / name).write_text(text)
    return Path(os.path.realpath(tmp_path))


def find(path: Path, **texts: str) -> ProgramIndex:
    return ProgramIndexes().find(str(path), {str(path): text for text in texts.values()})


def use_at(index: ProgramIndex, path: Path, text: str) -> SymbolUse:
    use = index.use_at(str(path), index.files[str(path)].text.index(text))
    assert use is not None
    return use


def places(index: ProgramIndex, use: SymbolUse) -> List[Tuple[str, bool]]:
    return [
        (Path(file.path).name, use_in_file.is_definition) for file, use_in_file in index.uses_of(use.symbol)
    ]


@pytest.mark.parametrize("name", ["eventRules.txt", "goalPredicates.txt", "pub_sub.xml", "lib/more.txt"])
def test_files_of_program_are_found_from_each(folder: Path, name: str) -> None:
    index = find(folder / name)
    assert index.folder == str(folder)
    assert sorted(os.path.relpath(path, folder) for path in index.files) == [
        *("eventRules.txt", "goalPredicates.txt", "lib/more.txt", "pub_sub.xml")
    ]


def test_file_that_no_goal_loads_is_alone(folder: Path) -> None:
    index = find(folder / "alone.txt")
    assert (index.folder, list(index.files)) == (str(folder / "alone.txt"), [str(folder / "alone.txt")])


def test_uses_are_found_in_all_files(folder: Path) -> None:
    index = find(folder / "eventRules.txt")
    seen = use_at(index, folder / "goalPredicates.txt", "seen(X)")
    assert places(index, seen) == [
        ("goalPredicates.txt", False),
        ("goalPredicates.txt", False),
        ("eventRules.txt", True),
    ]
    camera = use_at(index, folder / "eventRules.txt", "camera")
    assert [Path(file.path).name for file, _ in index.definitions_of(camera.symbol)] == ["pub_sub.xml"]
    assert index.event_types() == {"camera": "my/Cam"}


def test_argument_with_name_of_memory_is_memory(folder: Path) -> None:
    index = find(folder / "eventRules.txt")
    memory = use_at(index, folder / "eventRules.txt", "last_seen, X)")
    assert memory.symbol.kind is SymbolKind.MEMORY
    assert len(places(index, memory)) == 3
    assert [symbol.name for symbol in index.symbols(SymbolKind.MEMORY)] == ["last_seen"]


def test_unsaved_text_replaces_file(folder: Path) -> None:
    path = folder / "eventRules.txt"
    index = find(path, text="other <- unsaved(1).\nbroken(\n")
    assert use_at(index, path, "unsaved").symbol.arity == 1
    assert str(folder / "lib" / "more.txt") not in index.files


def test_changed_text_is_indexed_again(folder: Path) -> None:
    indexes, path = ProgramIndexes(), str(folder / "alone.txt")
    texts: Dict[str, str] = {path: "a <- b.\n"}
    assert indexes.find(path, texts).files[path] is not indexes.find(path, {}).files[path]
    assert indexes.find(path, texts).files[path].text == "a <- b.\n"


def test_files_that_load_each_other(folder: Path) -> None:
    (folder / "lib" / "more.txt").write_text(":- include('../eventRules.txt').\n")
    assert len(find(folder / "eventRules.txt").files) == 4
