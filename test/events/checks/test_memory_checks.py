"""Checks of memories: missing ones, records that no memory has, and memories of size zero."""

from pathlib import Path
from typing import Any, List

import pytest

from retalis import Definitions, Engine


def warnings(folder: Any, rules: Any) -> List[Any]:
    engine = Engine()
    engine.load(rules=rules, goals="memorize(t(X), [], _, odom_base, 5)")
    return [
        warning.message
        for warning in engine.warnings(folder, Definitions())
        if "there is no memory" in warning.message
    ]


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        (
            "a <- b where prev(odom_bas, _, 1, 2, 3).",
            "there is no memory odom_bas yet; did you mean odom_base?",
        ),
        ("synchronized(a(T), true, [[odom_base, T], [heap, T]]) <- b(T).", "there is no memory heap yet"),
        ("a <- b where seen(_). seen(X) :- access_mem(haed, X, _).", "there is no memory haed yet"),
        ("a(P) <- b(T, R) where pose_chain([odom_base, head, R], T, P).", "there is no memory head yet"),
    ],
)
def test_missing_memory_is_reported(tmp_path: Path, rules: str, message: str) -> None:
    assert warnings(tmp_path, rules) == [message]


@pytest.mark.parametrize(
    "rules",
    [
        "a(X) <- b(X) where prev(X, _, 1, 2, 3).",
        "a <- b where (memorize(t(X), [], _, here, 5), access_mem(here, _, _)).",
        "a <- b where access_mem(odom_base, _, _). c :- next_inf(odom_base, _, 1, 2, 3).",
        "a <- b where prev_matching(odom_base, t(1), _, _, 3). c :- newest_matching(odom_base, _, _, _).",
        "a(N) <- b(N) do memorize(t(X), [], _, N, 5). c <- d where access_mem(there, _, _).",
    ],
)
def test_possible_memory_is_not_reported(tmp_path: Path, rules: str) -> None:
    assert warnings(tmp_path, rules) == []


@pytest.mark.parametrize(
    ("goal", "rules"),
    [
        ("memorize(t(X), [], X, m, 5)", "a <- b where access_mem(m, hot, _)."),
        ("memorize(t(_), [member(X, [1])], X, m, 5)", "a <- b where access_mem(m, hot, _)."),
        (
            "memorize(t(X), [], _, m, 5)",
            "a <- b where (access_mem(m, t(1), _), access_mem(m, R, _), R = t(_)).",
        ),
        (
            "memorize(t(X), [], o(X, Y), m, 5)",
            "a <- b where (newest_matching(m, o(1, 2), _, _), prev(M, m, 1, 2, 3)).",
        ),
        (
            "memorize(t(X), [], o(X), m, 5)",
            "a(N) <- b(N) do memorize(t(_), [], p(_), N, 5). c <- b where access_mem(m, q, _).",
        ),
        ("memorize(t(X), [], X, m, 5)", "synchronized(a(T), true, [[m, T]]) <- b(T)."),
    ],
)
def test_possible_record_is_not_reported(tmp_path: Path, goal: str, rules: str) -> None:
    engine = Engine()
    engine.load(rules=rules, goals=goal)
    texts = [warning.message for warning in engine.warnings(tmp_path, Definitions())]
    assert [text for text in texts if "record" in text or " comes " in text] == []


@pytest.mark.parametrize(
    ("size", "messages"), [(0, ["memory m keeps 0 records: write a size of 1 or more"]), (1, [])]
)
def test_memory_of_size_zero_is_reported(tmp_path: Path, size: int, messages: List[str]) -> None:
    engine = Engine()
    engine.load(rules=f":- memorize(t(X), [], X, m, {size}).")
    findings = engine.warnings(tmp_path, Definitions())
    assert [error.message.partition(": ")[2] for error in findings if "records" in error.message] == messages
