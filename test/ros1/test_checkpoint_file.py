"""Checkpoint file of node ``retalis``: state after a kill, changed programs, damaged files."""

import os
import signal
import time
from pathlib import Path
from typing import Any

import pytest

from retalis.engine.checkpoints import read_checkpoint

RULES = "pair(X, Y) <- in(X) seq in(Y).\n"
GOALS = "compile_event_file('rules.txt')\nmemorize(in(_), [], _, m, 5)\n"
READY = "1 event rule"
"""Text that the node prints when it has loaded the program."""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    folder = tmp_path / "program"
    folder.mkdir()
    (folder / "pub_sub.xml").write_text("<publish_subscribe/>")
    (folder / "goalPredicates.txt").write_text(GOALS)
    (folder / "rules.txt").write_text(RULES)
    return folder


@pytest.fixture
def node(devel: Any, program: Path, tmp_path: Path) -> Any:
    """Return a function that starts the node and waits for it."""
    devel.start_master()

    def start() -> Any:
        before = devel.printed().count(READY)
        words = (f"_program:={program}", f"_checkpoint:={tmp_path}/state.db", "_direct:=false")
        process = devel.start(devel.executable("retalis_node"), *words)
        devel.expect(lambda nodes, services: devel.printed().count(READY) > before)
        devel.expect(lambda nodes, services: devel.pid("/retalis") is not None)
        return process

    return start


def kill(space: Any, process: Any) -> None:
    """Kill the node, as the kernel does if memory is short."""
    os.kill(space.pid("/retalis"), signal.SIGKILL)
    process.wait(60)


def written_at(path: Any) -> float:
    """Return the time at which the state in a file was written, 0 without a state."""
    checkpoint = read_checkpoint(path)
    return 0.0 if checkpoint is None else checkpoint.written_at


def test_killed_node_continues_from_checkpoint(devel: Any, node: Any, tmp_path: Path) -> None:
    path = tmp_path / "state.db"
    process = node()
    devel.run(
        "rosservice",
        "call",
        "/add_memory",
        "{event: 'pair(_,_)', conditions: '', format: _, id: pairs, size: '9'}",
    )
    devel.post_events("in(1)")
    devel.expect(lambda nodes, services: "in(1)" in devel.query("access_mem(m, R, _)"))
    now = time.time()
    devel.expect(lambda nodes, services: written_at(path) > now)
    kill(devel, process)
    process = node()
    assert f"restored from {path}, written" in devel.printed()
    devel.post_events("in(2)")
    devel.expect(lambda nodes, services: "pair(1,2)" in devel.query("access_mem(pairs, P, _)"))
    os.kill(devel.pid("/retalis"), signal.SIGINT)
    assert process.wait(60) == 0
    node()
    assert "pair(1,2)" in devel.query("access_mem(pairs, P, _)")
    assert "Traceback" not in devel.printed()


def test_invalid_checkpoint_is_not_restored(devel: Any, node: Any, program: Path, tmp_path: Path) -> None:
    path = tmp_path / "state.db"
    process = node()
    devel.expect(lambda nodes, services: written_at(path))
    kill(devel, process)
    (program / "rules.txt").write_text(RULES + "% changed\n")
    process = node()
    assert f"{path} is not restored: {program}/rules.txt has changed since it was read" in devel.printed()
    assert f"the node starts without state; the file is kept as {path}.aside" in devel.printed()
    devel.expect(lambda nodes, services: path.exists() and written_at(path))
    kill(devel, process)
    for name in ("state.db-wal", "state.db-shm"):
        if (tmp_path / name).exists():
            (tmp_path / name).unlink()
    path.write_bytes(b"damaged" * 1000)
    node()
    assert f"{path} is not restored: it is not a checkpoint, or is damaged" in devel.printed()
