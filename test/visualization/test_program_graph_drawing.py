"""Drawing of graphs: text for Graphviz, and its errors."""

import re
import subprocess
from itertools import combinations
from pathlib import Path
from shutil import which
from typing import List
from xml.etree import ElementTree
from xml.sax.saxutils import escape

import pytest
from asserting_accessors import search
from hypothesis import given
from hypothesis import strategies as st

from retalis import Engine, UsageError
from retalis.visualization.program_graph import (
    NODE_STYLES,
    Graph,
    GraphEdge,
    GraphNode,
    dot_text,
    draw_graph,
    program_graph,
)

ROOT = Path(__file__).resolve().parents[2]
STRING = re.compile(r'"((?:[^"\\]|\\.)*)"', re.DOTALL)


def test_text_has_nodes_edges_and_legend() -> None:
    engine = Engine()
    engine.load(rules="far : quiet(X) <- (a(X) seq my_msgs__0__Level(_)) cnot b.", source="/p/far.txt")
    lines = dot_text(program_graph(engine), "mine").splitlines()
    assert any(
        'label="far (far.txt:1)\\nquiet(X) <- a(X) seq' in line and "shape=box" in line for line in lines
    )
    assert any('label="Level/1\\nmy_msgs"' in line for line in lines)
    assert sum("arrowhead=tee" in line for line in lines) == 1
    (legend,) = [line for line in lines if line.strip().startswith("legend [")]
    assert "must not happen" in legend
    assert "memory" not in legend


def test_colours_equal_those_of_page() -> None:
    page = (ROOT / "src/retalis/dashboard/page/dashboard.css").read_text(encoding="utf-8")
    for style_name, style in NODE_STYLES.items():
        assert search(rf"--{style_name}: (#\w+)", page).group(1) == style.colour


def test_kinds_have_distinct_colours() -> None:
    colours = [bytes.fromhex(style.colour[1:]) for style in NODE_STYLES.values()]
    for first, second in combinations(colours, 2):
        assert sum(abs(a - b) for a, b in zip(first, second)) >= 20


def test_terms_have_spaces_at_operators_and_commas() -> None:
    engine = Engine()
    engine.load(rules="alarm(X,Y)<-heat(X)and smoke(Y)where X>1,Y<2.")
    (rule,) = [node for node in program_graph(engine).nodes if node.kind == "rule"]
    assert rule.text == "alarm(X, Y) <- heat(X) and smoke(Y) where X > 1, Y < 2"


@pytest.mark.parametrize(
    ("rules", "direction"),
    [
        pytest.param([f"stage{number + 1}(X) <- stage{number}(X)." for number in range(6)], "TB", id="chain"),
        pytest.param([f"alarm{number} <- event{number}." for number in range(12)], "LR", id="parallel"),
    ],
)
def test_graph_is_drawn_along_its_longer_side(rules: List[str], direction: str) -> None:
    engine = Engine()
    engine.load(rules=" ".join(rules))
    assert f"rankdir={direction}" in dot_text(program_graph(engine), "graph")


def test_cycle_of_rules_is_drawn() -> None:
    engine = Engine()
    engine.load(rules="a(X) <- b(X). b(X) <- a(X). b(X) <- c(X).")
    assert dot_text(program_graph(engine), "cycle").count(" -> ") == 6


@pytest.mark.slow
@pytest.mark.parametrize("folder", ["application_source", "examples/cookbook/joint_effort"])
def test_picture_has_limited_aspect_ratio(folder: str, tmp_path: Path) -> None:
    if which("dot") is None:
        pytest.skip("Graphviz is not installed")
    engine = Engine()
    engine.load_program(ROOT / folder)
    draw_graph(dot_text(program_graph(engine), folder), tmp_path / "program.svg")
    svg = ElementTree.parse(tmp_path / "program.svg").getroot()
    width, height = (float(svg.attrib[name][:-2]) for name in ("width", "height"))
    assert 1 / 3 <= width / height <= 3


@given(st.text(max_size=40))
def test_texts_of_program_are_quoted(name: str) -> None:
    def remove_strings(label: str, title: str) -> str:
        nodes = [GraphNode("a", "topic", label, label), GraphNode("b", "rule", "r", label)]
        text = dot_text(Graph(nodes, [GraphEdge("a", "b", "", "flow")], 3), title)
        # The direction depends on the lengths of the labels.
        return STRING.sub("", text).replace("rankdir=TB", "rankdir=LR")

    assert remove_strings(name, name) == remove_strings("", "")


FORGING = "\x1b[31m\x9b\u202e\x00\ud800\uffff &#27; &amp; &x; a & b"


def test_texts_are_valid_xml_without_entities() -> None:
    nodes = [GraphNode("a", style_name, FORGING, FORGING) for style_name in NODE_STYLES]
    text = dot_text(Graph(nodes, [], 0), FORGING)
    ElementTree.fromstring(f"<t>{escape(text)}</t>")
    escaped = r"\x1b[31m\x9b\u202e\x00\ud800\uffff \x26#27; \x26amp; \x26x; a & b"
    assert escaped.replace("\\", "\\\\") in text


@pytest.mark.skipif(which("dot") is None, reason="Graphviz is not installed")
def test_graphviz_draws_text_as_well_formed_xml(tmp_path: Path) -> None:
    draw_graph(
        dot_text(Graph([GraphNode("a", "topic", FORGING, FORGING)], [], 0), FORGING), tmp_path / "x.svg"
    )
    assert "\\x1b[31m" in "".join(ElementTree.parse(tmp_path / "x.svg").getroot().itertext())


def test_missing_graphviz_is_an_error_with_advice(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UsageError, match=r"apt install graphviz.*program\.dot can be written"):
        draw_graph("digraph {}", tmp_path / "program.svg")


def test_error_of_dot_is_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "dot").write_text("#!/bin/sh\necho 'syntax error' >&2\nexit 1\n")
    (tmp_path / "dot").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    with pytest.raises(UsageError, match="dot cannot draw .*syntax error"):
        draw_graph("digraph {", tmp_path / "program.svg")


@pytest.mark.slow
@pytest.mark.skipif(which("dot") is None, reason="Graphviz is not installed")
def test_graphviz_draws_large_program() -> None:
    engine = Engine()
    engine.load_program(ROOT / "application_source")
    text = dot_text(program_graph(engine), 'a "title" \\ with\nlines')
    process = subprocess.run(["dot", "-Tsvg"], input=text, capture_output=True, text=True, timeout=60)
    assert process.stderr == ""
    assert process.stdout.count("<title>") > 30
    assert "odom_base" in process.stdout
