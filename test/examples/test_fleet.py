"""``examples/fleet``: a robot goes on from its bytes, and a fleet that is killed loses and repeats nothing."""

import importlib.util
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

import pytest
from python_path import python_path

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
"""Bytewax's own command in a process that is killed when it has written some lines and not yet kept the state."""


def loaded(name):
    spec = importlib.util.spec_from_file_location(f"fleet_{name}", str(FOLDER / f"{name}.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


robot = loaded("robot")
make_events = loaded("make_events")


def text_of(path):
    return path.read_text(encoding="utf-8")


def written(events, path):
    path.write_text("".join(json.dumps(event) + "\n" for event in events), encoding="utf-8")


def by_robot(text):
    """Return the outputs of each robot, in their order; how robots alternate is nobody's business."""
    outputs = defaultdict(list)
    for line in text.splitlines():
        output = json.loads(line)
        outputs[output.pop("robot")].append(output)
    return outputs


def run(folder, *arguments, stdin=os.devnull):
    """Return a process that has run in a folder with this package, killed or not."""
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


def shell(folder, *commands):
    """Give commands as in the clone, with this Python; what they write stays in a folder."""
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
    done = subprocess.run(["bash", "-c", script], cwd=folder, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_robot_goes_on_from_its_state_anywhere():
    events = make_events.events(robots=1, seconds=90, seed=3)
    undisturbed = robot.Robot()
    wanted = [output for event in events for output in undisturbed.take(event["time"], event["event"])]
    kinds = {output["output"].partition("(")[0] for output in wanted}
    assert kinds == {"shelf_at", "delivered", "bumped", "overdue"}
    cut = Random(7)
    moved, outputs = robot.Robot(), []
    for event in events:
        if cut.random() < 0.1:
            moved = robot.Robot(moved.snapshot())
        outputs += moved.take(event["time"], event["event"])
    assert outputs == wanted


def test_time_passes_without_events():
    waiting = robot.Robot()
    assert waiting.take(1, "picked(parcel)") == []
    (output,) = waiting.take(60)
    assert output == {"number": 1, "topic": "parcels", "output": "overdue(parcel)"}


def test_an_event_that_cannot_be_read_is_an_output():
    (output,) = robot.Robot().take(1, "picked(")
    assert output["topic"] == "errors" and "picked(" in output["output"]


def test_the_page_names_the_files():
    named = set(re.findall(r"`([\w.]+\.(?:py|txt))` ", text_of(PAGE).replace("`,", "` ")))
    assert named >= {path.name for path in FOLDER.iterdir() if path.suffix in (".py", ".txt")}


def test_the_same_seed_makes_the_same_events(tmp_path):
    path = tmp_path / "events.jsonl"
    make_events.main([str(path), "--robots", "2", "--seconds", "30"])
    lines = text_of(path).splitlines()
    assert [json.loads(line) for line in lines] == make_events.events(robots=2, seconds=30)


@pytest.mark.slow
def test_a_fleet_that_is_killed_loses_nothing_and_repeats_nothing(tmp_path):
    """Give the commands of the page; a snapshot a batch, as a clock would choose other places each time."""
    pytest.importorskip("bytewax", reason="bytewax is not installed: it has wheels for some Pythons only")
    *before, start, plain, compare = re.findall(r"^    (\S.*)$", text_of(PAGE), re.MULTILINE)
    shell(tmp_path, *before, "head -n 1500 events.jsonl > some", "mv some events.jsonl")
    words = shlex.split(start.replace("')\"", "', 50)\"").replace("-s 1", "-s 0"))
    assert words[:3] == ["python3", "-m", "bytewax.run"] and words[3].endswith(", 50)")
    kill = Random(15)
    for _ in range(3):
        dying = DYING.format(lines=kill.randrange(20, 50))
        killed = run(tmp_path, "-c", dying, *words[3:])
        assert killed.returncode == -signal.SIGKILL, killed.stderr
    ended = run(tmp_path, *words[1:])
    assert ended.returncode == 0, ended.stderr
    shell(tmp_path, plain, compare)
    assert len(by_robot(text_of(tmp_path / "outputs.jsonl"))) == 20
    places = resumed(tmp_path / "recovery")
    assert len(places) == 4 and sorted(set(places)) == places, (
        "some dataflow began where the one before it had"
    )


@pytest.mark.slow
def test_the_same_fleet_on_flink(tmp_path):
    pytest.importorskip("pyflink", reason="Apache Flink is not installed: it takes 800 MB, and Java")
    written(make_events.events(robots=20, seconds=600), tmp_path / "events.jsonl")
    wanted = by_robot(run(tmp_path, FOLDER / "plain.py", stdin=tmp_path / "events.jsonl").stdout)
    ended = run(tmp_path, FOLDER / "fleet_flink.py", "events.jsonl", "outputs", "checkpoints")
    assert ended.returncode == 0, ended.stderr
    parts = [text_of(path) for path in (tmp_path / "outputs").rglob("part-*")]
    assert by_robot("".join(parts)) == wanted


def resumed(recovery):
    """Return the snapshots from which a dataflow has gone on each time it was started."""
    found = []
    for path in recovery.glob("*.sqlite3"):
        with sqlite3.connect(str(path)) as store:
            found += [
                place for _, place in store.execute("SELECT ex_num, resume_epoch FROM exs ORDER BY ex_num")
            ]
    return sorted(found)
