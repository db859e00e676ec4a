"""Graph of a program."""

from pathlib import Path
from typing import Any, Set

import pytest

from retalis import Engine
from retalis.visualization.program_graph import MAX_NODES, GraphEdge, GraphTopic, graph_key, program_graph

NAO = Path(__file__).resolve().parents[2] / "application_source"


def edges(rules: str = "", goals: str = "", topics: Any = ()) -> Set[Any]:
    engine = Engine()
    engine.load(rules=rules, goals=goals)
    return {(edge.source, edge.target, edge.kind) for edge in program_graph(engine, topics).edges}


def test_rule_connects_its_events() -> None:
    assert edges("l : alarm(X) <- smoke(X) seq heat(_).") == {
        ("event:smoke/1", "rule:0", "flow"),
        ("event:heat/1", "rule:0", "flow"),
        ("rule:0", "event:alarm/1", "flow"),
    }


def test_absent_event_has_own_edge_kind() -> None:
    graph_edges = edges("quiet <- (a seq c) cnot b.")
    assert ("event:b/0", "rule:0", "absent") in graph_edges
    assert ("event:a/0", "rule:0", "flow") in graph_edges


def test_clauses_of_goals_are_followed() -> None:
    graph_edges = edges(
        "null_event do act(X) <- go(X). act(X) :- \\+ busy, then(X). then(X) :- new_event(done(X), 1, 2). "
        "then(X) :- prev(fires, X, _, _, 5). busy :- act(1).",
        "memorize(fire(_), [], _, fires, 10)",
    )
    assert graph_edges == {
        ("event:go/1", "rule:0", "flow"),
        ("rule:0", "event:done/1", "flow"),
        ("memory:fires", "rule:0", "reads"),
        ("event:fire/1", "memory:fires", "flow"),
    }


def test_pose_chain_reads_its_memories() -> None:
    graph_edges = edges("a(P) <- b(T, R) where pose_chain([odom, R, head], T, P).")
    assert {edge for edge in graph_edges if "reads" in edge} == {
        ("memory:odom", "rule:0", "reads"),
        ("memory:head", "rule:0", "reads"),
    }


def test_alarms_and_goal_events_are_targets_of_rules() -> None:
    graph_edges = edges("exceptionAlarm(waited(S), 5) <- down(S). null_event do event(held(S)) <- waited(S).")
    assert {edge for edge in graph_edges if edge[0].startswith("rule")} == {
        ("rule:0", "event:waited/1", "flow"),
        ("rule:1", "event:held/1", "flow"),
    }


def test_memories_outputs_and_topics_have_edges() -> None:
    graph_edges = edges(
        goals="memorize(_, [], _, all, 10)\nsubscribe(std_msgs__0__String(_), [], _, echo, e)",
        topics=[GraphTopic("/chatter", "std_msgs__0__String"), GraphTopic("/unused", "std_msgs__0__Empty")],
    )
    assert graph_edges == {
        ("event:any event", "memory:all", "flow"),
        ("event:std_msgs__0__String/1", "output:echo", "flow"),
        ("topic:/chatter", "event:std_msgs__0__String/1", "flow"),
    }


def test_synchronized_query_reads_its_memories() -> None:
    graph_edges = edges("synchronized(seen(X), ask(X), [[odom, T], [head, T]]) <- marker(X, T).")
    assert graph_edges == {
        ("event:marker/2", "rule:0", "flow"),
        ("rule:0", "query:0", "flow"),
        ("query:0", "event:seen/1", "flow"),
        ("memory:odom", "query:0", "reads"),
        ("memory:head", "query:0", "reads"),
    }


def test_transforms_have_one_node() -> None:
    graph_edges = edges(
        "synchronized(seen(X), ask(X), [[tf(map, C), T], [odom, T]]) <- marker(X, C, T). "
        "near(P) <- ping(T) where (tf_lookup(map, base, T, P)). "
        "null_event do place(X) <- base(X). place(X) :- tf_add(map, base, 1, X). "
        "null_event do (tf_missing(a, b, 0, R), log(R)) <- lost."
    )
    assert {edge for edge in graph_edges if "transforms" in edge[0] + edge[1]} == {
        ("transforms:transforms", "query:0", "reads"),
        ("transforms:transforms", "rule:1", "reads"),
        ("rule:2", "transforms:transforms", "flow"),
        ("transforms:transforms", "rule:3", "reads"),
    }
    assert ("memory:odom", "query:0", "reads") in graph_edges


def test_facts_are_read_and_changed_by_rules() -> None:
    graph_edges = edges(
        "near(X) <- seen(X) where known(X). known(X) :- owner(X, _). owner(ann, desk). "
        "null_event do (retractall(count(_)), assertz(count(N))) <- tick(N). :- dynamic count/1. "
        "late(N) <- tock where enabled, count(N). enabled."
    )
    assert {edge for edge in graph_edges if "facts" in edge[0] + edge[1]} == {
        ("facts:owner/2", "rule:0", "reads"),
        ("rule:1", "facts:count/1", "flow"),
        ("facts:count/1", "rule:2", "reads"),
        ("facts:enabled/0", "rule:2", "reads"),
    }


def test_states_have_edges_to_querying_rules() -> None:
    graph_edges = edges(
        "alarm(R) <- bump(R) where holds(docked(R)). long(R) <- tick where idle(R). idle(R) :- holds(docked(R), _).",
        "state(docked(R), from(dock(R)), until(undock(R)))",
    )
    assert {
        ("event:dock/1", "event:docked/1", "flow"),
        ("event:undock/1", "event:docked/1", "flow"),
        ("event:docked/1", "rule:0", "reads"),
        ("event:docked/1", "rule:1", "reads"),
    } <= graph_edges


def test_memory_named_like_transform_is_a_memory() -> None:
    graph_edges = edges(
        "synchronized(seen(X), ask(X), [[tf(map, base), T]]) <- marker(X, T).",
        "memorize(pose(_), [], _, tf(map, base), 10)",
    )
    assert {edge for edge in graph_edges if "reads" in edge} == {("memory:tf(map,base)", "query:0", "reads")}


@pytest.mark.parametrize(
    ("conditions", "text"),
    [
        ("[tf(a, b), T]", "transforms"),
        ("[odom, T]", "memories"),
        ("[tf(a, b), T], [odom, T]", "memories and transforms"),
    ],
)
def test_text_of_query_names_awaited_items(conditions: str, text: str) -> None:
    engine = Engine()
    engine.load(rules=f"synchronized(seen(X), ask(X), [{conditions}]) <- marker(X, T).")
    (query,) = [node for node in program_graph(engine).nodes if node.kind == "query"]
    assert query.text == f"waits for its {text}, then asks ask(_)"


def test_nao_topic_has_path_to_output() -> None:
    engine = Engine()
    engine.load_program(NAO)
    graph = program_graph(engine, [GraphTopic("/tf", "tf__0__tfMessage")])
    assert graph.omitted_count == 0
    edges_by_ends = {(edge.source, edge.target): edge for edge in graph.edges}
    path = ["topic:/tf", "event:tf__0__tfMessage/1", "rule:0", "event:tf/4", "memory:odom_base", "query:2"]
    path += ["event:geometry_msgs__0__PoseStamped/2", "output:marker1"]
    for source, target in zip(path, path[1:]):
        assert (source, target) in edges_by_ends
    assert edges_by_ends["event:tf/4", "memory:odom_base"] == GraphEdge(
        "event:tf/4", "memory:odom_base", "memory:odom_base", "flow"
    )


def test_large_program_is_cut() -> None:
    engine = Engine()
    engine.load(rules=" ".join(f"a{number} <- b{number}." for number in range(100)))
    graph = program_graph(engine)
    assert (len(graph.nodes), graph.omitted_count) == (MAX_NODES, 300 - MAX_NODES)


@pytest.mark.parametrize(
    "change",
    [
        "memorize(fire, [], _, fires, 10)",
        "subscribe(fire, [], _, fires, 10)",
        "",
    ],
)
def test_key_changes_with_program(change: str) -> None:
    engine = Engine()
    engine.load(rules="a <- b.")
    before = graph_key(engine, ())
    assert graph_key(engine, ()) == before
    engine.event("b", 1)
    assert graph_key(engine, ()) == before
    if not change:
        engine.load(rules="c <- d.")
    else:
        assert engine.call(change)
    assert graph_key(engine, ()) != before
