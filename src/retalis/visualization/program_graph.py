"""A program as a graph: which topics become which events, which rules take them, and where they go.

The graph of a program as text for Graphviz, and drawn by its command ``dot``.
"""

import re
import subprocess
from pathlib import Path
from shutil import which
from textwrap import wrap
from types import MappingProxyType
from typing import Any, Dict, Hashable, Iterable, Iterator, List, Mapping, NamedTuple, Optional, Set, Tuple

from ..engine.engine import Engine
from ..events.language.pattern_tree import Occurs, own_terms, walk
from ..events.language.rule_parser import ALARMS, SYNCHRONIZED, sets_timer
from ..foundation.errors import UsageError, beginning, counted, printable
from ..prolog.terms.list_terms import list_items, list_parts
from ..prolog.terms.term_traversal import variables
from ..prolog.terms.types import Atom, Functor, Term, Var, atom, deref, functor

MAX_NODES = 150
"""Nodes of a graph: nobody can read a larger one."""

MAX_TERMS_VISITED = 100_000
"""Terms that are looked at for what goals make and read, in all rules together."""

MAX_LABEL_CHARACTERS = 200
"""Characters of a text in a graph."""

_MAKES = frozenset(
    (*(functor("new_event", arity) for arity in (2, 3, 5)), functor("event", 1), functor("event", 2))
)
_READS = frozenset(
    functor(name, arity)
    for name, arity in (
        *(("prev", 5), ("prev_binary", 5), ("next", 6), ("next_binary", 6), ("next_inf", 5)),
        *(("newest_matching", 4), ("prev_matching", 5), ("next_inf_matching", 5), ("next_matching", 6)),
        *(("access_mem", 3), ("memory_size", 2), ("memory_counter", 2)),
    )
)
_CHAIN = functor("pose_chain", 3)

ANY = "any event"

_NO_EVENT = atom("null_event")
"""The head of rules that are there for what they do."""


class GraphNode(NamedTuple):
    """Something that events come from, pass or go to.

    Attributes:
        id: its own.
        kind: ``topic``, ``event``, ``rule``, ``query``, ``memory`` or ``output``.
        label: what to call it in short.
        text: the same at length.
    """

    id: str
    kind: str
    label: str
    text: str


class GraphEdge(NamedTuple):
    """A way that events take, or what is read on it.

    Attributes:
        source: the id of a node.
        target: the same.
        rate: the name of the counter that says how often it is taken; empty where none does.
        kind: ``flow``, ``absent`` for an event that must not happen, or ``reads`` for a memory that is asked.
    """

    source: str
    target: str
    rate: str
    kind: str


class Graph(NamedTuple):
    """A program as a graph; ``left_out`` counts the nodes of the program that have no place in it."""

    nodes: List[GraphNode]
    edges: List[GraphEdge]
    left_out: int


class GraphTopic(NamedTuple):
    """A topic that becomes events: its name, and the functor's name of these."""

    name: str
    event: str


def graph_key(engine: Engine, topics: Iterable[GraphTopic]) -> Hashable:
    """Return a key that is another one when the graph of a program has changed."""
    parts = engine
    return (
        tuple([rule.serial for rule in parts.rules.rules]),
        tuple([id(one) for one in list(parts.knowledge.memories)]),
        tuple([id(one) for _, one in parts.knowledge.subscriptions.items()]),
        tuple([id(one) for one in parts.knowledge.states]),
        tuple(topics),
    )


def program_graph(engine: Engine, topics: Iterable[GraphTopic] = ()) -> Graph:
    """Return the graph of the program that an engine runs.

    Like `Engine.status` it looks without the engine's lock.
    """
    return _GraphBuilder(engine).build(list(topics))


class _GraphBuilder:
    def __init__(self, engine: Engine):
        self._parts = engine
        self._nodes: Dict[str, GraphNode] = {}
        self._edges: Dict[Tuple[str, str, str], GraphEdge] = {}
        self._left_out: Set[str] = set()
        self._terms = MAX_TERMS_VISITED

    def build(self, topics: List[GraphTopic]) -> Graph:
        for at, rule in enumerate(self._parts.rules.rules):
            self._rule(at, rule)
        for instance in list(self._parts.knowledge.memories):
            self._memory(instance)
        for (topic, _), one in self._parts.knowledge.subscriptions.items():
            output = self._node("output", topic, topic)
            self._edge(self._event(one.listener.pattern), output, f"output:{beginning(topic)}")
        for state in self._parts.knowledge.states:
            event = self._event(state.form.state)
            self._edge(self._event(state.form.begins), event, "")
            self._edge(self._event(state.form.ends), event, "")
        self._topics(topics)
        return Graph(list(self._nodes.values()), list(self._edges.values()), len(self._left_out))

    def _topics(self, topics: List[GraphTopic]) -> None:
        """Add the topics, and the way to their events for each arity that the program takes."""
        for topic in topics:
            there = [
                node
                for node in self._nodes.values()
                if node.kind == "event" and node.label.rpartition("/")[0] == topic.event
            ]
            source = self._node("topic", topic.name, f"{topic.name} ({topic.event})")
            for node in there:
                self._edge(source, node.id, f"topic:{topic.name}")

    def _rule(self, at: int, rule: Any) -> None:
        definition = rule.definition
        text = self._text(definition.term, definition.names)
        label = "" if definition.label is None else self._text(definition.label)
        place = definition.place
        short = label or (f"{_file(place.source)}:{place.line}" if place is not None else f"rule {at + 1}")
        node = self._node("rule", f"{at}", text, short)
        wanted = {id(part) for part in walk(definition.pattern)}
        goals: List[Term] = []
        for part in walk(definition.pattern, negated=True):
            if isinstance(part, Occurs):
                kind = "flow" if id(part) in wanted else "absent"
                event = self._event(part.term)
                self._edge(event, node, event if kind == "flow" else "", kind)
            else:
                goals += own_terms(part)
        self._goals(node, goals)
        if definition.head is not None:
            self._head(node, at, deref(definition.head))

    def _text(self, term: Term, names: Mapping[Var, str] = MappingProxyType({})) -> str:
        """Return the beginning of a term's text, the same for each drawing: a variable without a name is ``_``."""
        return self._parts.logic.brief(term, {**dict.fromkeys(variables(term), "_"), **names})

    def _head(self, node: str, at: int, head: Term) -> None:
        """Add the way from a rule to what it fires."""
        if head is _NO_EVENT:
            return
        if head.__class__ is tuple and head[0] in ALARMS:
            head = deref(head[1])
        if head.__class__ is not tuple or head[0] not in SYNCHRONIZED:
            self._edge(node, self._event(head), f"rule:{at}")
            return
        asked = self._text(deref(head[2]))
        query = self._node(
            "query", f"{at}", f"waits for its memories, then asks {asked}", _name(deref(head[2]))
        )
        self._edge(node, query, f"rule:{at}")
        self._edge(query, self._event(deref(head[1])), "")
        for pair in list_items(head[3]) or ():
            of_memory = list_items(pair)
            name = deref(of_memory[0]) if of_memory else None
            if isinstance(name, Atom):
                self._edge(_id("memory", name.name), query, "", "reads")
        self._goals(query, [head[2]])

    def _memory(self, instance: Any) -> None:
        name = self._text(instance.id)
        plain = getattr(instance.id, "name", name)
        memory = self._node("memory", plain, f"memory {name}", name)
        self._edge(self._event(instance.recorder.pattern), memory, f"memory:{name}")

    def _goals(self, node: str, goals: List[Term]) -> None:
        """Add the events that goals make and the memories that they read, and so those of the clauses they call."""
        for term in self._called(goals):
            if term[0] in _MAKES or sets_timer(term):
                event = self._event(deref(term[1]))
                self._edge(node, event, event)
            elif term[0] in _READS or term[0] is _CHAIN:
                names = list_parts(term[1])[0] if term[0] is _CHAIN else [term[1]]
                for name in map(deref, names):
                    if isinstance(name, Atom):
                        self._edge(_id("memory", name.name), node, "", "reads")

    def _called(self, goals: List[Term]) -> Iterator[Any]:
        """Yield all compound terms in goals and in the program's clauses that they name."""
        predicates = self._parts.logic.database.predicates
        seen: Set[Functor] = set()
        left = list(goals)
        while left and self._terms > 0:
            self._terms -= 1
            term = deref(left.pop())
            key = _functor(term)
            if key is None:
                continue
            if key not in seen:
                seen.add(key)
                predicate = predicates.get(key)
                if predicate is not None and not predicate.library:
                    left += [clause.body for clause in predicate.live() if not clause.fact]
            if term.__class__ is tuple:
                yield term
                left += term[1:]

    def _event(self, pattern: Term) -> str:
        """Return the node of the events of a pattern."""
        key = _functor(deref(pattern))
        if key is None:
            return self._node("event", ANY, "events of all kinds")
        return self._node("event", str(key), str(key))

    def _node(self, kind: str, name: str, text: str, label: str = "") -> str:
        """Return the id of a node, which is made where it is not there; the id of none where there are too many."""
        found = _id(kind, name)
        if found not in self._nodes:
            if len(self._nodes) >= MAX_NODES:
                self._left_out.add(found)
            else:
                self._nodes[found] = GraphNode(
                    found, kind, beginning(label or name), beginning(text, MAX_LABEL_CHARACTERS)
                )
        return found

    def _edge(self, source: str, target: str, rate: str, kind: str = "flow") -> None:
        self._edges.setdefault((source, target, kind), GraphEdge(source, target, rate, kind))


def _id(kind: str, name: str) -> str:
    return f"{kind}:{beginning(name)}"


def _functor(term: Term) -> Optional[Functor]:
    """Return the functor of an atom or a compound term."""
    found: Optional[Functor] = term[0] if term.__class__ is tuple else getattr(term, "functor", None)
    return found


def _name(goal: Term) -> str:
    """Return what a goal calls."""
    key = _functor(goal)
    return "query" if key is None else key.name


def _file(source: Optional[str]) -> str:
    return (source or "").rpartition("/")[2]


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
