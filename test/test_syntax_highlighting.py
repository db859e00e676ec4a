"""Syntax highlighting in editors and on the pages, generated from the tables of operators."""

import json
import re
import runpy
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parent.parent
SCRIPT = runpy.run_path(str(ROOT / "docs" / "editors" / "make.py"))


def test_files_equal_those_of_script() -> None:
    for path, text in SCRIPT["list_contents"]().items():
        assert path.read_text(encoding="utf-8") == text, "run docs/editors/make.py"


def test_rule_has_colours() -> None:
    grammar = json.loads((ROOT / "docs/editors/vscode/syntaxes/retalis.tmLanguage.json").read_text("utf-8"))
    patterns = {rule["name"].rpartition(".")[0]: rule.get("match") for rule in grammar["patterns"]}
    rule = "fast(W) <- (go(W) SEQ Seq_ seq sequence(W)) within 60 where (W > 3.5 mod 0'a)."

    def matches(scope: str) -> Any:
        return re.findall(patterns[scope], rule)

    assert matches("keyword.control.event") == ["SEQ", "seq", "within", "where"]
    assert matches("keyword.operator.word") == ["mod"]
    assert matches("keyword.control.arrow") == ["<-"]
    assert matches("variable.other") == ["W", "W", "SEQ", "Seq_", "W", "W"]  # operators precede variables
    assert matches("constant.numeric") == ["60", "3.5", "0'a"]
    assert matches("entity.name.function") == ["fast", "go", "sequence"]


def test_vim_has_words_of_tables() -> None:
    text = (ROOT / "docs" / "editors" / "vim" / "syntax" / "retalis.vim").read_text(encoding="utf-8")
    words = dict(re.findall(r"^syn keyword (\w+) (.*)$", text, re.MULTILINE))
    assert words["retalisOperator"].split() == SCRIPT["list_event_words"]()
    assert {"seq", "forall_seq", "WITHIN", "aggregate"} <= set(words["retalisOperator"].split())
    assert {"is", "mod"} <= set(words["retalisProlog"].split())
    assert "not" not in words["retalisOperator"].split()


def test_pages_are_coloured_by_grammar_of_editors() -> None:
    pytest.importorskip("pygments")
    lexer = runpy.run_path(str(ROOT / "docs" / "rule_lexer.py"))["RuleLexer"]()
    text = "up('it''s', X) <- a seq b(X) where X > 0'a. % c\n/* d\n*/ :- mod(\"q\").\n"
    tokens = [(str(token)[6:], part) for token, part in lexer.get_tokens(text)]
    assert "".join(part for _, part in tokens) == text
    assert not [part for token, part in tokens if token.startswith("Error")]
    coloured = [(token, part) for token, part in tokens if token != "Text"]
    assert coloured[:4] == [
        ("Name.Function", "up"),
        ("Name.Constant", "'"),
        ("Name.Constant", "i"),
        ("Name.Constant", "t"),
    ]
    assert {("Keyword", "<-"), ("Keyword", "seq"), ("Keyword", "where"), ("Keyword", ":-")} <= set(coloured)
    assert {("Literal.Number", "0'a"), ("Comment.Single", "% c"), ("Name.Variable", "X")} <= set(coloured)
    assert "".join(part for token, part in coloured if token == "Comment.Multiline") == "/* d\n*/"
