"""A run as lanes: what is in them, what is left out, what is refused; the page and the picture of it."""

import json
import re
import sys
import types

import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

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


def of(lines):
    return read_run(map(json.dumps, lines), "run.jsonl")


def test_a_run_has_a_lane_for_each_name():
    run = of(RUN)
    assert (run.begin, run.length, run.omitted_lane_count) == (4 * SECOND, 5.0, 0)
    assert [(lane.kind, lane.name, lane.total) for lane in run.lanes] == [
        *(("event", "Level", 1), ("event", "a (b", 1), ("wait", "seen waits", 1)),
        *(("memory", "odom", 4), ("output", "y", 1), ("output", "z", 1)),
        *(("open", "lit", 1), ("open", "load every(10)", 1)),
    ]
    assert run.lanes[1].marks == [(1.0, 3.0, "'a (b'(1)")]
    assert run.lanes[2].marks == [(2.0, 3.0, "for odom: seen(1)")]
    # What is open ends with the run.
    assert run.lanes[-2].marks == [(2.0, 5.0, "lit(a) is open")]
    assert run.lanes[-1].marks == [(0.0, 5.0, "every(10) is open, with 2 elements, R = r1")]
    assert of([]).lanes == []


def test_a_long_run_is_thinned_over_its_whole_length():
    builder = TimelineBuilder()
    number = 2 * MAX_MARKS + 7
    for at in range(number):
        builder.add_record({"event": "a", "start": at, "end": at})
    for at in range(MAX_LANES + 3):
        builder.add_record({"event": f"e{at}", "start": at, "end": at})
    run = builder.build()
    lane = run.lanes[0]
    assert lane.total == number and MAX_MARKS / 2 <= len(lane.marks) <= MAX_MARKS
    assert round(lane.marks[-1][0] * SECOND) > number - 5
    assert len(run.lanes) == MAX_LANES and run.omitted_lane_count == 4


@pytest.mark.parametrize(
    "line, says",
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
def test_a_line_that_is_no_record_is_named(line, says):
    with pytest.raises(UsageError, match=re.escape(says)):
        read_run(["{}", line], "run.jsonl")


MARKS = some.lists(some.tuples(some.integers(0, 20), some.integers(0, 5)).map(lambda m: (m[0], sum(m), "")))


@settings(max_examples=30)
@given(MARKS.map(sorted))
def test_marks_of_a_row_overlap_only_where_all_rows_are_taken(marks):
    rows = assign_rows(marks)
    for at, (start, end, _) in enumerate(marks):
        assert (rows[at] is None) == (start == end)
        before = {row for (_, until, _), row in zip(marks[:at], rows) if row is not None and until > start}
        if rows[at] in before:
            assert before == set(range(MAX_ROWS_PER_LANE))


def test_the_page_holds_the_run_and_no_text_of_it_is_markup():
    run = of([{"event": "</script><b>(1)", "start": 0, "end": SECOND}, *RUN])
    text = timeline_page(run, "<i>title</i>")
    found = json.loads(re.search(r'type="application/json">(.*?)</script>', text, re.DOTALL).group(1))
    assert found["title"] == "<i>title</i>"
    assert found["lanes"][0]["marks"] == [[0.0, 1.0, "</script><b>(1)", 0]]
    assert "not all marks" not in found["about"]
    assert "<b>" not in text and "<i>title" not in text
    assert not re.search(r"(src|href)=|https?:|@import|url\(", text)


def test_half_a_character_is_part_of_the_page():
    run = of([{"event": "'\ud800'", "start": 0, "end": SECOND}])
    assert "\\ud800" in timeline_page(run, "run").encode("utf-8").decode()


def test_the_page_shows_control_characters_as_escapes():
    run = of([{"output": "x\x1b", "topic": "z\u202e", "id": "i", "time": 7 * SECOND}])
    text = timeline_page(run, "\x9b")
    (held,) = re.findall(r">(\{.*\})<", text)
    found = json.loads(held)
    assert found["title"] == r"\x9b"
    assert (found["lanes"][0]["name"], found["lanes"][0]["marks"][0][2]) == (r"z\u202e", r"x\x1b")


@pytest.mark.parametrize(
    ("prefix", "folder", "command"),
    [
        ("/usr", "/usr/lib/python3/dist-packages", "apt install python3-matplotlib"),
        ("/home/me/venv", "/usr/lib/python3/dist-packages", "pip install matplotlib"),
        ("/usr", "/usr/lib/python3/site-packages", "pip install matplotlib"),
    ],
)
def test_missing_matplotlib_is_an_error_with_the_remedy(monkeypatch, tmp_path, prefix, folder, command):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setattr(sys, "prefix", prefix)
    monkeypatch.setattr(sys, "path", [folder])
    with pytest.raises(UsageError, match=rf"\({command}\).*run\.html.* needs nothing"):
        draw_timeline(of(RUN), "run", tmp_path / "run.png")


def test_record_without_a_field_is_an_error():
    for record in RUN[:-1]:
        for field in list(record)[1:]:
            incomplete = {name: value for name, value in record.items() if name != field}
            with pytest.raises(UsageError, match=f'run.jsonl:1: expected a field "{field}"'):
                of([incomplete])


def test_what_matplotlib_is_asked_for(monkeypatch, tmp_path):
    """It need not be there for the tests: a stand-in notes the calls."""
    calls = []

    class Noting:
        def __init__(self, *arguments, **named):
            self.spines = dict.fromkeys(("top", "left", "right"), self) if named.get("axes") else {}

        def __getattr__(self, name):
            def call(*arguments, **named):
                calls.append((name, arguments))
                if name == "savefig":
                    arguments[0].write_text("picture")
                return Noting(axes=True)

            return call

    for name, held in (("figure", {"Figure": Noting}), ("patches", {"Patch": Noting})):
        module = types.ModuleType(f"matplotlib.{name}")
        vars(module).update(held)
        monkeypatch.setitem(sys.modules, f"matplotlib.{name}", module)
    monkeypatch.setitem(sys.modules, "matplotlib", types.ModuleType("matplotlib"))
    draw_timeline(of(RUN), "a run of $x_{$", tmp_path / "run.png")
    named = [arguments[0] for name, arguments in calls if name == "set_yticklabels"]
    names = ["Level", "a (b", "seen waits", "odom", "y", "z", "lit", "load every(10)"]
    assert named == [names, ["1", "1", "1", "4", "1", "1", "1", "1"]]
    (title,) = [arguments[0] for name, arguments in calls if name == "set_title"]
    assert title.startswith("a run of \\$x_{\\$\n")
    (drawn,) = [arguments[0] for name, arguments in calls if name == "savefig"]
    assert (drawn.parent, drawn.suffix) == (tmp_path, ".png")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"run.png": "picture"}
    bars = [arguments[0] for name, arguments in calls if name == "broken_barh"]
    assert bars == [[(1.0, 2.0)], [(2.0, 1.0)], [(2.0, 3.0)], [(2.0, 3.0)], [(0.0, 5.0)]]
