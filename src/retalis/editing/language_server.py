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
            "retalis", settings.version, text_document_sync_kind=lsp.TextDocumentSyncKind.Incremental
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
        return int(self._document(uri).offset_at_position(position))

    def _range(self, lines: "_TextLines", start: int, end: int) -> lsp.Range:
        """Return a range of the protocol, whose columns are counted in UTF-16 units or as the editor wants."""
        codec = self.server.workspace.position_codec
        place = lsp.Range(lines.position(start), lines.position(end))
        result: lsp.Range = codec.range_to_client_units(lines.lines, place)
        return result

    def _range_in_document(self, uri: str, start: int, end: int) -> lsp.Range:
        return self._range(_TextLines(self._document(uri).source), start, end)

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
        lines = texts[path].split("\n") if path in texts else []
        self.server.publish_diagnostics(uri, [self._diagnostic(problem, lines) for problem in problems])

    def _diagnostic(self, problem: Problem, lines: List[str]) -> lsp.Diagnostic:
        place = lsp.Range(
            lsp.Position(problem.line, problem.column), lsp.Position(problem.line, problem.end_column)
        )
        if problem.line < len(lines):
            place = self.server.workspace.position_codec.range_to_client_units(lines, place)
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
        lines = {path: _TextLines(index.files[path].text) for path in {path for path, _ in places}}
        return [
            lsp.Location(_uri(file.path), self._range(lines[file.path], use.start, use.end))
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
        lines = _TextLines(text)
        return [lsp.TextEdit(self._range(lines, edit.start, edit.end), edit.text) for edit in edits]

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
    """Lines of a text, for the conversion of offsets.

    Attributes:
        lines: the lines without their ends.
    """

    def __init__(self, text: str):
        self.lines = text.split("\n")
        self._starts = list(accumulate((len(line) + 1 for line in self.lines), initial=0))

    def position(self, offset: int) -> lsp.Position:
        """Return the line and the column of an offset, in characters."""
        line = min(bisect_right(self._starts, offset), len(self.lines)) - 1
        return lsp.Position(line, offset - self._starts[line])


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
