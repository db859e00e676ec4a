"""Command ``graph``, a program as picture or text, and ``plot``, a run as page."""

import json
import re
import sys
from pathlib import Path

import pytest

from retalis.cli.command_line import main

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "examples" / "nao"))
from make_bag import make_bag  # noqa: E402

PROGRAM = str(ROOT / "application_source")


def test_graph_is_printed_or_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT / "application_source")
    assert main(["graph"]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert 'label="application_source"' in captured.out
    assert "_G" not in captured.out  # numbers of variables differ from one drawing to the next
    for name in (
        "tf",
        "ar_marker/5",
        "odom_base",
        "transform_marker",
        "marker8",
        "face_by_marker(Name,Marker,Text)",
    ):
        assert f'label="{name}' in captured.out
    assert main(["graph", ".", "-o", str(tmp_path / "nao.dot")]) == 0
    assert (tmp_path / "nao.dot").read_text() == captured.out


def test_graph_is_printed_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["graph", PROGRAM, "--json"]) == 0
    graph = json.loads(capsys.readouterr().out)
    ids = {node["id"] for node in graph["nodes"]}
    assert {edge[end] for edge in graph["edges"] for end in ("source", "target")} <= ids
    assert graph["omitted"] == 0
    assert {"rule", "event", "topic", "memory", "output"} <= {node["kind"] for node in graph["nodes"]}


def test_topic_with_event_name_has_edge_to_event(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "pub_sub.xml").write_text(
        '<publish_subscribe><subscribe_to name="left" msg_type="std_msgs/Bool" event="bump"/></publish_subscribe>'
    )
    (tmp_path / "goalPredicates.txt").write_text("subscribe(bump(_), [], _, hit, h)\n")
    assert main(["graph", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert text.count(" -> ") == 2
    assert 'label="bump/1"' in text


@pytest.mark.parametrize("name", ["x.jpeg", "x", "x.svgz"])
def test_unknown_suffix_is_an_error(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["graph", str(ROOT / "application_source"), "-o", name]) == 1
    assert "expected a name that ends in one of .svg, .png, .pdf, .dot, .gv" in capsys.readouterr().err


def test_folder_without_program_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["graph", str(tmp_path)]) == 1
    assert "has no file goalPredicates.txt" in capsys.readouterr().err


def test_program_with_error_is_drawn_in_part(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "goalPredicates.txt").write_text("memorize(a, [], _, m, 5)\nno_such_goal\n")
    assert main(["graph", str(tmp_path)]) == 1
    captured = capsys.readouterr()
    assert "goalPredicates.txt:2:1" in captured.err
    assert 'label="m"' in captured.out


@pytest.mark.slow
def test_plot_of_bag_equals_plot_of_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = tmp_path / "nao.bag"
    make_bag(bag, 1.0, 1)
    assert main(["plot", str(bag), "--program", PROGRAM, "-o", str(tmp_path / "a.html")]) == 0
    assert capsys.readouterr() == ("", "")
    assert main(["bag", str(bag), "--program", PROGRAM, "--events", "--json"]) == 0
    (tmp_path / "run.jsonl").write_text(capsys.readouterr().out, encoding="utf-8")
    assert main(["plot", "--from", str(tmp_path / "run.jsonl"), "-o", str(tmp_path / "b.html")]) == 0
    drawn, read = ((tmp_path / name).read_text(encoding="utf-8") for name in ("a.html", "b.html"))
    assert drawn.replace("application_source over nao.bag", "run.jsonl") == read
    assert '"name": "odom_base"' in drawn
    assert '"kind": "wait"' in drawn


@pytest.mark.slow
def test_plot_has_flushed_and_open_windows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag, program = tmp_path / "nao.bag", tmp_path / "program"
    make_bag(bag, 1.0, 1)
    program.mkdir()
    (program / "pub_sub.xml").write_text("<publish_subscribe></publish_subscribe>")
    (program / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt')\n")
    (program / "eventRules.txt").write_text(
        "first <- tf__0__tfMessage(_) with throttle(1000).\nlost <- first seq absent(beat, 100).\n"
        ":- state(moving, from(first), until(beat)).\n"
        "many(N) <- aggregate(count, first, N, every(5, events)).\n"
    )
    end = ["--flush", "200", "--open"]
    assert main(["plot", str(bag), "-p", str(program), *end, "-o", str(tmp_path / "a.html")]) == 0
    drawn = (tmp_path / "a.html").read_text(encoding="utf-8")
    lanes = re.findall(r'"kind": "(\w+)", "name": "([^"]*)"', drawn)
    assert ("event", "lost") in lanes
    assert lanes[-2:] == [("open", "moving"), ("open", "many every(5,events)")]
    assert main(["bag", str(bag), "-p", str(program), *end, "--events", "--json"]) == 0
    (tmp_path / "run.jsonl").write_text(capsys.readouterr().out, encoding="utf-8")
    assert main(["plot", "--from", str(tmp_path / "run.jsonl"), "-o", str(tmp_path / "b.html")]) == 0
    assert drawn.replace("program over nao.bag", "run.jsonl") == (tmp_path / "b.html").read_text(
        encoding="utf-8"
    )


def test_invalid_options_are_errors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plot", "x.bag", "--program", PROGRAM, "-o", "run.jpeg"]) == 1
    assert "expected a name that ends in one of .html, .htm, .png, .svg, .pdf" in capsys.readouterr().err
    assert main(["plot", "--from", str(tmp_path / "none"), "-o", "run.html"]) == 1
    assert "cannot read" in capsys.readouterr().err
    for arguments in (["x.bag", "--from", "y"], [], ["x.bag"]):
        with pytest.raises(SystemExit) as raised:
            main(["plot", *arguments, "-o", "run.html"])
        assert raised.value.code == 2


def test_plot_finds_types_in_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = tmp_path / "nao.bag"
    make_bag(bag, 0.1, 1)
    (tmp_path / "arm_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "arm_msgs" / "msg" / "Feedback.msg").write_text("bool ok\n")
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe></publish_subscribe>")
    (tmp_path / "eventRules.txt").write_text("fine <- arm_msgs__0__Feedback{ok: true}.\n")
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt')\n")
    plot = ["plot", str(bag), "--program", str(tmp_path), "-o", str(tmp_path / "run.html")]
    assert main(plot) == 1
    assert "arm_msgs/Feedback" in capsys.readouterr().err
    assert main([*plot, "--msg", str(tmp_path / "arm_msgs")]) == 0
    assert "error" not in capsys.readouterr().err


def test_plot_of_incomplete_bag_has_status_3(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = tmp_path / "a.bag"
    make_bag(bag, 1.0, 1)
    bag.write_bytes(bag.read_bytes()[:-100])
    options = ["plot", str(bag), "--program", PROGRAM, "-o", str(tmp_path / "a.html")]
    assert main([*options, "--strict"]) == 1
    assert not (tmp_path / "a.html").exists()
    capsys.readouterr()
    assert main(options) == 3
    assert capsys.readouterr().err.startswith(f"warning: {bag} is incomplete: ")
    assert "application_source over a.bag (incomplete)" in (tmp_path / "a.html").read_text(encoding="utf-8")


def test_title_names_five_of_many_bags(tmp_path: Path) -> None:
    bags = [tmp_path / f"{number}.bag" for number in range(7)]
    for bag in bags:
        make_bag(bag, 1.0, 1)
    page = tmp_path / "run.html"
    assert main(["plot", *map(str, bags), "--program", PROGRAM, "-o", str(page)]) == 0
    assert '"application_source over 0.bag, 1.bag, 2.bag, 3.bag, 4.bag and 2 more"' in page.read_text(
        encoding="utf-8"
    )
