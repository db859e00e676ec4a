"""Language server: connects the language features with an editor by the Language Server Protocol.

The server needs the Python package pygls. An editor starts it as ``retalis lsp`` and sends requests on standard
input. A program is checked with the texts that are not saved, shortly after the last change of one of its files.
"""

import os
import sys
from bisect import bisect_right
from itertools import accumulate
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Dict,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
)

from lsprotocol import types as lsp
from pygls import uris
from pygls.exceptions import JsonRpcException
from pygls.server import LanguageServer
from pygls.workspace import TextDocument

from ..engine.engine_settings import Settings
from ..events.program.topic_configuration import GOALS, TOPICS
from ..foundation.errors import ProgramErrors, RetalisError
from ..messages.type_registry import Definitions
from .language_features import (
    Completion,
    Edit,
    PredicateHelp,
    Problem,
    check_renamable,
    complete,
    find_problems,
    format_file,
    hover,
    rename,
)
from .program_index import ProgramIndex, ProgramIndexes, UseInFile
from .symbol_uses import SymbolUse

if TYPE_CHECKING:
    import asyncio

_CHECK_DELAY_SECONDS = 0.03
"""Time after a change before the program is checked, so that fast typing causes one check."""

_SEVERITIES = {
    "error": lsp.DiagnosticSeverity.Error,
    "warning": lsp.DiagnosticSeverity.Warning,
    "info": lsp.DiagnosticSeverity.Information,
}
_COMPLETION_KINDS = {
    "slot": lsp.CompletionItemKind.Field,
    "constant": lsp.CompletionItemKind.Constant,
    "event": lsp.CompletionItemKind.Event,
    "message": lsp.CompletionItemKind.Struct,
    "predicate": lsp.CompletionItemKind.Function,
    "operator": lsp.CompletionItemKind.Keyword,
    "memory": lsp.CompletionItemKind.Reference,
    "topic": lsp.CompletionItemKind.Value,
    "label": lsp.CompletionItemKind.Value,
    "variable": lsp.CompletionItemKind.Variable,
    "element": lsp.CompletionItemKind.Class,
    "attribute": lsp.CompletionItemKind.Property,
    "value": lsp.CompletionItemKind.EnumMember,
}
_POSITION_ENCODINGS = {
    lsp.PositionEncodingKind.Utf8: ("utf-8", 1),
    lsp.PositionEncodingKind.Utf16: ("utf-16-le", 2),
    lsp.PositionEncodingKind.Utf32: ("utf-32-le", 4),
}
"""Codec of an encoding of the protocol, and the number of bytes of a unit."""

_XML_TRIGGERS = ("<", '"')
"""Characters after which an editor requests completions in ``pub_sub.xml``; in rules they mean something else."""


class ServerSettings(NamedTuple):
    """Settings of the language server, from the command line.

    Attributes:
        version: version of the package.
        definitions: known message types.
        predicates: built-in predicates by their names.
        engine: settings of the engine that loads a program for a check.
        error_page: returns the address of the documentation of a code, or "".
    """

    version: str
    definitions: Definitions
    predicates: Mapping[str, Sequence[PredicateHelp]]
    engine: Settings
    error_page: Callable[[str], str]


class RetalisServer:
    """The state of the server: the open files, and the files with problems that the editor shows."""

    def __init__(self, settings: ServerSettings):
        self.settings = settings
        self.server = LanguageServer(
            "retalis",
            settings.version,
            # pygls ends lines also at form feeds and other characters that editors take for text, so that it would
            # apply a change of a range elsewhere.
            text_document_sync_kind=lsp.TextDocumentSyncKind.Full,
        )
        self._indexes = ProgramIndexes()
        self._checks: Dict[str, asyncio.TimerHandle] = {}
        self._shown: Dict[str, Set[str]] = {}
        self._register()

    def _register(self) -> None:
        self._add(lsp.TEXT_DOCUMENT_DID_OPEN, self._on_change)
        self._add(lsp.TEXT_DOCUMENT_DID_CHANGE, self._on_change)
        self._add(lsp.TEXT_DOCUMENT_DID_SAVE, self._on_change)
        self._add(lsp.TEXT_DOCUMENT_DID_CLOSE, self._on_change)
        completion_options = lsp.CompletionOptions(trigger_characters=["{", "(", *_XML_TRIGGERS])
        self._add(lsp.TEXT_DOCUMENT_COMPLETION, self._on_completion, completion_options)
        self._add(lsp.TEXT_DOCUMENT_HOVER, self._on_hover)
        self._add(lsp.TEXT_DOCUMENT_DEFINITION, self._on_definition)
        self._add(lsp.TEXT_DOCUMENT_REFERENCES, self._on_references)
        self._add(lsp.TEXT_DOCUMENT_RENAME, self._on_rename, lsp.RenameOptions(prepare_provider=True))
        self._add(lsp.TEXT_DOCUMENT_PREPARE_RENAME, self._on_prepare_rename)
        self._add(lsp.TEXT_DOCUMENT_FORMATTING, self._on_formatting)

    def _add(self, method: str, handler: Callable[[Any], Any], options: Any = None) -> None:
        """Register the handler of a request or notification."""

        # pygls sets attributes of the function, which a method does not allow.
        def handle(parameters: Any) -> Any:
            return handler(parameters)

        self.server.feature(method, options)(handle)

    # Files

    def _texts(self) -> Dict[str, str]:
        """Return the texts of the open files by their real paths."""
        documents = self.server.workspace.text_documents.values()
        return {_real_path(document.uri): document.source for document in documents}

    def _document(self, uri: str) -> TextDocument:
        return self.server.workspace.get_text_document(uri)

    def _index_of(self, uri: str) -> ProgramIndex:
        return self._indexes.find(_real_path(uri), self._texts())

    def _offset(self, uri: str, position: lsp.Position) -> int:
        return self._lines(self._document(uri).source).offset(position)

    def _lines(self, text: str) -> "_TextLines":
        """Return the lines of a text, with columns in UTF-16 units or as the editor wants."""
        encoding = self.server.workspace.position_encoding or lsp.PositionEncodingKind.Utf16
        return _TextLines(text, lsp.PositionEncodingKind(encoding))

    def _range_in_document(self, uri: str, start: int, end: int) -> lsp.Range:
        return self._lines(self._document(uri).source).range(start, end)

    # Problems

    def _on_change(self, parameters: Any) -> None:
        self._schedule_check(parameters.text_document.uri)

    def _schedule_check(self, uri: str) -> None:
        """Check the program of a file after a moment, if no further change of the file comes before."""
        if uri in self._checks:
            self._checks.pop(uri).cancel()
        self._checks[uri] = self.server.loop.call_later(_CHECK_DELAY_SECONDS, self._check, uri)

    def _check(self, uri: str) -> None:
        self._checks.pop(uri, None)
        folder, texts = self._index_of(uri).folder, self._texts()
        try:
            problems = find_problems(folder, texts, self.settings.definitions, self.settings.engine)
        except Exception as error:
            # The server survives an error of a check, and reports it in the log of the editor.
            self.server.show_message_log(f"retalis: the check of {folder} failed: {error!r}")
            return
        shown = set(problems)
        # The problems of a file that has none any more are removed from the editor.
        for path in shown | self._shown.get(folder, set()):
            self._publish(path, texts, problems.get(path, []))
        self._shown[folder] = shown

    def _publish(self, path: str, texts: Mapping[str, str], problems: List[Problem]) -> None:
        if os.path.isdir(path):
            path = os.path.join(path, GOALS)
        # The address that the editor uses may lead to the file by a link.
        open_uris = [uri for uri in self.server.workspace.text_documents if _real_path(uri) == path]
        uri = open_uris[0] if open_uris else _uri(path)
        lines = self._lines(texts.get(path, ""))
        self.server.publish_diagnostics(uri, [self._diagnostic(problem, lines) for problem in problems])

    def _diagnostic(self, problem: Problem, lines: "_TextLines") -> lsp.Diagnostic:
        place = lsp.Range(
            lines.position(problem.line, problem.column), lines.position(problem.line, problem.end_column)
        )
        page = self.settings.error_page(problem.code)
        return lsp.Diagnostic(
            range=place,
            message=problem.message,
            severity=_SEVERITIES.get(problem.severity),
            code=problem.code or None,
            code_description=lsp.CodeDescription(page) if page and problem.code else None,
            source="retalis",
        )

    # Names

    def _on_completion(self, parameters: lsp.CompletionParams) -> List[lsp.CompletionItem]:
        uri = parameters.text_document.uri
        trigger = parameters.context.trigger_character if parameters.context is not None else None
        if trigger in _XML_TRIGGERS and os.path.basename(_real_path(uri)) != TOPICS:
            return []
        completions = complete(
            _real_path(uri),
            self._document(uri).source,
            self._offset(uri, parameters.position),
            self._index_of(uri),
            self.settings.definitions,
            self.settings.predicates,
        )
        return [_completion_item(completion) for completion in completions]

    def _on_hover(self, parameters: lsp.HoverParams) -> Optional[lsp.Hover]:
        uri = parameters.text_document.uri
        hovered = hover(
            _real_path(uri),
            self._offset(uri, parameters.position),
            self._index_of(uri),
            self.settings.definitions,
            self.settings.predicates,
        )
        if hovered is None:
            return None
        content = lsp.MarkupContent(lsp.MarkupKind.Markdown, hovered.text)
        return lsp.Hover(content, self._range_in_document(uri, hovered.start, hovered.end))

    def _on_definition(self, parameters: lsp.DefinitionParams) -> List[lsp.Location]:
        return self._locations(parameters, lambda use_in_file: use_in_file.use.is_definition)

    def _on_references(self, parameters: lsp.ReferenceParams) -> List[lsp.Location]:
        has_declaration = parameters.context.include_declaration
        return self._locations(
            parameters, lambda use_in_file: has_declaration or not use_in_file.use.is_definition
        )

    def _uses_at(self, parameters: Any) -> Tuple[ProgramIndex, List[SymbolUse]]:
        """Return the program of the file of a request, and the uses of symbols at its position."""
        uri = parameters.text_document.uri
        index = self._index_of(uri)
        return index, index.uses_at(_real_path(uri), self._offset(uri, parameters.position))

    def _locations(self, parameters: Any, is_wanted: Callable[[UseInFile], bool]) -> List[lsp.Location]:
        index, uses = self._uses_at(parameters)
        # The symbols of one text in `pub_sub.xml` have the same place there.
        places = {
            (use_in_file.file.path, use_in_file.use.start): use_in_file
            for use in uses
            for use_in_file in index.uses_of(use.symbol)
            if is_wanted(use_in_file)
        }
        lines = {path: self._lines(index.files[path].text) for path in {path for path, _ in places}}
        return [
            lsp.Location(_uri(file.path), lines[file.path].range(use.start, use.end))
            for file, use in places.values()
        ]

    def _on_prepare_rename(self, parameters: lsp.PrepareRenameParams) -> Optional[lsp.Range]:
        index, uses = self._uses_at(parameters)
        if not uses:
            return None
        use = uses[0]
        try:
            check_renamable(use.symbol, index, self.settings.predicates)
        except RetalisError as error:
            raise _failure(error) from error
        return self._range_in_document(parameters.text_document.uri, use.start, use.end)

    def _on_rename(self, parameters: lsp.RenameParams) -> Optional[lsp.WorkspaceEdit]:
        index, uses = self._uses_at(parameters)
        if not uses:
            return None
        use = uses[0]
        try:
            new_name = f"{parameters.new_name}{use.suffix}"
            edits = rename(use.symbol, new_name, index, self.settings.predicates)
        except RetalisError as error:
            raise _failure(error) from error
        return lsp.WorkspaceEdit(
            changes={
                _uri(path): self._text_edits(index.files[path].text, file_edits)
                for path, file_edits in edits.items()
            }
        )

    def _text_edits(self, text: str, edits: Sequence[Edit]) -> List[lsp.TextEdit]:
        lines = self._lines(text)
        return [lsp.TextEdit(lines.range(edit.start, edit.end), edit.text) for edit in edits]

    def _on_formatting(self, parameters: lsp.DocumentFormattingParams) -> List[lsp.TextEdit]:
        uri = parameters.text_document.uri
        text = self._document(uri).source
        try:
            formatted = format_file(_real_path(uri), text)
        except RetalisError as error:
            first = error.errors[0] if isinstance(error, ProgramErrors) else error
            raise _failure(first) from error
        return [] if formatted == text else self._text_edits(text, [Edit(0, len(text), formatted)])


class _TextLines:
    """Lines of a text, for the conversion between offsets and the positions of the protocol.

    pygls counts units of UTF-16 before the line as characters, and ends lines at more characters than editors do.

    Args:
        text: the text.
        encoding: encoding whose units are the columns of positions.
    """

    def __init__(self, text: str, encoding: lsp.PositionEncodingKind):
        self._codec, self._unit_size = _POSITION_ENCODINGS[encoding]
        self._lines = text.split("\n")
        self._starts = list(accumulate((len(line) + 1 for line in self._lines), initial=0))

    def position(self, line: int, column: int) -> lsp.Position:
        """Return the position of a line and a column, in characters; both count from 0."""
        text = self._lines[line][:column] if line < len(self._lines) else ""
        # A column after the end of the line stays there.
        return lsp.Position(line, self._count_units(text) + column - len(text))

    def range(self, start: int, end: int) -> lsp.Range:
        """Return the range between two offsets in characters."""
        return lsp.Range(*(self.position(*self._find(offset)) for offset in (start, end)))

    def offset(self, position: lsp.Position) -> int:
        """Return the offset of a position in characters; the end of its line, or of the text, if it is after it."""
        if position.line >= len(self._lines):
            return self._starts[-1] - 1
        units = column = 0
        for character in self._lines[position.line]:
            if units >= position.character:
                break
            units += self._count_units(character)
            column += 1
        return self._starts[position.line] + column

    def _find(self, offset: int) -> Tuple[int, int]:
        """Return the line and the column of an offset, in characters."""
        line = min(bisect_right(self._starts, offset), len(self._lines)) - 1
        return line, offset - self._starts[line]

    def _count_units(self, text: str) -> int:
        # Editors can send halves of surrogate pairs.
        return len(text.encode(self._codec, "surrogatepass")) // self._unit_size


def _failure(error: RetalisError) -> JsonRpcException:
    """Return the error of a request, which editors show."""
    create: Any = JsonRpcException
    failure: JsonRpcException = create(error.brief(), lsp.LSPErrorCodes.RequestFailed.value)
    return failure


def _completion_item(completion: Completion) -> lsp.CompletionItem:
    return lsp.CompletionItem(
        label=completion.name,
        kind=_COMPLETION_KINDS.get(completion.kind),
        detail=completion.detail or None,
        documentation=completion.documentation or None,
        insert_text=completion.text,
    )


def _uri(path: str) -> str:
    return uris.from_fs_path(path) or path


def _real_path(uri: str) -> str:
    """Return the real path of the file of an address."""
    return os.path.realpath(uris.to_fs_path(uri) or uri)


def serve(settings: ServerSettings) -> None:
    """Serve an editor by standard input and output until it ends the connection."""
    server = RetalisServer(settings).server
    output = sys.stdout.buffer
    # What goals and modules of a program print must not be mixed with the messages of the protocol.
    sys.stdout = sys.stderr
    # pygls declares streams of text, and uses streams of bytes.
    start: Any = server.start_io
    start(sys.stdin.buffer, output)
