"""Index of the files of a program, for navigation and completion while they are edited.

The files are found from the texts alone: the nearest folder above a file that contains ``goalPredicates.txt`` is the
folder of its program, whose files are ``pub_sub.xml``, the goal file, and the files that goals and directives load
by a constant name. A file that no goal loads is a program of its own. Texts that are not saved replace those of the
disk.
"""

import os
from pathlib import Path
from typing import Callable, Dict, Iterator, List, Mapping, NamedTuple, Optional, Tuple

from ..events.program.topic_configuration import GOALS, TOPICS, read_text
from ..foundation.bounded_caches import Cache
from ..foundation.errors import UsageError
from .clause_reader import ParsedClause
from .symbol_uses import (
    ProgramSymbol,
    SymbolKind,
    SymbolUse,
    clauses_of_goals,
    clauses_of_rules,
    event_types_in_topics,
    find_names,
    uses_in_clause,
    uses_in_topics,
)

_MAX_FOLDERS_ABOVE = 3
"""Folders above that of a file in which a goal file is searched."""
_MAX_FILES = 100
"""Maximum number of files of a program that are read."""
_MAX_CHARACTERS = 1 << 20
"""Maximum length of a text that is indexed."""
_LOADING = frozenset(
    (
        "compile_event_file",
        "compile_events",
        "consult",
        "ensure_loaded",
        "use_module",
        "include",
        "load_files",
    )
)
"""Goals and directives that load the file in their first argument."""
_SUFFIXES = ("", ".pl", ".prolog", ".pro")


class FileIndex(NamedTuple):
    """The uses of symbols in a file, and the names of the files that it loads."""

    path: str
    text: str
    uses: Tuple[SymbolUse, ...]
    loaded_names: Tuple[str, ...]


class UseInFile(NamedTuple):
    """A use of a symbol with the index of its file."""

    file: FileIndex
    use: SymbolUse


class ProgramIndex:
    """The files of one program.

    Attributes:
        folder: the folder of the program, or its only file.
        files: the indexes of the files by their paths.
    """

    def __init__(self, folder: str, files: Dict[str, FileIndex]):
        self.folder = folder
        self.files = _resolve_memories(files)

    def uses_at(self, path: str, offset: int) -> List[SymbolUse]:
        """Return the uses at an offset of a file: none, one, or those of the topics or events of an action.

        The offset after a name belongs to it.
        """
        file = self.files.get(path)
        uses = () if file is None else file.uses
        first = next((use for use in uses if use.start <= offset <= use.end), None)
        return [] if first is None else [use for use in uses if use.start == first.start]

    def use_at(self, path: str, offset: int) -> Optional[SymbolUse]:
        """Return the first use at an offset of a file; None if there is none."""
        return next(iter(self.uses_at(path, offset)), None)

    def uses_of(self, symbol: ProgramSymbol) -> Iterator[UseInFile]:
        """Yield all uses of a symbol."""
        for file in self.files.values():
            for use in file.uses:
                if use.symbol.matches(symbol):
                    yield UseInFile(file, use)

    def definitions_of(self, symbol: ProgramSymbol) -> List[UseInFile]:
        """Return the uses that define a symbol."""
        return [use_in_file for use_in_file in self.uses_of(symbol) if use_in_file.use.is_definition]

    def event_types(self) -> Dict[str, str]:
        """Return the message types by the names of events that ``pub_sub.xml`` gives them."""
        files = [file for file in self.files.values() if os.path.basename(file.path) == TOPICS]
        return event_types_in_topics(files[0].text) if files else {}

    def symbols(self, kind: SymbolKind) -> List[ProgramSymbol]:
        """Return the symbols of a kind, each once, in the order of the files."""
        # The topics of actions and services are read only, and no goal names them.
        symbols = (
            use.symbol
            for file in self.files.values()
            for use in file.uses
            if use.symbol.kind is kind and not (kind is SymbolKind.TOPIC and use.suffix)
        )
        return list(dict.fromkeys(symbols))


def _resolve_memories(files: Dict[str, FileIndex]) -> Dict[str, FileIndex]:
    """Return the indexes with the names of memories that predicates of the program have as arguments.

    An atom with the name of a memory is the memory, unless it is an event or predicate of the program, too.
    """
    defined = {use.symbol for file in files.values() for use in file.uses if use.is_definition}
    memories = {symbol.name for symbol in defined if symbol.kind is SymbolKind.MEMORY}
    memories -= {symbol.name for symbol in defined if symbol.kind is SymbolKind.FUNCTOR and symbol.arity == 0}

    def resolve(use: SymbolUse) -> SymbolUse:
        symbol = use.symbol
        if symbol.kind is SymbolKind.FUNCTOR and symbol.arity == 0 and symbol.name in memories:
            return use._replace(symbol=ProgramSymbol(SymbolKind.MEMORY, symbol.name))
        return use

    return {path: file._replace(uses=tuple(map(resolve, file.uses))) for path, file in files.items()}


class ProgramIndexes:
    """Indexes of the programs of open files. Files are parsed again only if their texts have changed."""

    def __init__(self) -> None:
        self._files: Cache[Tuple[str, str], FileIndex] = Cache(2 * _MAX_FILES, 8 << 20)

    def find(self, path: str, unsaved_texts: Mapping[str, str]) -> ProgramIndex:
        """Return the index of the program of a file.

        Args:
            path: real path of the file.
            unsaved_texts: texts that replace those of the disk, by real paths.
        """

        def index_of(file_path: str) -> Optional[FileIndex]:
            return self._index(file_path, unsaved_texts)

        folder = _folder_of_program(path, unsaved_texts)
        if folder is not None:
            goal_file = os.path.join(folder, GOALS)
            files = _collect([goal_file, os.path.join(folder, TOPICS)], folder, index_of)
            if path in files:
                return ProgramIndex(folder, files)
        return ProgramIndex(path, _collect([path], os.path.dirname(path), index_of))

    def _index(self, path: str, unsaved_texts: Mapping[str, str]) -> Optional[FileIndex]:
        text = unsaved_texts.get(path)
        if text is None:
            try:
                text = read_text(path)
            except UsageError:
                return None
        if len(text) > _MAX_CHARACTERS:
            return None
        index = self._files.get((path, text))
        if index is None:
            index = index_file(path, text)
            self._files.store((path, text), index, len(text))
        return index


def index_file(path: str, text: str) -> FileIndex:
    """Return the index of a file; its name determines its kind."""
    name = os.path.basename(path)
    if name == TOPICS:
        return FileIndex(path, text, tuple(uses_in_topics(text)), ())
    clauses = list(clauses_of_goals(text, path) if name == GOALS else clauses_of_rules(text, path))
    uses = tuple(use for clause in clauses for use in uses_in_clause(clause))
    loaded_names = tuple(name for clause in clauses for name in _loaded_names(clause.clause))
    return FileIndex(path, text, uses, loaded_names)


def _loaded_names(clause: ParsedClause) -> Iterator[str]:
    for use in find_names(clause):
        if use.parent is not None and use.parent.name in _LOADING and use.argument == 1:
            yield use.name


def _folder_of_program(path: str, unsaved_texts: Mapping[str, str]) -> Optional[str]:
    """Return the nearest folder of a file or above it that contains a goal file, or None."""
    folder = Path(path).parent
    for candidate in [folder, *list(folder.parents)[:_MAX_FOLDERS_ABOVE]]:
        goal_file = candidate / GOALS
        if str(goal_file) in unsaved_texts or goal_file.is_file():
            return str(candidate)
    return None


def _collect(
    paths: List[str], folder: str, index_of: Callable[[str], Optional[FileIndex]]
) -> Dict[str, FileIndex]:
    """Return the indexes of files and of those that they load."""
    files: Dict[str, FileIndex] = {}
    waiting = list(reversed(paths))
    while waiting and len(files) < _MAX_FILES:
        path = waiting.pop()
        index = None if path in files else index_of(path)
        if index is None:
            continue
        files[path] = index
        for name in reversed(index.loaded_names):
            waiting += [
                os.path.realpath(os.path.join(base, name + suffix))
                for base in dict.fromkeys((folder, os.path.dirname(path)))
                for suffix in _SUFFIXES
            ]
    return files
