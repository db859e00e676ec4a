#!/usr/bin/env python3
"""Write the files for rules and goals in vim and VS Code, from the tables of operators.

    PYTHONPATH=src docs/editors/make.py    # writes docs/editors/vim and docs/editors/vscode

Words, numbers, quoted texts and comments are those of ``src/retalis/prolog/syntax/tokenizer.py``. The grammar for
VS Code also colours the pages of the documentation; see ``docs/rule_lexer.py``.
"""

import json
import re
from pathlib import Path
from typing import Dict, List

from retalis import Operators
from retalis.events.language.event_operators import EVENT_OPERATORS, OperatorKind

HERE = Path(__file__).resolve().parent

FILES = ("eventRules.txt", "goalPredicates.txt")
ENDINGS = ("event", "retalis")
"""Suffixes of other files with rules."""

ARROWS = ("<-", ":-", "?-", "-->")
ORIGIN = "docs/editors/make.py made this from the tables of operators."


def list_event_words() -> List[str]:
    """Return all spellings of the operators of the event language that are words."""
    spellings = [
        spelling
        for operator in EVENT_OPERATORS
        if operator.kind is not OperatorKind.UNSUPPORTED
        for spelling in operator.spellings
        if re.fullmatch(r"\w+", spelling)
    ]
    return list(dict.fromkeys(spellings))


def list_prolog_words() -> List[str]:
    """Return the operators of Prolog that are words and not operators of the event language."""
    table = Operators.prolog()
    event_words = {*list_event_words(), *(operator.name for operator in EVENT_OPERATORS)}
    names = {*table.prefix, *table.infix, *table.postfix}
    return sorted(
        name for name in names if re.fullmatch(r"[a-z]\w*", name) and name.lower() not in event_words
    )


def vim_syntax() -> str:
    """Return the syntax file for vim."""
    arrows = "\\|".join(re.sub(r"([*.~\[\]^$\\/])", r"\\\1", arrow) for arrow in ARROWS)
    return f"""\
" Vim syntax file
" Language: retalis, event rules and goals
" {ORIGIN}
if exists("b:current_syntax")
  finish
endif

syn case match
syn match retalisVariable "\\<[A-Z_]\\w*\\>"
syn match retalisSymbol "[-+*/\\\\^<>=~:.?@#&$]\\+"
syn match retalisArrow "\\%([-+*/\\\\^<>=~:.?@#&$]\\)\\@1<!\\%({arrows}\\)\\%([-+*/\\\\^<>=~:.?@#&$]\\)\\@!"
syn match retalisEnd "\\.\\ze\\%(\\s\\|%\\|$\\)"
syn match retalisNumber "\\<\\d[0-9_]*\\%(\\.\\d\\+\\)\\=\\%([eE][-+]\\=\\d\\+\\)\\=\\>"
syn match retalisNumber "\\<0x\\x\\+\\>\\|\\<0o\\o\\+\\>\\|\\<0b[01]\\+\\>"
syn match retalisNumber "\\<0'\\%(\\\\.\\|''\\|[^\\\\]\\)"
syn keyword retalisOperator {" ".join(list_event_words())}
syn keyword retalisProlog {" ".join(list_prolog_words())}
syn region retalisAtom start=+'+ skip=+\\\\.\\|''+ end=+'+
syn region retalisString start=+"+ skip=+\\\\.\\|""+ end=+"+
syn region retalisString start=+`+ skip=+\\\\.\\|``+ end=+`+
syn keyword retalisTodo contained TODO FIXME XXX
syn match retalisComment "%.*$" contains=retalisTodo,@Spell
syn region retalisComment start="/\\*" end="\\*/" contains=retalisTodo,@Spell

hi def link retalisVariable Identifier
hi def link retalisSymbol Operator
hi def link retalisArrow Statement
hi def link retalisEnd Delimiter
hi def link retalisNumber Number
hi def link retalisOperator Keyword
hi def link retalisProlog Operator
hi def link retalisAtom Constant
hi def link retalisString String
hi def link retalisTodo Todo
hi def link retalisComment Comment

let b:current_syntax = "retalis"
"""


def vim_detection() -> str:
    """Return the file for vim that detects files with rules."""
    names = ",".join((*FILES, *(f"*.{ending}" for ending in ENDINGS)))
    return f"""\
" {ORIGIN}
autocmd BufNewFile,BufRead {names} set filetype=retalis
autocmd FileType retalis setlocal commentstring=%\\ %s comments=:%
"""


def grammar() -> Dict[str, object]:
    """Return the TextMate grammar for VS Code."""

    def rule(name: str, match: str) -> Dict[str, object]:
        return {"name": f"{name}.retalis", "match": match}

    def region(name: str, mark: str, inner: str = "") -> Dict[str, object]:
        quoted = {"match": inner, "name": "constant.character.escape.retalis"}
        return {
            "name": f"{name}.retalis",
            "begin": mark,
            "end": f"{mark}(?!{mark})",
            "patterns": [quoted],
        }

    signs = r"[-+*/\\^<>=~:.?@#&$]"
    arrows = "|".join(map(re.escape, ARROWS))
    escape = r"\\(?:x[0-9a-fA-F]+\\?|[0-7]+\\?|u[0-9a-fA-F]{4}|U[0-9a-fA-F]{8}|.|$)"
    radix = "0x[0-9a-fA-F]+|0o[0-7]+|0b[01]+"
    decimal = r"[0-9][0-9_]*(?:\.[0-9]+)?(?:[eE][+-]?[0-9]+)?"
    number = rf"0'(?:\\.|''|[^\\])|\b(?:{radix}|{decimal})\b"
    return {
        "$schema": "https://raw.githubusercontent.com/martinring/tmlanguage/master/tmlanguage.json",
        "comment": ORIGIN,
        "name": "retalis",
        "scopeName": "source.retalis",
        "patterns": [
            rule("comment.line.percentage", "%.*$"),
            {"name": "comment.block.retalis", "begin": r"/\*", "end": r"\*/"},
            region("string.quoted.single", "'", f"{escape}|''"),
            region("string.quoted.double", '"', f'{escape}|""'),
            region("string.quoted.other", "`", f"{escape}|``"),
            rule("constant.numeric", number),
            rule("keyword.control.event", rf"\b(?:{'|'.join(list_event_words())})\b"),
            rule("keyword.operator.word", rf"\b(?:{'|'.join(list_prolog_words())})\b"),
            rule("keyword.control.arrow", rf"(?<!{signs})(?:{arrows})(?!{signs})"),
            rule("variable.other", r"\b[A-Z_]\w*\b"),
            rule("entity.name.function", r"\b[a-z]\w*(?=\()"),
            rule("punctuation.terminator", r"(?<!\S)\.(?=\s|%|$)|(?<=[\w)\]}'\"])\.(?=\s|%|$)"),
            rule("keyword.operator", rf"{signs}+|[!;]"),
        ],
    }


def extension() -> Dict[str, object]:
    """Return the manifest of the extension for VS Code."""
    return {
        "name": "retalis",
        "displayName": "retalis",
        "description": "Event rules and goals of retalis: colours, errors while typing, completion, navigation.",
        "version": "1.1.0",
        "publisher": "retalis",
        "license": "GPL-3.0-or-later",
        "private": True,
        "engines": {"vscode": "^1.82.0"},
        "categories": ["Programming Languages", "Formatters", "Linters"],
        "main": "./extension.js",
        "files": ["extension.js", "language-configuration.json", "syntaxes"],
        "activationEvents": [f"workspaceContains:**/{name}" for name in FILES],
        "dependencies": {"vscode-languageclient": "^9.0.1"},
        # The check of a program calls its goals.
        "capabilities": {
            "untrustedWorkspaces": {
                "supported": False,
                "description": "A program is checked by calling the goals and directives of its files.",
            }
        },
        "contributes": {
            "configuration": {
                "title": "retalis",
                "properties": {
                    "retalis.command": {
                        "type": "array",
                        "items": {"type": "string"},
                        "minItems": 1,
                        "default": ["retalis"],
                        "scope": "machine-overridable",
                        "description": "The command retalis, for example with its path.",
                    }
                },
            },
            "languages": [
                {
                    "id": "retalis",
                    "aliases": ["retalis"],
                    "extensions": [f".{ending}" for ending in ENDINGS],
                    "filenames": list(FILES),
                    "configuration": "./language-configuration.json",
                }
            ],
            "grammars": [
                {
                    "language": "retalis",
                    "scopeName": "source.retalis",
                    "path": "./syntaxes/retalis.tmLanguage.json",
                }
            ],
        },
    }


def configuration() -> Dict[str, object]:
    """Return the comments and brackets of the language for VS Code."""
    pairs = [["(", ")"], ["[", "]"], ["{", "}"]]
    quotes = [[mark, mark] for mark in "'\"`"]
    return {
        "comments": {"lineComment": "%", "blockComment": ["/*", "*/"]},
        "brackets": pairs,
        "autoClosingPairs": [*pairs, ['"', '"']],
        "surroundingPairs": [*pairs, *quotes],
    }


def list_contents() -> Dict[Path, str]:
    """Return the contents of the files by path."""

    def pretty(value: object) -> str:
        return json.dumps(value, indent=2) + "\n"

    return {
        HERE / "vim" / "syntax" / "retalis.vim": vim_syntax(),
        HERE / "vim" / "ftdetect" / "retalis.vim": vim_detection(),
        HERE / "vscode" / "package.json": pretty(extension()),
        HERE / "vscode" / "language-configuration.json": pretty(configuration()),
        HERE / "vscode" / "syntaxes" / "retalis.tmLanguage.json": pretty(grammar()),
    }


if __name__ == "__main__":
    for path, text in list_contents().items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
