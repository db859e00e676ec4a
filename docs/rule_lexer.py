"""Lexer of Pygments for rules and goals, made from the TextMate grammar of the VS Code extension.

The pages and the editors thus colour the same text alike. The grammar uses those features of TextMate that have an
equivalent in a lexer of Pygments: patterns with ``match``, and regions with ``begin``, ``end`` and patterns inside.
"""

import json
import re
from pathlib import Path
from typing import Any, Dict, List, Tuple

from pygments.lexer import RegexLexer
from pygments.token import Comment, Keyword, Name, Number, Operator, Punctuation, String, Text

GRAMMAR = Path(__file__).resolve().parent / "editors" / "vscode" / "syntaxes" / "retalis.tmLanguage.json"

TOKENS = {
    "comment.line": Comment.Single,
    "comment.block": Comment.Multiline,
    "string.quoted.single": Name.Constant,
    "string.quoted": String,
    "constant.character.escape": String.Escape,
    "constant.numeric": Number,
    "keyword.control": Keyword,
    "keyword.operator.word": Operator.Word,
    "keyword.operator": Operator,
    "variable": Name.Variable,
    "entity.name.function": Name.Function,
    "punctuation": Punctuation,
}
"""Tokens by the beginning of a scope; the first that fits is used."""

UNCOLOURED = [(r"\w+", Text), (r"\s+", Text), (r".", Text)]
"""Text that no pattern of the grammar matches."""


def find_token(scope: str) -> Any:
    """Return the token for a scope, such as ``comment.line.percentage.retalis``.

    Raises:
        KeyError: no beginning of a scope fits.
    """
    for beginning, token in TOKENS.items():
        if scope.startswith(beginning + "."):
            return token
    raise KeyError(scope)


def make_states(grammar: Dict[str, Any]) -> Dict[str, List[Tuple[Any, ...]]]:
    """Return the states of a lexer with the patterns of a TextMate grammar.

    A region is a state of its own, which is named after its scope.
    """
    states: Dict[str, List[Tuple[Any, ...]]] = {"root": []}
    for pattern in grammar["patterns"]:
        scope = pattern["name"]
        token = find_token(scope)
        if "match" in pattern:
            states["root"].append((pattern["match"], token))
        else:
            states["root"].append((pattern["begin"], token, scope))
            inner = [(rule["match"], find_token(rule["name"])) for rule in pattern.get("patterns", [])]
            states[scope] = [*inner, (pattern["end"], token, "#pop"), (r"(?s:.)", token)]
    states["root"] += UNCOLOURED
    return states


class RuleLexer(RegexLexer):
    """Lexer for rule files and goal files of retalis."""

    name = "retalis"
    aliases = ("retalis", "prolog")
    flags = re.MULTILINE
    tokens = make_states(json.loads(GRAMMAR.read_text(encoding="utf-8")))
