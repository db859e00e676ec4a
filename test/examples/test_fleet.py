"""``examples/fleet``: the job has the outputs of the loop, and the page names its files."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections import Counter, defaultdict
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
        events.write('{"robot": "r01", "time": 100, "event": "bump("}\n')
    process = run(tmp_path, FOLDER / "fleet.py", "events.jsonl", "results", "checkpoints")
    assert process.returncode == 0, process.stderr
    assert by_robot(lines_of(tmp_path / "results" / "outputs")) == by_robot(expected)
    reasons = [json.loads(line)["reason"] for line in lines_of(tmp_path / "results" / "failed")]
    assert len(reasons) == 3
    assert lines_of(tmp_path / "results" / "late") == []


JOB = """
import sys
from pyflink.common import Types
from pyflink.datastream import SourceFunction
from pyflink.java_gateway import get_gateway
from retalis.fleet.flink_job import create_environment, read_lines, run_robots, write_files

program, count, *resume = sys.argv[1:]
environment = create_environment("checkpoints", interval=1, resume=next(iter(resume), None))
environment.set_parallelism(1)
settings = get_gateway().jvm.org.apache.flink.configuration.Configuration()
# Timers that are set between two checkpoints are missing in the second one, unless a watermark comes meanwhile.
for key, value in {
    "python.fn-execution.bundle.time": "1000000",
    "python.fn-execution.bundle.size": "1000000",
    "pipeline.auto-watermark-interval": "1 h",
}.items():
    settings.setString(key, value)
environment._j_stream_execution_environment.configure(settings)
datagen = get_gateway().jvm.org.apache.flink.streaming.api.functions.source.datagen
numbers = datagen.SequenceGenerator.longGenerator(1, int(count))
source = SourceFunction(datagen.DataGeneratorSource(numbers, 10, int(count)))
line = '{"robot": "r%d", "time": 1, "event": "picked(box)"}'
ticks = environment.add_source(source, "numbers", Types.LONG()).uid("numbers")
lines = ticks.map(lambda number: line % number, Types.STRING()).uid("lines")
write_files(run_robots(read_lines(lines), program).outputs, "outputs", "outputs")
environment.execute("timers")
"""


@pytest.mark.slow
def test_silent_robots_have_alarms_after_restore(tmp_path: Path) -> None:
    pytest.importorskip("pyflink", reason="Apache Flink is not installed: it takes 0.9 GB, and Java")
    program = tmp_path / "program"
    program.mkdir()
    (program / "goalPredicates.txt").write_text(
        "compile_event_file('rules.txt')\n"
        "subscribe(picked(_), [], _, picks, a)\nsubscribe(overdue(_), [], _, alarms, b)\n"
    )
    (program / "rules.txt").write_text("overdue(X) <- picked(X) seq absent(dropped(X), 12).\n")
    (tmp_path / "job.py").write_text(JOB)
    environment = {**os.environ, "PYTHONPATH": python_path()}
    with open(tmp_path / "log", "w", encoding="utf-8") as log:
        job = subprocess.Popen(
            [sys.executable, "job.py", program, "1000"],
            cwd=tmp_path,
            env=environment,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
        end = time.monotonic() + 120
        while not (newest := list(tmp_path.glob("checkpoints/*/chk-[4-9]/_metadata"))):
            assert job.poll() is None, text_of(tmp_path / "log")
            assert time.monotonic() < end, text_of(tmp_path / "log")
            time.sleep(0.02)
        os.killpg(job.pid, signal.SIGKILL)
        job.wait()
    # No event follows the restore: only the alarms are left.
    process = run(tmp_path, "job.py", program, "1", newest[0].parent)
    assert process.returncode == 0, process.stderr
    outputs = [json.loads(line) for line in lines_of(tmp_path / "outputs")]
    picks = Counter(output["robot"] for output in outputs if output["topic"] == "picks")
    alarms = Counter(output["robot"] for output in outputs if output["topic"] == "alarms")
    assert len(picks) > 5
    assert set(picks.values()) == {1}
    assert alarms == picks
