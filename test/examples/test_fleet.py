"""``examples/fleet``: a restored robot continues, and a killed fleet loses and repeats no output."""

import json
import os
import re
import shlex
import signal
import sqlite3
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from random import Random
from types import ModuleType
from typing import Any, List

import pytest
from script_modules import load_script
from subprocess_python_path import python_path

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "examples" / "fleet"
PAGE = FOLDER / "README.md"

DYING = """
import os, runpy, signal
from bytewax.connectors.files import FileSink

left, build = {lines}, FileSink.build_part

def build_part(*arguments):
    part = build(*arguments)
    write = part.write_batch

    def write_and_die(lines):
        global left
        write(lines)
        left -= len(lines)
        if left <= 0:
            os.kill(os.getpid(), signal.SIGKILL)

    part.write_batch = write_and_die
    return part

FileSink.build_part = build_part
runpy.run_module("bytewax.run", run_name="__main__")
"""
"""The command of Bytewax in a process that is killed after some lines, before it stores the state."""


def load_module(name: str) -> ModuleType:
    return load_script(FOLDER / f"{name}.py", f"fleet_{name}")


robot = load_module("robot")
make_events = load_module("make_events")


def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def write_events(events: Any, path: Path) -> None:
    path.write_text("".join(json.dumps(event) + "\n" for event in events), encoding="utf-8")


def by_robot(text: str) -> Any:
    """Return the outputs of each robot in their order; the order between robots is not defined."""
    outputs = defaultdict(list)
    for line in text.splitlines():
        output = json.loads(line)
        outputs[output.pop("robot")].append(output)
    return outputs


def run(folder: Any, *arguments: Any, stdin: Any = os.devnull) -> Any:
    """Run Python in a folder with this package; return the ended process."""
    with open(stdin, encoding="utf-8") as lines:
        return subprocess.run(
            [sys.executable, *map(str, arguments)],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": python_path()},
            stdin=lines,
            capture_output=True,
            text=True,
            timeout=120,
        )


def run_in_shell(folder: Any, *commands: Any) -> None:
    """Run commands in a folder with links to the clone, with this Python."""
    for name in ("examples", "src"):
        if not (folder / name).exists():
            (folder / name).symlink_to(ROOT / name)
    search_path = shlex.quote(python_path())
    script = "\n".join(
        [
            f'python3() {{ PYTHONPATH="$PYTHONPATH:"{search_path} {shlex.quote(sys.executable)} "$@"; }}',
            "set -eo pipefail",
            *commands,
        ]
    )
    process = subprocess.run(["bash", "-c", script], cwd=folder, capture_output=True, text=True, timeout=120)
    assert process.returncode == 0, process.stdout + process.stderr


def test_restored_robot_has_same_outputs() -> None:
    events = make_events.events(robots=1, seconds=90, seed=3)
    undisturbed = robot.Robot()
    expected = [output for event in events for output in undisturbed.take(event["time"], event["event"])]
    functors = {output["output"].partition("(")[0] for output in expected}
    assert functors == {"shelf_at", "delivered", "bumped", "overdue"}
    chance = Random(7)
    restored, outputs = robot.Robot(), []
    for event in events:
        if chance.random() < 0.1:
            restored = robot.Robot(restored.snapshot())
        outputs += restored.take(event["time"], event["event"])
    assert outputs == expected


def test_time_advances_without_events() -> None:
    parcel_robot = robot.Robot()
    assert parcel_robot.take(1, "picked(parcel)") == []
    (output,) = parcel_robot.take(60)
    assert output == {"number": 1, "topic": "parcels", "output": "overdue(parcel)"}


def test_invalid_event_is_an_error_output() -> None:
    (output,) = robot.Robot().take(1, "picked(")
    assert output["topic"] == "errors"
    assert "picked(" in output["output"]


def test_page_names_all_files() -> None:
    names = set(re.findall(r"`([\w.]+\.(?:py|txt))` ", text_of(PAGE).replace("`,", "` ")))
    assert names >= {path.name for path in FOLDER.iterdir() if path.suffix in (".py", ".txt")}


def test_seed_determines_events(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    make_events.main([str(path), "--robots", "2", "--seconds", "30"])
    lines = text_of(path).splitlines()
    assert [json.loads(line) for line in lines] == make_events.events(robots=2, seconds=30)


@pytest.mark.slow
def test_killed_fleet_loses_and_repeats_nothing(tmp_path: Path) -> None:
    """Run the commands of the page with a snapshot per batch, because those of a clock would vary."""
    pytest.importorskip("bytewax", reason="bytewax is not installed: it has wheels for some Pythons only")
    *before, start, plain, compare = re.findall(r"^    (\S.*)$", text_of(PAGE), re.MULTILINE)
    run_in_shell(tmp_path, *before, "head -n 1500 events.jsonl > some", "mv some events.jsonl")
    words = shlex.split(start.replace("')\"", "', 50)\"").replace("-s 1", "-s 0"))
    assert words[:3] == ["python3", "-m", "bytewax.run"]
    assert words[3].endswith(", 50)")
    chance = Random(15)
    for _ in range(3):
        dying = DYING.format(lines=chance.randrange(20, 50))
        process = run(tmp_path, "-c", dying, *words[3:])
        assert process.returncode == -signal.SIGKILL, process.stderr
    last_process = run(tmp_path, *words[1:])
    assert last_process.returncode == 0, last_process.stderr
    run_in_shell(tmp_path, plain, compare)
    assert len(by_robot(text_of(tmp_path / "outputs.jsonl"))) == 20
    epochs = resume_epochs(tmp_path / "recovery")
    # No dataflow begins at the same snapshot as the previous one.
    assert len(epochs) == len(set(epochs)) == 4


@pytest.mark.slow
def test_flink_has_same_outputs(tmp_path: Path) -> None:
    pytest.importorskip("pyflink", reason="Apache Flink is not installed: it takes 800 MB, and Java")
    write_events(make_events.events(robots=20, seconds=600), tmp_path / "events.jsonl")
    expected = by_robot(run(tmp_path, FOLDER / "plain.py", stdin=tmp_path / "events.jsonl").stdout)
    process = run(tmp_path, FOLDER / "fleet_flink.py", "events.jsonl", "outputs", "checkpoints")
    assert process.returncode == 0, process.stderr
    parts = [text_of(path) for path in (tmp_path / "outputs").rglob("part-*")]
    assert by_robot("".join(parts)) == expected


def resume_epochs(recovery: Path) -> List[Any]:
    """Return the snapshot that each start of a dataflow has resumed."""
    epochs: List[Any] = []
    for path in recovery.glob("*.sqlite3"):
        with sqlite3.connect(str(path)) as store:
            epochs += [
                epoch for _, epoch in store.execute("SELECT ex_num, resume_epoch FROM exs ORDER BY ex_num")
            ]
    return sorted(epochs)
