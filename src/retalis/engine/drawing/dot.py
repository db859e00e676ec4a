"""The graph of a program as text for Graphviz, and drawn by its command ``dot``."""

import re
import subprocess
from pathlib import Path
from shutil import which
from textwrap import wrap
from typing import Dict, Iterable, Iterator, List, NamedTuple

from ...foundation import UsageError, counted, printable
from .graph import Graph, GraphNode

FORMATS = ("svg", "png", "pdf")
"""What ``dot`` is asked to draw."""

SECONDS = 60
"""After these it is ended."""

ACROSS, LINES = 38, 3
"""Characters of a line of text in a node, and lines."""


class _NodeStyle(NamedTuple):
    """How nodes of a kind look.

    Attributes:
        shape: one of Graphviz.
        colour: that they are filled with.
        legend: what they are.
    """

    shape: str
    colour: str
    legend: str


KINDS = {
    "topic": _NodeStyle("cds", "#d7e9f5", "topic"),
    "event": _NodeStyle("box", "#eceff3", "event"),
    "rule": _NodeStyle("box", "#e8defa", "rule"),
    "query": _NodeStyle("hexagon", "#fdeccb", "query that waits for memories"),
    "memory": _NodeStyle("cylinder", "#d9f0df", "memory"),
    "output": _NodeStyle("cds", "#cfe3f1", "published topic"),
}

_ENTITY = re.compile(r"&(?=#?\w+;)")
_PACKAGE, _UNNAMED, _TIGHT = re.compile(r"\b\w+?__0__"), re.compile(r"\b_G\d+\b"), re.compile(r"(,|\)(?=\w))")

WAYS = {
    "flow": "",
    "absent": 'style=dashed color="#b3261e" arrowhead=tee',
    "reads": 'style=dotted color="#3c7d50"',
}
"""How the ways look: of events, of events that must not happen, of memories that are read."""


def dot_text(graph: Graph, title: str) -> str:
    """Return a graph in the language of Graphviz, from left to right, with a legend."""
    there = {node.id: f"n{at}" for at, node in enumerate(graph.nodes)}
    shown = [edge for edge in graph.edges if edge.source in there and edge.target in there]
    more = f"; {counted(graph.left_out, 'more node')} left out" if graph.left_out else ""
    lines = [
        "digraph program {",
        f"  label={_quoted(title + more)} labelloc=t fontsize=16",
        '  rankdir=LR nodesep=0.12 ranksep=0.45 fontname="Helvetica"',
        '  node [fontname="Helvetica" fontsize=11 style="filled" color="#8592a3" height=0.3 margin="0.12,0.05"]',
        '  edge [color="#6b7887" arrowsize=0.7]',
        *(f"  {there[node.id]} [{_node(node)}]" for node in graph.nodes),
        *(f"  {there[edge.source]} -> {there[edge.target]} [{WAYS[edge.kind]}]" for edge in shown),
        *_ranks(graph, there),
        *_legend({node.kind for node in graph.nodes}, {edge.kind for edge in shown}),
        "}",
    ]
    return "\n".join(lines) + "\n"


def draw(text: str, path: Path) -> None:
    """Draw a text in the language of Graphviz into a file, in the format of its ending.

    Raises:
        UsageError: where Graphviz is not there or cannot draw it, or the file cannot be written.
    """
    dot = which("dot")
    if dot is None:
        raise UsageError(
            f"drawing {path.name} needs the command dot of Graphviz (apt install graphviz); "
            f"without it, {path.with_suffix('.dot').name} can be written, which is the graph as text"
        )
    command = [dot, f"-T{path.suffix[1:]}", "-o", str(path)]
    try:
        done = subprocess.run(
            command, input=text, capture_output=True, encoding="utf-8", errors="replace", timeout=SECONDS
        )
    except subprocess.TimeoutExpired:
        raise UsageError(f"dot has not drawn {path.name} in {SECONDS} s") from None
    if done.returncode:
        raise UsageError(f"dot cannot draw {path}: {done.stderr.strip()}")


def _node(node: GraphNode) -> str:
    look = KINDS[node.kind]
    label = "\n".join([_short(node), *_below(node)])
    rounded = ' style="filled,rounded"' if node.kind == "event" else ""
    told = _quoted(_UNNAMED.sub("_", node.text))
    return f'label={_quoted(label)} tooltip={told} shape={look.shape} fillcolor="{look.colour}"{rounded}'


def _short(node: GraphNode) -> str:
    """Return the first line of a node: a message's event without its package."""
    return node.label.rpartition("__0__")[2] if node.kind == "event" else node.label


def _below(node: GraphNode) -> List[str]:
    """Return the lines below that."""
    if node.kind == "event" and "__0__" in node.label:
        return [node.label.rpartition("__0__")[0]]
    if node.kind != "rule":
        return []
    lines = wrap(_loose(node.text), ACROSS, break_long_words=False)
    return lines if len(lines) <= LINES else [*lines[: LINES - 1], lines[LINES - 1] + " ..."]


def _loose(rule: str) -> str:
    """Return the text of a rule with blanks to break it at, without packages and names of what has none."""
    plain = _UNNAMED.sub("_", _PACKAGE.sub("", rule))
    return " ".join(_TIGHT.sub(r"\1 ", plain).replace("<-", " <- ").split())


def _ranks(graph: Graph, there: Dict[str, str]) -> Iterator[str]:
    """Yield what has topics stand at the left and published ones at the right."""
    for kind, rank in (("topic", "source"), ("output", "sink")):
        nodes = [there[node.id] for node in graph.nodes if node.kind == kind]
        if nodes:
            yield f"  {{ rank={rank}; {'; '.join(nodes)} }}"


def _legend(kinds: Iterable[str], ways: Iterable[str]) -> Iterator[str]:
    """Yield a table of what the colours of the nodes and the forms of the ways mean, as a node of its own."""
    rows = [
        f'<tr><td bgcolor="{look.colour}" width="24"> </td><td align="left">{look.legend}</td></tr>'
        for kind, look in KINDS.items()
        if kind in kinds
    ]
    named = {"absent": ("- - -|", "must not happen"), "reads": (". . .&gt;", "is read")}
    rows += [
        f'<tr><td>{named[way][0]}</td><td align="left">{named[way][1]}</td></tr>'
        for way in named
        if way in ways
    ]
    if rows:
        table = f'<table border="0" cellspacing="2">{"".join(rows)}</table>'
        yield f"  legend [shape=plaintext style=solid fontsize=10 label=<{table}>]"


def _quoted(text: str) -> str:
    """Return a text as a string of Graphviz, in which a line break is centered.

    Graphviz would put the character in place of an entity (``&#27;``), and any character as it is into an SVG file.
    """
    plain = _ENTITY.sub(r"\\x26", printable(text))
    plain = plain.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + plain.replace("\n", "\\n") + '"'
