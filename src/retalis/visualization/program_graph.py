"""Graph of a program: topics, events, rules, queries, memories, transforms, facts, outputs, and the flow of events.

`program_graph` derives the graph from the engine's rules, memories and subscriptions. Goals of rules are searched for
events that they create, and memories, states, transforms and facts that they read, also in the clauses that they
call, up to a limit. `dot_text` writes the graph in the DOT language of Graphviz, and `draw_graph` renders it with the
command ``dot``.
"""

import os
import re
import subprocess
from pathlib import Path
from shutil import which
from textwrap import wrap
from types import MappingProxyType
from typing import (
    Any,
    Dict,
    FrozenSet,
    Hashable,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Set,
    Tuple,
)

from ..engine.engine import Engine
from ..engine.loaded_items import LoadedProgram
from ..events.knowledge.transform_predicates import TF, TRANSFORM_PREDICATES
from ..events.language.pattern_tree import EventPattern, own_terms, walk
from ..events.language.rule_heads import ALARMS, SYNCHRONIZED
from ..events.language.rule_labels import rule_title
from ..events.language.state_parser import queried_state
from ..events.language.timer_schedules import sets_timer
from ..foundation.displayed_text import MAX_SHOWN_CHARACTERS, format_count, printable, shorten
from ..foundation.errors import UsageError
from ..foundation.output_files import replace_file
from ..foundation.source_places import line_of
from ..prolog.database.predicate import Predicate
from ..prolog.terms.list_terms import list_items, list_parts
from ..prolog.terms.term_traversal import variables
from ..prolog.terms.types import Atom, Functor, Term, Var, atom, deref, functor, functor_of

MAX_NODES = 150
"""Maximum number of nodes of a graph; larger graphs are not readable."""

MAX_TERMS_VISITED = 100_000
"""Maximum number of terms that are searched for created events and read memories, in all rules together."""

MAX_LABEL_CHARACTERS = 200
"""Maximum length of a text in a graph."""

_CREATING_GOALS = frozenset(
    (*(functor("new_event", arity) for arity in (2, 3, 5)), functor("event", 1), functor("event", 2))
)
"""Goals that create the event in their first argument."""

_READING_GOALS = frozenset(
    (
        functor("prev", 5),
        functor("prev_binary", 5),
        functor("next", 6),
        functor("next_binary", 6),
        functor("next_inf", 5),
        functor("newest_matching", 4),
        functor("prev_matching", 5),
        functor("next_inf_matching", 5),
        functor("next_matching", 6),
        functor("access_mem", 3),
        functor("memory_size", 2),
        functor("memory_counter", 2),
    )
)
"""Goals that read the memory in their first argument."""

_POSE_CHAIN = functor("pose_chain", 3)
"""Goal that reads the memories of a list in its first argument."""

_TRANSFORM_STORING_GOALS = frozenset((functor("tf_add", 4), functor("tf_add_static", 3)))

_FACT_STORING_GOALS = frozenset(
    functor(name, 1) for name in ("assert", "asserta", "assertz", "retract", "retractall")
)
"""Goals that add or remove the fact in their argument."""

_KIND_PLURALS = {"memory": "memories", "transforms": "transforms"}

ANY_EVENT_LABEL = "any event"
"""Label of the node for patterns that match events of all functors."""

_NULL_EVENT = atom("null_event")
"""Head of rules without an event, which exist for their actions."""


class GraphNode(NamedTuple):
    """A source, processing step, or destination of events.

    Attributes:
        id: unique identifier.
        kind: ``topic``, ``event``, ``rule``, ``query``, ``memory``, ``transforms``, ``facts`` or ``output``.
        label: short name; of a rule, its name and place.
        text: full description.
    """

    id: str
    kind: str
    label: str
    text: str


class GraphEdge(NamedTuple):
    """A flow of events between two nodes, or a read access.

    Attributes:
        source: id of a node.
        target: id of a node.
        rate: name of the counter of its events; empty if there is none.
        kind: ``flow``, ``absent`` for an event that must not happen, or ``reads`` for a query of a memory, a state,
            transforms or facts.
    """

    source: str
    target: str
    rate: str
    kind: str


class Graph(NamedTuple):
    """A program as a graph; ``omitted_count`` is the number of nodes beyond `MAX_NODES`."""

    nodes: List[GraphNode]
    edges: List[GraphEdge]
    omitted_count: int


class GraphTopic(NamedTuple):
    """An input topic: its name, and the functor name of its events."""

    name: str
    event: str


def graph_key(engine: Engine, topics: Iterable[GraphTopic]) -> Hashable:
    """Return a key that changes when the graph of the program changes."""
    rules, knowledge = engine.program.rules, engine.program.knowledge
    return (
        tuple([rule.serial for rule in rules.rules]),
        tuple([id(memory) for memory in list(knowledge.memories)]),
        tuple([id(subscription) for _, subscription in knowledge.subscriptions.items()]),
        tuple([id(state) for state in knowledge.states]),
        tuple(topics),
    )


def program_graph(engine: Engine, topics: Iterable[GraphTopic] = ()) -> Graph:
    """Return the graph of the program that an engine runs.

    Like `Engine.status`, this reads without the engine's lock.
    """
    return _GraphBuilder(engine.program).build(list(topics))


class _GraphBuilder:
    """Builder of the graph of an engine's program."""

    def __init__(self, program: LoadedProgram):
        self._program = program
        self._nodes: Dict[str, GraphNode] = {}
        self._edges: Dict[Tuple[str, str, str], GraphEdge] = {}
        self._omitted_node_ids: Set[str] = set()
        self._remaining_terms = MAX_TERMS_VISITED

    def build(self, topics: List[GraphTopic]) -> Graph:
        for index, rule in enumerate(self._program.rules.rules):
            self._add_rule(index, rule)
        for instance in list(self._program.knowledge.memories):
            self._add_memory(instance)
        for (topic, _), subscription in self._program.knowledge.subscriptions.items():
            output = self._add_node("output", topic, topic)
            self._add_edge(self._add_event(subscription.listener.pattern), output, f"output:{shorten(topic)}")
        for state in self._program.knowledge.states:
            event = self._add_event(state.form.state)
            self._add_edge(self._add_event(state.form.begin_event), event, "")
            self._add_edge(self._add_event(state.form.end_event), event, "")
        self._add_topics(topics)
        return Graph(list(self._nodes.values()), list(self._edges.values()), len(self._omitted_node_ids))

    def _add_topics(self, topics: List[GraphTopic]) -> None:
        """Add the topics, with an edge to their events of each arity that the program uses."""
        for topic in topics:
            events = [
                node
                for node in self._nodes.values()
                if node.kind == "event" and node.label.rpartition("/")[0] == topic.event
            ]
            source = self._add_node("topic", topic.name, f"{topic.name} ({topic.event})")
            for node in events:
                self._add_edge(source, node.id, f"topic:{topic.name}")

    def _add_rule(self, index: int, rule: Any) -> None:
        definition = rule.definition
        text = self._format_term(definition.term, definition.names)
        title = rule_title(rule.name, os.path.basename(line_of(rule.place)))
        node = self._add_node("rule", f"{index}", text, title)
        # An event within a negated part of the pattern is drawn as absent.
        positive_parts = {id(part) for part in walk(definition.pattern)}
        goals: List[Term] = []
        for part in walk(definition.pattern, negated=True):
            if isinstance(part, EventPattern):
                kind = "flow" if id(part) in positive_parts else "absent"
                event = self._add_event(part.term)
                self._add_edge(event, node, event if kind == "flow" else "", kind)
            else:
                goals += own_terms(part)
        self._add_goals(node, goals)
        if definition.head is not None:
            self._add_head(node, index, deref(definition.head))

    def _format_term(self, term: Term, names: Mapping[Var, str] = MappingProxyType({})) -> str:
        """Return the shortened text of a term. Unnamed variables become ``_``, so that drawings are stable."""
        names = {**dict.fromkeys(variables(term), "_"), **names}
        return self._program.logic.show(term, names=names, longest=MAX_SHOWN_CHARACTERS, spacing=True)

    def _add_head(self, node: str, index: int, head: Term) -> None:
        """Add the edges from a rule to the events that it fires."""
        if head is _NULL_EVENT:
            return
        if head.__class__ is tuple and head[0] in ALARMS:
            head = deref(head[1])
        if head.__class__ is not tuple or head[0] not in SYNCHRONIZED:
            self._add_edge(node, self._add_event(head), f"rule:{index}")
            return
        sources = self._find_awaited_sources(head[3])
        query = self._add_node(
            "query",
            f"{index}",
            f"waits for its {_name_kinds(sources)}, then asks {self._format_term(deref(head[2]))}",
            _get_predicate_name(deref(head[2])),
        )
        self._add_edge(node, query, f"rule:{index}")
        self._add_edge(query, self._add_event(deref(head[1])), "")
        for source in sources:
            self._add_edge(source, query, "", "reads")
        self._add_goals(query, [head[2]])

    def _find_awaited_sources(self, conditions: Term) -> List[str]:
        """Return the ids of the memories and of the transforms that the conditions of a synchronized query name."""
        sources = []
        for pair in list_items(conditions) or ():
            items = list_items(pair)
            name: Any = deref(items[0]) if items else None
            if isinstance(name, Atom):
                sources.append(_make_node_id("memory", name.name))
            elif functor_of(name) is TF:
                is_memory = not variables(name) and self._program.knowledge.memories.find(name) is not None
                sources.append(
                    _make_node_id("memory", self._program.logic.brief(name))
                    if is_memory
                    else self._add_transforms()
                )
        return sources

    def _add_transforms(self) -> str:
        """Return the id of the node for the tree of transforms."""
        return self._add_node("transforms", "transforms", "tree of the transforms on /tf and /tf_static")

    def _add_memory(self, memory_instance: Any) -> None:
        # Ids can be compound terms, so the text is used if there is no name. It is the text in the status of the
        # engine, because the edge names the counter of the memory.
        name = self._program.logic.brief(memory_instance.id)
        plain_name = getattr(memory_instance.id, "name", name)
        memory = self._add_node("memory", plain_name, f"memory {name}", name)
        self._add_edge(self._add_event(memory_instance.recorder.pattern), memory, f"memory:{name}")

    def _add_goals(self, node: str, goals: List[Term]) -> None:
        """Add edges for the events that goals create, and for what they read or store.

        The clauses that the goals call are included.
        """
        for term in self._find_called_terms(goals):
            self._add_facts(node, term)
            if term.__class__ is not tuple:
                continue
            state = queried_state(term)
            if state is not None:
                self._add_edge(self._add_node("event", str(state), str(state)), node, "", "reads")
            elif term[0] in _CREATING_GOALS or sets_timer(term):
                event = self._add_event(deref(term[1]))
                self._add_edge(node, event, event)
            elif term[0] in _READING_GOALS or term[0] is _POSE_CHAIN:
                names = list_parts(term[1])[0] if term[0] is _POSE_CHAIN else [term[1]]
                for name in map(deref, names):
                    if isinstance(name, Atom):
                        self._add_edge(_make_node_id("memory", name.name), node, "", "reads")
            elif term[0] in TRANSFORM_PREDICATES:
                self._add_edge(self._add_transforms(), node, "", "reads")
            elif term[0] in _TRANSFORM_STORING_GOALS:
                self._add_edge(node, self._add_transforms(), "")

    def _add_facts(self, node: str, term: Any) -> None:
        """Add an edge if a goal reads, adds or removes facts of the program."""
        is_storing = term.__class__ is tuple and term[0] in _FACT_STORING_GOALS
        key = functor_of(deref(term[1]) if is_storing else term)
        predicate = None if key is None else self._program.logic.database.predicates.get(key)
        if predicate is None or not (is_storing or _has_facts_only(predicate)):
            return
        facts = self._add_node("facts", str(key), f"facts of {key}")
        if is_storing:
            self._add_edge(node, facts, "")
        else:
            self._add_edge(facts, node, "", "reads")

    def _find_called_terms(self, goals: List[Term]) -> Iterator[Any]:
        """Yield all atoms and compound terms in goals, and in the bodies of the program's clauses that they call."""
        predicates = self._program.logic.database.predicates
        # Each predicate is expanded once, because clauses may be recursive.
        expanded: Set[Functor] = set()
        pending = list(goals)
        # The limit is shared by all rules, so that a large program is searched incompletely instead of slowly.
        while pending and self._remaining_terms > 0:
            self._remaining_terms -= 1
            term = deref(pending.pop())
            key = functor_of(term)
            # A variable or a number. The goal that a variable stands for is known at run time only.
            if key is None:
                continue
            if key not in expanded:
                expanded.add(key)
                predicate = predicates.get(key)
                if predicate is not None and not predicate.is_library_predicate:
                    pending += [clause.body for clause in predicate.active_clauses() if not clause.is_fact]
            yield term
            # A fact that is added is not called.
            if term.__class__ is tuple and key not in _FACT_STORING_GOALS:
                pending += term[1:]

    def _add_event(self, pattern: Term) -> str:
        """Return the id of the node for the events of a pattern."""
        key = functor_of(deref(pattern))
        if key is None:
            return self._add_node("event", ANY_EVENT_LABEL, "events of all kinds")
        return self._add_node("event", str(key), str(key))

    def _add_node(self, kind: str, name: str, text: str, label: str = "") -> str:
        """Return the id of a node, which is added unless it exists or the graph is full."""
        node_id = _make_node_id(kind, name)
        if node_id not in self._nodes:
            # Ids of omitted nodes are collected, so that each is counted once. Edges to them are skipped when the
            # graph is drawn.
            if len(self._nodes) >= MAX_NODES:
                self._omitted_node_ids.add(node_id)
            else:
                self._nodes[node_id] = GraphNode(
                    node_id, kind, shorten(label or name), shorten(text, MAX_LABEL_CHARACTERS)
                )
        return node_id

    def _add_edge(self, source: str, target: str, rate: str, kind: str = "flow") -> None:
        # Several goals of a rule can create the same event; one edge is drawn.
        self._edges.setdefault((source, target, kind), GraphEdge(source, target, rate, kind))


def _has_facts_only(predicate: Predicate) -> bool:
    """Return whether a predicate of the program has facts and no clauses with a body."""
    if predicate.is_library_predicate:
        return False
    clauses = list(predicate.active_clauses())
    return (bool(clauses) or predicate.dynamic) and all(clause.is_fact for clause in clauses)


def _make_node_id(kind: str, name: str) -> str:
    return f"{kind}:{shorten(name)}"


def _name_kinds(ids: Iterable[str]) -> str:
    """Return the kinds of the nodes that a query waits for, as text."""
    kinds = {node_id.partition(":")[0] for node_id in ids}
    return " and ".join(_KIND_PLURALS[kind] for kind in sorted(kinds)) or "memories"


def _get_predicate_name(goal: Term) -> str:
    key = functor_of(goal)
    return "query" if key is None else key.name


PICTURE_SUFFIXES = ("svg", "png", "pdf")
"""Formats that ``dot`` can render."""

DOT_TIMEOUT_SECONDS = 60
"""Timeout for rendering in seconds."""

MAX_LINE_CHARACTERS, MAX_LINES = 38, 3
"""Maximum length and number of the lines of text in a node."""

_CHARACTER_POINTS, _LINE_POINTS, _PADDING_POINTS = 6.0, 13.0, 20.0
"""Mean width of a character, height of a line, and space around the text of a node, in points."""

_NODE_GAP_POINTS, _RANK_GAP_POINTS = 9, 32
"""Distances between nodes of a rank and between ranks, in points."""


class _NodeStyle(NamedTuple):
    """Appearance of a kind of nodes.

    Attributes:
        shape: name of a Graphviz shape.
        colour: fill colour.
        legend: description in the legend.
    """

    shape: str
    colour: str
    legend: str


NODE_STYLES = {
    "topic": _NodeStyle("cds", "#d7e9f5", "topic"),
    "event": _NodeStyle("box", "#eceff3", "event"),
    "rule": _NodeStyle("box", "#e8defa", "rule"),
    "query": _NodeStyle("hexagon", "#fdeccb", "query that waits for memories or transforms"),
    "memory": _NodeStyle("cylinder", "#d9f0df", "memory"),
    "transforms": _NodeStyle("cylinder", "#bce8dd", "transforms on /tf and /tf_static"),
    "facts": _NodeStyle("note", "#e9dfcc", "facts"),
    "output": _NodeStyle("cds", "#fbd3cb", "published topic"),
}

_ENTITY_START = re.compile(r"&(?=#?\w+;)")
_PACKAGE_PREFIX = re.compile(r"\b\w+?__0__")

EDGE_ATTRIBUTES = {
    "flow": "",
    "absent": 'style=dashed color="#b3261e" arrowhead=tee',
    "reads": 'style=dotted color="#3c7d50"',
}
"""Attributes of edges by kind: flow of events, events that must not happen, and what a rule or query reads."""


def dot_text(graph: Graph, title: str) -> str:
    """Return a graph in the DOT language, drawn from left to right or from top to bottom, with a legend."""
    node_names = {node.id: f"n{index}" for index, node in enumerate(graph.nodes)}
    # Edges can refer to nodes beyond the limit.
    edges = [edge for edge in graph.edges if edge.source in node_names and edge.target in node_names]
    omitted = f"; {format_count(graph.omitted_count, 'more node')} left out" if graph.omitted_count else ""
    lines = [
        "digraph program {",
        f"  label={_quote(title + omitted)} labelloc=t fontsize=16",
        f"  rankdir={_choose_direction(graph.nodes, edges)} nodesep={_NODE_GAP_POINTS / 72} "
        f'ranksep={_RANK_GAP_POINTS / 72} fontname="Helvetica"',
        '  node [fontname="Helvetica" fontsize=11 style="filled" color="#8592a3" height=0.3 margin="0.12,0.05"]',
        '  edge [color="#6b7887" arrowsize=0.7]',
        *(f"  {node_names[node.id]} [{_format_node(node)}]" for node in graph.nodes),
        *(
            f"  {node_names[edge.source]} -> {node_names[edge.target]} [{EDGE_ATTRIBUTES[edge.kind]}]"
            for edge in edges
        ),
        *_format_ranks(graph, node_names),
        *_format_legend({node.kind for node in graph.nodes}, {edge.kind for edge in edges}),
        "}",
    ]
    return "\n".join(lines) + "\n"


def _choose_direction(nodes: List[GraphNode], edges: List[GraphEdge]) -> str:
    """Return the direction in which the picture is nearer to a square: ``LR``, or ``TB`` for top to bottom.

    A rule is a wide node, so a chain of rules from left to right would be a strip that no screen shows whole.
    """
    ranks = _estimate_ranks(nodes, edges)
    sizes: Dict[int, List[Tuple[float, float]]] = {}
    for node in nodes:
        lines = _format_label(node).split("\n")
        width = _CHARACTER_POINTS * max(map(len, lines)) + _PADDING_POINTS
        sizes.setdefault(ranks[node.id], []).append((width, _LINE_POINTS * len(lines) + _PADDING_POINTS))
    extents = {}
    for direction, along, across in (("LR", 0, 1), ("TB", 1, 0)):
        length = sum(max(size[along] for size in rank) + _RANK_GAP_POINTS for rank in sizes.values())
        breadth = max(
            (sum(size[across] + _NODE_GAP_POINTS for size in rank) for rank in sizes.values()), default=1.0
        )
        extents[direction] = max(length, breadth) / max(1.0, min(length, breadth))
    return min(extents, key=lambda direction: extents[direction])


def _estimate_ranks(nodes: List[GraphNode], edges: List[GraphEdge]) -> Dict[str, int]:
    """Return the rank of each node: one more than the highest rank of its predecessors, without edges of cycles."""
    predecessors: Dict[str, List[str]] = {node.id: [] for node in nodes}
    for edge in edges:
        predecessors[edge.target].append(edge.source)
    ranks: Dict[str, int] = {}

    def find_rank(node_id: str, path: FrozenSet[str]) -> int:
        if node_id not in ranks:
            path |= {node_id}
            before = [find_rank(other, path) for other in predecessors[node_id] if other not in path]
            ranks[node_id] = max(before, default=-1) + 1
        return ranks[node_id]

    for node in nodes:
        # A path has at most `MAX_NODES` nodes, so the recursion is bounded.
        find_rank(node.id, frozenset())
    return ranks


def draw_graph(text: str, path: Path) -> None:
    """Render a text in the DOT language to a file, in the format of the file's suffix.

    Raises:
        UsageError: if Graphviz is not installed or reports an error, or the file cannot be written.
    """
    dot = which("dot")
    if dot is None:
        raise UsageError(
            f"drawing {path.name} needs the command dot of Graphviz (apt install graphviz); "
            f"without it, {path.with_suffix('.dot').name} can be written, which is the graph as text"
        )
    try:
        with replace_file(path) as new_path:
            _run_dot([dot, f"-T{path.suffix[1:]}", "-o", str(new_path)], text, path)
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from error


def _run_dot(command: List[str], text: str, path: Path) -> None:
    """Run the command dot with a text as its input; errors name the path."""
    try:
        process = subprocess.run(
            command,
            input=text,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=DOT_TIMEOUT_SECONDS,
        )
    except subprocess.TimeoutExpired:
        raise UsageError(f"dot has not drawn {path.name} in {DOT_TIMEOUT_SECONDS} s") from None
    if process.returncode:
        raise UsageError(f"dot cannot draw {path}: {process.stderr.strip()}")


def _format_node(node: GraphNode) -> str:
    style = NODE_STYLES[node.kind]
    rounded = ' style="filled,rounded"' if node.kind == "event" else ""
    # All texts of a program are quoted: a label could otherwise contain attributes or HTML.
    texts = f"label={_quote(_format_label(node))} tooltip={_quote(node.text)}"
    return f'{texts} shape={style.shape} fillcolor="{style.colour}"{rounded}'


def _format_label(node: GraphNode) -> str:
    return "\n".join([*_format_first_lines(node), *_format_further_lines(node)])


def _format_first_lines(node: GraphNode) -> List[str]:
    """Return the first lines of a node: its label without the package of a message; the place of a rule may wrap."""
    if node.kind == "rule":
        return wrap(_PACKAGE_PREFIX.sub("", node.label), MAX_LINE_CHARACTERS, break_long_words=False)
    return [node.label.rpartition("__0__")[2] if node.kind == "event" else node.label]


def _format_further_lines(node: GraphNode) -> List[str]:
    if node.kind == "event" and "__0__" in node.label:
        return [node.label.rpartition("__0__")[0]]
    if node.kind != "rule":
        return []
    # Long words are not broken, because a term is unreadable in the middle of a name.
    lines = wrap(_PACKAGE_PREFIX.sub("", node.text), MAX_LINE_CHARACTERS, break_long_words=False)
    return lines if len(lines) <= MAX_LINES else [*lines[: MAX_LINES - 1], lines[MAX_LINES - 1] + " ..."]


def _format_ranks(graph: Graph, node_names: Dict[str, str]) -> Iterator[str]:
    """Yield constraints that place topics in the first rank and outputs in the last one."""
    for kind, rank in (("topic", "source"), ("output", "sink")):
        nodes = [node_names[node.id] for node in graph.nodes if node.kind == kind]
        if nodes:
            yield f"  {{ rank={rank}; {'; '.join(nodes)} }}"


def _format_legend(kinds: Iterable[str], edge_kinds: Iterable[str]) -> Iterator[str]:
    """Yield a node with a table that explains the colours of nodes and the styles of edges."""
    # The legend shows only what occurs in this graph.
    rows = [
        f'<tr><td bgcolor="{style.colour}" width="24"> </td><td align="left">{style.legend}</td></tr>'
        for kind, style in NODE_STYLES.items()
        if kind in kinds
    ]
    edge_legend = {"absent": ("- - -|", "must not happen"), "reads": (". . .&gt;", "is read")}
    rows += [
        f'<tr><td>{edge_legend[edge_kind][0]}</td><td align="left">{edge_legend[edge_kind][1]}</td></tr>'
        for edge_kind in edge_legend
        if edge_kind in edge_kinds
    ]
    if rows:
        table = f'<table border="0" cellspacing="2">{"".join(rows)}</table>'
        yield f"  legend [shape=plaintext style=solid fontsize=10 label=<{table}>]"


def _quote(text: str) -> str:
    """Return a text as a Graphviz string, in which line breaks are centered.

    Entities are escaped: Graphviz would replace ``&#27;`` by the control character, and copy it into an SVG file.
    """
    escaped = _ENTITY_START.sub(r"\\x26", printable(text))
    escaped = escaped.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + escaped.replace("\n", "\\n") + '"'
