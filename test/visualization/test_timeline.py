"""Timeline of a run: lanes, thinning, invalid records, page, and picture."""

import json
import re
import sys
import types
from pathlib import Path
from typing import Any, List

import pytest
from asserting_accessors import search
from hypothesis import given, settings
from hypothesis import strategies as st

from retalis import UsageError
from retalis.visualization.timeline import (
    MAX_LANES,
    MAX_MARKS,
    MAX_ROWS_PER_LANE,
    TimelineBuilder,
    assign_rows,
    draw_timeline,
    read_run,
    timeline_page,
)

SECOND = 10**9
RUN = [
    {"event": "my_msgs__0__Level(1)", "start": 5 * SECOND, "end": 5 * SECOND},
    {"event": "null_event", "start": 5 * SECOND, "end": 5 * SECOND},
    {"event": "'a (b'(1)", "start": 5 * SECOND, "end": 7 * SECOND},
    {"output": "x", "topic": "z", "id": "i", "time": 7 * SECOND},
    {"output": "x", "topic": "y", "id": "i", "time": 8 * SECOND},
    {"wait": "seen(1)", "memories": ["odom"], "start": 6 * SECOND, "end": 7 * SECOND},
    {
        "memory": "odom",
        "pattern": "p(_)",
        "size": 9,
        "records": 3,
        "taken": 4,
        "start": 6 * SECOND,
        "end": 9 * SECOND,
    },
    {"open": "lit(a)", "start": 6 * SECOND},
    {
        "open_window": "every(10)",
        "rule": "load(R,N)",
        "key": {"R": "r1"},
        "elements": 2,
        "start": 4 * SECOND,
        "end": 14 * SECOND,
    },
    {"memory": "none", "pattern": "q", "size": 9, "records": 0, "taken": 0, "start": None, "end": None},
    {"explain": "x", "happened": True, "because": []},
]


def read_records(lines: Any) -> Any:
    return read_run(map(json.dumps, lines), "run.jsonl")


def test_run_has_lane_for_each_name() -> None:
    run = read_records(RUN)
    assert (run.begin, run.length, run.omitted_lane_count) == (4 * SECOND, 5.0, 0)
    assert [(lane.kind, lane.name, lane.total) for lane in run.lanes] == [
        *(("event", "Level", 1), ("event", "a (b", 1), ("wait", "seen waits", 1)),
        *(("memory", "odom", 4), ("output", "y", 1), ("output", "z", 1)),
        *(("open", "lit", 1), ("open", "load every(10)", 1)),
    ]
    assert run.lanes[1].marks == [(1.0, 3.0, "'a (b'(1)")]
    assert run.lanes[2].marks == [(2.0, 3.0, "for odom: seen(1)")]
    # Open states and windows end with the run.
    assert run.lanes[-2].marks == [(2.0, 5.0, "lit(a) is open")]
    assert run.lanes[-1].marks == [(0.0, 5.0, "every(10) is open, with 2 elements, R = r1")]
    assert read_records([]).lanes == []


@pytest.mark.parametrize(
    ("event", "name"),
    [
        (r"'it\'s'(1)", "it's"),
        ("'it''s'", "it's"),
        (r"'a\\b'(1)", r"a\b"),
        (r"'no \q escape'(1)", r"'no \q escape'"),
        ("'", "'"),
    ],
)
def test_lane_has_name_without_quotes_and_escapes(event: str, name: str) -> None:
    run = read_records([{"event": event, "start": SECOND, "end": SECOND}])
    assert [lane.name for lane in run.lanes] == [name]


def test_long_run_is_thinned_evenly() -> None:
    builder = TimelineBuilder()
    count = 2 * MAX_MARKS + 7
    for index in range(count):
        builder.add_record({"event": "a", "start": index, "end": index})
    for index in range(MAX_LANES + 3):
        builder.add_record({"event": f"e{index}", "start": index, "end": index})
    run = builder.build()
    lane = run.lanes[0]
    assert lane.total == count
    assert MAX_MARKS / 2 <= len(lane.marks) <= MAX_MARKS
    indexes = [round(mark[0] * SECOND) for mark in lane.marks]
    (distance,) = {later - earlier for earlier, later in zip(indexes, indexes[1:])}
    assert distance > 1
    assert (indexes[0], indexes[-1]) == (0, (count - 1) // distance * distance)
    assert len(run.lanes) == MAX_LANES
    assert run.omitted_lane_count == 4


@pytest.mark.parametrize(
    ("line", "error"),
    [
        ("{", "run.jsonl:2: this is not JSON"),
        ("[1]", "run.jsonl:2: this is not a JSON object"),
        ('{"event": "a", "start": 1}', 'run.jsonl:2: expected a field "end"'),
        ('{"event": 1, "start": 1, "end": 1}', 'run.jsonl:2: expected a text as "event"'),
        ('{"event": "a", "start": "1", "end": 1}', 'run.jsonl:2: expected whole nanoseconds as "start"'),
        ('{"event": "a", "start": 1.5, "end": 2}', 'run.jsonl:2: expected whole nanoseconds as "start"'),
        (
            f'{{"event": "a", "start": 1, "end": 1{"0" * 400}}}',
            "run.jsonl:2: expected nanoseconds since the epoch",
        ),
    ],
)
def test_invalid_record_is_an_error_with_line(line: str, error: str) -> None:
    with pytest.raises(UsageError, match=re.escape(error)):
        read_run(["{}", line], "run.jsonl")


MARKS = st.lists(st.tuples(st.integers(0, 20), st.integers(0, 5)).map(lambda m: (m[0], sum(m), "")))


@settings(max_examples=30)
@given(MARKS.map(sorted))
def test_marks_overlap_only_if_all_rows_are_used(marks: Any) -> None:
    rows = assign_rows(marks)
    for index, (start, end, _) in enumerate(marks):
        assert (rows[index] is None) == (start == end)
        before = {row for (_, until, _), row in zip(marks[:index], rows) if row is not None and until > start}
        if rows[index] in before:
            assert before == set(range(MAX_ROWS_PER_LANE))


def test_texts_of_run_are_not_markup() -> None:
    run = read_records([{"event": "</script><b>(1)", "start": 0, "end": SECOND}, *RUN])
    text = timeline_page(run, "<i>title</i>")
    data = json.loads(search(r'type="application/json">(.*?)</script>', text, re.DOTALL).group(1))
    assert data["title"] == "<i>title</i>"
    assert data["lanes"][0]["marks"] == [[0.0, 1.0, "</script><b>(1)", 0]]
    assert "not all marks" not in data["about"]
    assert "<b>" not in text
    assert "<i>title" not in text
    assert not re.search(r"(src|href)=|https?:|@import|url\(", text)


def test_lone_surrogate_is_escaped() -> None:
    run = read_records([{"event": "'\ud800'", "start": 0, "end": SECOND}])
    assert "\\ud800" in timeline_page(run, "run").encode("utf-8").decode()


def test_control_characters_are_escaped() -> None:
    run = read_records([{"output": "x\x1b", "topic": "z\u202e", "id": "i", "time": 7 * SECOND}])
    text = timeline_page(run, "\x9b")
    (json_text,) = re.findall(r">(\{.*\})<", text)
    data = json.loads(json_text)
    assert data["title"] == r"\x9b"
    assert (data["lanes"][0]["name"], data["lanes"][0]["marks"][0][2]) == (r"z\u202e", r"x\x1b")


@pytest.mark.parametrize(
    ("prefix", "folder", "command"),
    [
        ("/usr", "/usr/lib/python3/dist-packages", "apt install python3-matplotlib"),
        ("/home/me/venv", "/usr/lib/python3/dist-packages", "pip install matplotlib"),
        ("/usr", "/usr/lib/python3/site-packages", "pip install matplotlib"),
    ],
)
def test_missing_matplotlib_is_an_error_with_advice(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, prefix: str, folder: str, command: str
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setattr(sys, "prefix", prefix)
    monkeypatch.setattr(sys, "path", [folder])
    with pytest.raises(UsageError, match=rf"\({command}\).*run\.html.* needs nothing"):
        draw_timeline(read_records(RUN), "run", tmp_path / "run.png")


def test_record_without_a_field_is_an_error() -> None:
    for record in RUN[:-1]:
        for field in list(record)[1:]:
            incomplete = {name: value for name, value in record.items() if name != field}
            with pytest.raises(UsageError, match=f'run.jsonl:1: expected a field "{field}"'):
                read_records([incomplete])


def test_picture_has_lanes_and_marks(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Replace matplotlib, which need not be installed, by an object that records its calls."""
    calls: List[Any] = []

    class Recorder:
        def __init__(self, *arguments: Any, **options: Any) -> None:
            self.spines = dict.fromkeys(("top", "left", "right"), self) if options.get("axes") else {}

        def __getattr__(self, name: Any) -> Any:
            def call(*arguments: Any, **options: Any) -> Any:
                calls.append((name, arguments))
                if name == "savefig":
                    arguments[0].write_text("picture")
                return Recorder(axes=True)

            return call

    for name, members in (("figure", {"Figure": Recorder}), ("patches", {"Patch": Recorder})):
        module = types.ModuleType(f"matplotlib.{name}")
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, f"matplotlib.{name}", module)
    monkeypatch.setitem(sys.modules, "matplotlib", types.ModuleType("matplotlib"))
    draw_timeline(read_records(RUN), "a run of $x_{$", tmp_path / "run.png")
    labels = [arguments[0] for name, arguments in calls if name == "set_yticklabels"]
    names = ["Level", "a (b", "seen waits", "odom", "y", "z", "lit", "load every(10)"]
    assert labels == [names, ["1", "1", "1", "4", "1", "1", "1", "1"]]
    (title,) = [arguments[0] for name, arguments in calls if name == "set_title"]
    assert title.startswith("a run of \\$x_{\\$\n")
    (target,) = [arguments[0] for name, arguments in calls if name == "savefig"]
    assert (target.parent, target.suffix) == (tmp_path, ".png")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"run.png": "picture"}
    bars = [arguments[0] for name, arguments in calls if name == "broken_barh"]
    assert bars == [[(1.0, 2.0)], [(2.0, 1.0)], [(2.0, 3.0)], [(2.0, 3.0)], [(0.0, 5.0)]]


def test_long_name_does_not_widen_picture(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    widths = []
    for name in ("e", "a_long_name_of_an_event_" * 8):
        draw_timeline(read_records([{"event": name, "start": 0, "end": 9}]), "run", tmp_path / "run.png")
        # The width is the first number of the header of a PNG.
        widths.append(int.from_bytes((tmp_path / "run.png").read_bytes()[16:20], "big"))
    assert widths[1] < 1.5 * widths[0]


def test_missing_glyphs_are_one_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    pytest.importorskip("matplotlib")
    draw_timeline(
        read_records([{"event": "'\u6e29\u5ea6'(1)", "start": 0, "end": 9}]), "run", tmp_path / "run.png"
    )
    assert [record.getMessage() for record in caplog.records] == [
        "run.png: the fonts of matplotlib do not have 2 characters, which a box stands for; "
        "run.html, a page, uses those of the browser"
    ]
