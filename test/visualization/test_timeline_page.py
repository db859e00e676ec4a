"""Page of a timeline in a browser: lanes, marks, details, zoom and colours, compared with the data."""

import json
from pathlib import Path
from typing import Any, Dict, List, Sequence

import pytest
from page_snippet_runner import FENCE, ROOT, PageRun

from retalis.visualization.timeline import read_run, timeline_page

pytestmark = pytest.mark.slow

SECOND = 10**9
RECORDS = [
    {"event": "my_msgs__0__Level(1)", "start": 5 * SECOND, "end": 5 * SECOND},
    {"event": "my_msgs__0__Level(2)", "start": 8 * SECOND, "end": 8 * SECOND},
    {"event": "high(1)", "start": 5 * SECOND, "end": 7 * SECOND},
    {"event": "high(2)", "start": 6 * SECOND, "end": 8 * SECOND},
    {"output": "x", "topic": "alarm", "id": "i", "time": 7 * SECOND},
    {"wait": "seen(1)", "memories": ["odom"], "start": 6 * SECOND, "end": 7 * SECOND},
    {"open": "lit(a)", "start": 7 * SECOND},
    {
        "memory": "odom",
        "pattern": "p(_)",
        "size": 9000,
        "records": 3000,
        "taken": 4000,
        "start": 6 * SECOND,
        "end": 9 * SECOND,
    },
]
COLOURED_AREAS = """
    (() => {
      // A copy that is read frequently, so that the browser does not warn about reading the picture itself.
      const copy = document.createElement("canvas"), pixels = copy.getContext("2d", { willReadFrequently: true });
      [copy.width, copy.height] = [canvas.width, canvas.height];
      pixels.fillStyle = getComputedStyle(document.body).backgroundColor;
      pixels.fillRect(0, 0, copy.width, copy.height);
      pixels.drawImage(canvas, 0, 0);
      const isColoured = ([red, green, blue]) => Math.max(red, green, blue) - Math.min(red, green, blue) > 25;
      const areas = (image, length, step) => {
        const intervals = [];
        for (let line = 0, last = -2; line < length; line++) {
          const indexes = [...Array(image.data.length / 4 / length).keys()];
          const position = (index) => 4 * step(line, index);
          const isColouredAt = (index) => isColoured(image.data.subarray(position(index), position(index) + 3));
          if (!indexes.some(isColouredAt)) continue;
          if (last === line - 1) intervals[intervals.length - 1][1] = line; else intervals.push([line, line]);
          last = line;
        }
        return intervals;
      };
      return run.lanes.map((lane, row) => {
        const top = AXIS + row * LANE_HEIGHT, image = pixels.getImageData(LEFT, top, copy.width - LEFT, LANE_HEIGHT);
        return areas(image, image.width, (x, y) => y * image.width + x).map(([first, last]) => {
          const middle = pixels.getImageData(LEFT + (first + last >> 1), top, 1, LANE_HEIGHT);
          return [LEFT + first, LEFT + last, areas(middle, LANE_HEIGHT, (y) => y).length];
        });
      });
    })()
"""
"""Expression for the coloured areas in each lane: first and last column, and number of rows in the middle."""

DRAWN_TEXTS = """
    (() => {
      const texts = [], { fillText } = paint;
      paint.fillText = (text, ...others) => { texts.push(text); fillText.call(paint, text, ...others); };
      draw();
      paint.fillText = fillText;
      return texts;
    })()
"""
"""Expression for the texts that the page draws."""

IS_REDRAWN = "new Promise((finish) => requestAnimationFrame(() => requestAnimationFrame(() => finish(true))))"


@pytest.fixture
def timeline() -> Any:
    return read_run(map(json.dumps, RECORDS), "run.jsonl")


@pytest.fixture
def page(browser: Any, timeline: Any, tmp_path: Path) -> Any:
    """Open the page with the timeline of `RECORDS`; return the browser."""
    (tmp_path / "run.html").write_text(timeline_page(timeline, "run"), encoding="utf-8")
    browser.open((tmp_path / "run.html").as_uri())
    return browser


def read_areas(browser: Any) -> Any:
    """Return the coloured areas of each lane after the next frame."""
    browser.ask(IS_REDRAWN)
    return browser.ask(COLOURED_AREAS)


def check_areas(lanes: Any, timeline: Any) -> None:
    """Compare coloured areas with the marks of a timeline; adjacent marks are one area."""
    assert len(lanes) == len(timeline.lanes)
    first = min(area[0] for areas in lanes for area in areas)
    last = max(area[1] for areas in lanes for area in areas)
    for lane, areas in zip(timeline.lanes, lanes):
        expected: List[Any] = []
        for start, end, _ in sorted(lane.marks):
            begin, until = (first + time / timeline.length * (last - first) for time in (start, end))
            if expected and begin <= expected[-1][1] + 2:
                expected[-1][1] = max(until, expected[-1][1])
            else:
                expected.append([begin, until])
        assert [area[:2] for area in areas] == [pytest.approx(area, abs=2) for area in expected], lane.name


def test_marks_are_at_times_of_data(page: Any, timeline: Any) -> None:
    check_areas(read_areas(page), timeline)


def test_each_lane_has_name_and_count(page: Any, timeline: Any) -> None:
    texts = page.ask(DRAWN_TEXTS)
    labels = [text for lane in timeline.lanes for text in (lane.name, f"{lane.total:,}")]
    assert [text for text in texts if text in labels] == labels
    assert "4,000" in labels
    assert "3.0 s" in texts


def test_overlapping_marks_have_separate_rows(page: Any, timeline: Any) -> None:
    rows = {
        lane.name: [count for _, _, count in areas] for lane, areas in zip(timeline.lanes, read_areas(page))
    }
    assert rows == {"Level": [1, 1], "high": [2], "seen waits": [1], "odom": [1], "alarm": [1], "lit": [1]}


def test_details_of_mark_are_shown_at_pointer(page: Any, timeline: Any) -> None:
    top = page.ask("canvas.offsetTop + AXIS")
    details: Dict[Any, Any] = {}
    for row, (lane, areas) in enumerate(zip(timeline.lanes, read_areas(page))):
        page.send_mouse_event("mouseMoved", areas[0][0], top + (row + 0.3) * page.ask("LANE_HEIGHT"))
        details[lane.name] = page.ask("details.textContent")
    assert details == {
        "Level": "event Level at 0.000000 s: my_msgs__0__Level(1)",
        "high": "event high at 0.000000 s to 2.000000 s, 2.000000 s long: high(1)",
        "seen waits": "wait seen waits at 1.000000 s to 2.000000 s, 1.000000 s long: for odom: seen(1)",
        "odom": "memory odom at 1.000000 s to 4.000000 s, 3.000000 s long: 3000 of 9000 records, 4000 taken: p(_)",
        "alarm": "output alarm at 2.000000 s: x",
        "lit": "open lit at 2.000000 s to 4.000000 s, 2.000000 s long: lit(a) is open",
    }


def test_wheel_zooms_around_pointer(page: Any) -> None:
    ((before, *_),) = read_areas(page)[-1]
    whole = page.ask("view[1] - view[0]")
    y = page.ask("canvas.offsetTop + AXIS + 5")
    page.send_mouse_event("mouseWheel", before, y, deltaX=0, deltaY=-100)
    ((start, *_),) = read_areas(page)[-1]
    assert abs(start - before) <= 1
    assert page.ask("view[1] - view[0]") == pytest.approx(0.8 * whole)
    page.click(before, y, count=2)
    page.ask(IS_REDRAWN)
    assert page.ask("view[1] - view[0]") == whole


def test_dragging_moves_marks(page: Any) -> None:
    y = page.ask("canvas.offsetTop + AXIS + 5")
    page.send_mouse_event("mouseWheel", 700, y, deltaX=0, deltaY=-100)
    ((before, *_),) = read_areas(page)[-1]
    page.send_mouse_event("mousePressed", 600, y, button="left", clickCount=1)
    page.send_mouse_event("mouseMoved", 640, y, button="left", buttons=1)
    page.send_mouse_event("mouseReleased", 640, y, button="left", clickCount=1)
    ((after, *_),) = read_areas(page)[-1]
    assert abs(after - before - 40) <= 1


def test_keys_zoom_and_pan(page: Any) -> None:
    page.ask("canvas.focus()")
    whole = page.ask("view")
    page.press("+")
    page.press("+")
    page.press("+")
    zoomed = page.ask("view")
    assert zoomed[0] > whole[0]
    assert zoomed[1] < whole[1]
    page.press("ArrowRight")
    assert page.ask("view")[0] > zoomed[0]
    page.press("ArrowLeft")
    assert page.ask("view") == pytest.approx(zoomed)
    for _ in range(4):
        page.press("-")
    assert page.ask("view") == pytest.approx(whole)


@pytest.mark.parametrize("dark", [False, True])
def test_legend_has_distinct_colours(page: Any, timeline: Any, dark: bool) -> None:
    page.set_dark(dark)
    check_areas(read_areas(page), timeline)
    assert page.ask("[...document.querySelectorAll('#legend span')].map((entry) => entry.textContent)") == [
        "events",
        "waits of queries",
        "memories",
        "outputs",
        "open at the end",
    ]
    samples = "[...document.querySelectorAll('#legend i')]"
    colours = page.ask(f"{samples}.map((sample) => getComputedStyle(sample).backgroundColor)")
    background = page.ask("getComputedStyle(document.body).backgroundColor")
    assert len({*colours, background}) == 6


def open_run(browser: Any, folder: Path, records: Sequence[Any], title: str = "run") -> None:
    """Open the page of a run in the browser."""
    timeline = read_run(map(json.dumps, records), "run.jsonl")
    (folder / "run.html").write_text(timeline_page(timeline, title), encoding="utf-8")
    browser.open((folder / "run.html").as_uri())


def test_page_of_empty_run_says_so(browser: Any, tmp_path: Path) -> None:
    open_run(browser, tmp_path, [])
    assert (
        browser.ask("document.querySelector('header').innerText.trim()")
        == "run\n\nthe run has no events, waits, memories or outputs"
    )


def test_instant_is_shown_within_a_second(browser: Any, tmp_path: Path) -> None:
    open_run(browser, tmp_path, RECORDS[:1])
    texts = browser.ask(DRAWN_TEXTS)
    assert texts[0] == "0.0 s"
    assert texts[-3:] == ["1.0 s", "Level", "1"]
    ((area,),) = read_areas(browser)
    assert area[2] == 1


@pytest.mark.parametrize("width", [400, 1280])
def test_times_of_axis_are_within_page(page: Any, width: int) -> None:
    page.resize(width, 800)
    page.ask(IS_REDRAWN)
    ends = page.ask(
        """
        (() => {
          const ends = [], { fillText } = paint;
          paint.fillText = (text, x, ...others) => {
            if (text.endsWith(" s")) ends.push(x + paint.measureText(text).width / 2);
            fillText.call(paint, text, x, ...others);
          };
          // Long numbers, as at a high magnification.
          show(run.length - 1e-5, run.length);
          draw();
          paint.fillText = fillText;
          return ends;
        })()
        """
    )
    assert ends
    assert max(ends) <= width


def test_colours_follow_system_while_page_is_open(page: Any) -> None:
    name_pixels = """
        (() => {
          const copy = document.createElement("canvas"), pixels = copy.getContext("2d", { willReadFrequently: true });
          [copy.width, copy.height] = [canvas.width, canvas.height];
          pixels.drawImage(canvas, 0, 0);
          const names = pixels.getImageData(0, AXIS, LEFT, LANE_HEIGHT).data;
          return Math.max(...names.filter((value, index) => index % 4 === 0 && names[index + 3] === 255));
        })()
    """
    page.ask(IS_REDRAWN)
    assert page.ask(name_pixels) < 128
    page.set_dark(True)
    page.ask(IS_REDRAWN)
    assert page.ask(name_pixels) > 128


def test_finger_scrolls_page_and_shows_details(browser: Any, tmp_path: Path) -> None:
    browser.resize(400, 500)
    browser.call("Emulation.setTouchEmulationEnabled", enabled=True)
    try:
        open_run(
            browser,
            tmp_path,
            [{"event": f"e{number}(1)", "start": SECOND, "end": SECOND} for number in range(50)],
        )
        # A gesture of the browser's own would wait for frames, which a hidden page does not draw.
        x, y = browser.ask("[xOf(0), canvas.offsetTop + AXIS + LANE_HEIGHT / 2]")
        browser.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": x, "y": y}])
        browser.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
        assert browser.ask("details.textContent") == "event e0 at 0.000000 s: e0(1)"
        browser.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": 300, "y": 400}])
        for place in range(380, 100, -20):
            browser.call("Input.dispatchTouchEvent", type="touchMove", touchPoints=[{"x": 300, "y": place}])
        browser.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
        browser.wait_for("window.scrollY > 100")
    finally:
        browser.call("Emulation.setTouchEmulationEnabled", enabled=False)


def test_long_title_is_broken_into_lines(browser: Any, tmp_path: Path) -> None:
    browser.resize(400, 800)
    open_run(browser, tmp_path, RECORDS, "a_long_name_of_a_program_" * 6)
    assert browser.ask("document.documentElement.scrollWidth") == 400


def test_narrow_page_does_not_scroll_sideways(page: Any) -> None:
    page.resize(390, 800)
    page.ask(IS_REDRAWN)
    assert page.ask("document.documentElement.scrollWidth") == 390


def test_tutorial_draws_its_run(browser: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run = PageRun(tmp_path)
    page = (ROOT / "docs" / "tutorials" / "robot-program.md").read_text(encoding="utf-8")
    fences = list(FENCE.finditer(page))
    assert fences
    for fence in fences:
        assert run.result(fence) == fence["text"]
    browser.open((tmp_path / "run.html").as_uri())
    assert browser.ask("run.lanes.map((lane) => [lane.kind, lane.name, lane.total])") == [
        ["event", "String", 4],
        ["event", "bump", 4],
        ["event", "cornered", 1],
        ["event", "turn", 1],
        ["event", "history", 1],
        ["memory", "bumps", 4],
        ["output", "turn", 1],
    ]
    assert [len(areas) for areas in read_areas(browser)] == [4, 4, 1, 1, 1, 1, 1]
    assert browser.ask("run.lanes[5].marks.map(([start, end, text]) => [start, end, text])") == [
        [0, 29, "4 of 100 records, 4 taken: bump(_)"]
    ]
