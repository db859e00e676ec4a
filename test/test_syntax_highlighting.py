"""What colours rules in editors is made of the tables of operators."""

import json
import re
import runpy
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
MADE = runpy.run_path(str(ROOT / "docs" / "editors" / "make.py"))


def test_files_are_those_that_the_script_makes():
    for path, text in MADE["texts"]().items():
        assert path.read_text(encoding="utf-8") == text, "run docs/editors/make.py"


def test_a_rule_has_its_colours():
    grammar = json.loads((ROOT / "docs/editors/vscode/syntaxes/retalis.tmLanguage.json").read_text("utf-8"))
    patterns = {rule["name"].rpartition(".")[0]: rule.get("match") for rule in grammar["patterns"]}
    rule = "fast(W) <- (go(W) SEQ Seq_ seq sequence(W)) within 60 where (W > 3.5 mod 0'a)."

    def found(kind):
        return re.findall(patterns[kind], rule)

    assert found("keyword.control.event") == ["SEQ", "seq", "within", "where"]
    assert found("keyword.operator.word") == ["mod"]
    assert found("keyword.control.arrow") == ["<-"]
    assert found("variable.other") == ["W", "W", "SEQ", "Seq_", "W", "W"]  # operators are looked for before
    assert found("constant.numeric") == ["60", "3.5", "0'a"]
    assert found("entity.name.function") == ["fast", "go", "sequence"]


def test_vim_knows_the_same_words():
    text = (ROOT / "docs" / "editors" / "vim" / "syntax" / "retalis.vim").read_text(encoding="utf-8")
    words = dict(re.findall(r"^syn keyword (\w+) (.*)$", text, re.MULTILINE))
    assert words["retalisOperator"].split() == MADE["words_of_events"]()
    assert {"seq", "forall_seq", "WITHIN", "aggregate"} <= set(words["retalisOperator"].split())
    assert {"is", "mod"} <= set(words["retalisProlog"].split()) and "not" not in words[
        "retalisOperator"
    ].split()
