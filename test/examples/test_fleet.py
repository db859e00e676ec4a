"""``examples/fleet``: the job has the outputs of the loop, and the page names its files."""

import json
import os
import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from types import ModuleType
from typing import Any, List

import pytest
from script_modules import load_script
from subprocess_python_path import python_path

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "examples" / "fleet"
PAGE = FOLDER / "README.md"


def load_module(name: str) -> ModuleType:
    return load_script(FOLDER / f"{name}.py", f"fleet_{name}")


make_events = load_module("make_events")


def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def write_events(events: Any, path: Path) -> None:
    path.write_text("".join(json.dumps(event) + "\n" for event in events), encoding="utf-8")


def by_robot(lines: List[str]) -> Any:
    """Return the outputs of each robot in the order of their numbers."""
    outputs = defaultdict(list)
    for line in lines:
        output = json.loads(line)
        outputs[output.pop("robot")].append(output)
    return {robot: sorted(items, key=lambda item: item["number"]) for robot, items in outputs.items()}


def lines_of(folder: Path) -> List[str]:
    """Return the lines of the complete files of a sink."""
    return [line for path in sorted(folder.glob("*/part-*")) for line in text_of(path).splitlines()]


def run(folder: Path, *arguments: Any, stdin: Any = os.devnull) -> Any:
    """Run Python in a folder with this package; return the ended process."""
    with open(stdin, encoding="utf-8") as lines:
        return subprocess.run(
            [sys.executable, *map(str, arguments)],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": python_path()},
            stdin=lines,
            capture_output=True,
            text=True,
            timeout=300,
        )


def test_page_names_all_files() -> None:
    names = set(re.findall(r"`([\w.]+\.(?:py|txt))` ", text_of(PAGE).replace("`,", "` ")))
    assert names >= {path.name for path in FOLDER.iterdir() if path.suffix in (".py", ".txt")}


def test_seed_determines_events(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    make_events.main([str(path), "--robots", "2", "--seconds", "30"])
    lines = text_of(path).splitlines()
    assert [json.loads(line) for line in lines] == make_events.events(robots=2, seconds=30)


def test_loop_has_all_kinds_of_outputs(tmp_path: Path) -> None:
    write_events(make_events.events(robots=1, seconds=90, seed=3), tmp_path / "events.jsonl")
    process = run(tmp_path, FOLDER / "plain.py", stdin=tmp_path / "events.jsonl")
    functors = {json.loads(line)["output"].partition("(")[0] for line in process.stdout.splitlines()}
    assert functors == {"shelf_at", "delivered", "bumped", "overdue"}


@pytest.mark.slow
def test_job_has_outputs_of_loop(tmp_path: Path) -> None:
    pytest.importorskip("pyflink", reason="Apache Flink is not installed: it takes 0.9 GB, and Java")
    write_events(make_events.events(robots=5, seconds=100), tmp_path / "events.jsonl")
    expected = run(tmp_path, FOLDER / "plain.py", stdin=tmp_path / "events.jsonl").stdout.splitlines()
    with open(tmp_path / "events.jsonl", "a", encoding="utf-8") as events:
        events.write('not json\n{"robot": "r01", "time": 99999999999, "event": "bump"}\n')
        events.write('{"robot": "r01", "time": 50, "event": "bump("}\n')
    process = run(tmp_path, FOLDER / "fleet.py", "events.jsonl", "results", "checkpoints")
    assert process.returncode == 0, process.stderr
    assert by_robot(lines_of(tmp_path / "results" / "outputs")) == by_robot(expected)
    reasons = [json.loads(line)["reason"] for line in lines_of(tmp_path / "results" / "failed")]
    assert len(reasons) == 3
    assert lines_of(tmp_path / "results" / "late") == []
