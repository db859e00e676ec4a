"""A graph as text for Graphviz, and what is said where that is missing."""

import re
import subprocess
from pathlib import Path
from shutil import which
from xml.etree import ElementTree
from xml.sax.saxutils import escape

import pytest
from hypothesis import given
from hypothesis import strategies as some

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


def test_a_program_has_nodes_ways_and_a_legend():
    engine = Engine()
    engine.load(rules="far : quiet(X) <- (a(X) seq my_msgs__0__Level(_)) cnot b.")
    lines = dot_text(program_graph(engine), "mine").splitlines()
    assert any('label="far\\nquiet(X) <- a(X) seq' in line and "shape=box" in line for line in lines)
    assert any('label="Level/1\\nmy_msgs"' in line for line in lines)
    assert sum("arrowhead=tee" in line for line in lines) == 1
    (legend,) = [line for line in lines if line.strip().startswith("legend [")]
    assert "must not happen" in legend and "memory" not in legend


def test_colours_are_those_of_the_page():
    page = (ROOT / "src/retalis/dashboard/page/dashboard.css").read_text(encoding="utf-8")
    for kind, look in NODE_STYLES.items():
        assert re.search(rf"--{kind}: (#\w+)", page).group(1) == look.colour


@given(some.text(max_size=40))
def test_no_text_from_outside_becomes_part_of_the_language(name):
    nodes = [GraphNode("a", "topic", name, name), GraphNode("b", "rule", "r", name)]
    text = dot_text(Graph(nodes, [GraphEdge("a", "b", "", "flow")], 3), name)
    bare = STRING.sub("", text)
    assert bare == STRING.sub(
        "",
        dot_text(
            Graph([node._replace(label="", text="") for node in nodes], [GraphEdge("a", "b", "", "flow")], 3),
            "",
        ),
    )


FORGING = "\x1b[31m\x9b\u202e\x00\ud800\uffff &#27; &amp; &x; a & b"


def test_texts_have_only_what_xml_has_and_no_entities():
    nodes = [GraphNode("a", kind, FORGING, FORGING) for kind in NODE_STYLES]
    text = dot_text(Graph(nodes, [], 0), FORGING)
    ElementTree.fromstring(f"<t>{escape(text)}</t>")
    shown = r"\x1b[31m\x9b\u202e\x00\ud800\uffff \x26#27; \x26amp; \x26x; a & b"
    assert shown.replace("\\", "\\\\") in text


@pytest.mark.skipif(which("dot") is None, reason="Graphviz is not there")
def test_graphviz_draws_any_text_as_well_formed_xml(tmp_path):
    draw_graph(
        dot_text(Graph([GraphNode("a", "topic", FORGING, FORGING)], [], 0), FORGING), tmp_path / "x.svg"
    )
    assert "\\x1b[31m" in "".join(ElementTree.parse(tmp_path / "x.svg").getroot().itertext())


def test_without_graphviz_the_error_says_what_to_do(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UsageError, match=r"apt install graphviz.*program\.dot can be written"):
        draw_graph("digraph {}", tmp_path / "program.svg")


def test_what_dot_cannot_read_is_an_error(monkeypatch, tmp_path):
    (tmp_path / "dot").write_text("#!/bin/sh\necho 'syntax error' >&2\nexit 1\n")
    (tmp_path / "dot").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    with pytest.raises(UsageError, match="dot cannot draw .*syntax error"):
        draw_graph("digraph {", tmp_path / "program.svg")


@pytest.mark.slow
def test_graphviz_reads_it_where_it_is_there():
    engine = Engine()
    engine.load_program(ROOT / "application_source")
    text = dot_text(program_graph(engine), 'a "title" \\ with\nlines')
    if which("dot"):
        drawn = subprocess.run(["dot", "-Tsvg"], input=text, capture_output=True, text=True, timeout=60)
        assert drawn.stderr == "" and drawn.stdout.count("<title>") > 30
    assert "odom_base" in text
