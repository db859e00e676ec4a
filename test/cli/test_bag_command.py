"""Command ``bag``: playback of a program over a bag."""

import json
import re
import sys
from collections import Counter
from pathlib import Path
from typing import Any, List

import pytest

from retalis import BagReader, Definitions
from retalis.cli.command_line import main
from retalis.playback.bag_locations import open_bag
from retalis.prolog.syntax.event_text import to_text

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "examples" / "nao"))
from make_bag import make_bag  # noqa: E402

PROGRAM = str(ROOT / "application_source")


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "nao.bag"
    make_bag(path, 3.0, 1)
    return path


def test_outputs_are_printed(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bag", str(bag), "--program", PROGRAM]) == 0
    captured = capsys.readouterr()
    lines = captured.out.splitlines()
    assert captured.err == ""
    assert lines
    assert all(line.startswith("output(") and line.endswith(").") for line in lines)
    assert any(line.endswith(",marker1).") for line in lines)


def test_outputs_are_written_to_bag(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "out.bag"
    assert main(["bag", str(bag), "--program", PROGRAM, "--output", str(target)]) == 0
    line_count = len(capsys.readouterr().out.splitlines())
    with BagReader(target) as reader:
        assert reader.messages == line_count > 0


def read_events(path: Path) -> List[Any]:
    """Return topic, time and event text of each message, sorted and without `seq`, which ROS 2 does not have."""
    definitions = Definitions()
    with open_bag(path) as reader:
        return sorted(
            (
                record.topic.name,
                record.time,
                re.sub(
                    r"Header\(\d+",
                    "Header(0",
                    to_text(definitions.decoder(record.topic.type, record.topic.format).decode(record.data)),
                ),
            )
            for record in reader.records()
        )


def test_outputs_are_written_to_ros2_bag(bag: Path, tmp_path: Path) -> None:
    pytest.importorskip("mcap")
    command = ["bag", str(bag), "--program", PROGRAM, "--quiet", "--duration", "1", "--output"]
    assert main([*command, str(tmp_path / "out.bag")]) == 0
    assert main([*command, str(tmp_path / "out.mcap")]) == 0
    events = read_events(tmp_path / "out.mcap")
    assert events == read_events(tmp_path / "out.bag")
    assert {topic for topic, _, _ in events} > {"/face_by_marker", "/marker1"}


def test_ros1_output_of_ros2_bag_is_warned_of(
    bag: Path, tf_program: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mcap")
    recording, target = tmp_path / "in.mcap", tmp_path / "out"
    assert main(["bag", str(bag), "--program", PROGRAM, "--quiet", "--output", str(recording)]) == 0
    options = ["--program", tf_program, "--direct", "false", "--quiet"]
    assert main(["bag", str(recording), *options, "--output", str(target)]) == 0
    warning = (
        f"warning: --output {target}: this becomes a bag of ROS 1; a name that ends in .mcap makes it one of"
    )
    assert warning in capsys.readouterr().err
    assert main(["bag", str(recording), *options, "--output", f"{target}.bag"]) == 0
    assert "becomes a bag" not in capsys.readouterr().err


@pytest.mark.parametrize("suffix", ["jsonl", "csv", "db3"])
def test_output_with_suffix_of_other_format_is_refused(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str
) -> None:
    assert main(["bag", str(bag), "--program", PROGRAM, "--output", str(tmp_path / f"out.{suffix}")]) == 1
    assert "expected the name of a bag, out.bag or out.mcap; with --jobs, --format" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_output_to_folder_needs_jobs(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bag", str(bag), "--program", PROGRAM, "--output", str(tmp_path)]) == 1
    assert f"--output {tmp_path} is a folder: expected a file; with --jobs," in capsys.readouterr().err


def test_output_to_url_needs_jobs(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bag", str(bag), "--program", PROGRAM, "--output", "s3://fleet/out.bag"]) == 1
    assert capsys.readouterr().err == (
        "retalis: --output s3://fleet/out.bag: --jobs writes results to URLs, one for each bag\n"
    )


def test_quiet_option_prints_nothing(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bag", str(bag), "--program", PROGRAM, "--quiet"]) == 0
    assert capsys.readouterr().out == ""


def test_additional_topic_has_events(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe></publish_subscribe>")
    (tmp_path / "goalPredicates.txt").write_text("subscribe(tf__0__tfMessage(_),[],seen,seen,i)\n")
    status = main(["bag", str(bag), "--program", str(tmp_path), "--topic", "/tf=tf/tfMessage"])
    lines = capsys.readouterr().out.splitlines()
    assert set(lines) == {"output(seen,seen)."}
    assert status == 0


@pytest.fixture
def tf_program(tmp_path: Path) -> str:
    """Return a program that uses ``tf`` without subscribing it, as with ``direct:=auto`` in a node."""
    (tmp_path / "pub_sub.xml").write_text(
        '<publish_subscribe><publish_to name="seen" msg_type="std_msgs/String"/></publish_subscribe>'
    )
    goal = "subscribe(tf__0__tfMessage(_), [], std_msgs__0__String('\"x\"'), seen, i)\n"
    (tmp_path / "goalPredicates.txt").write_text(goal)
    return str(tmp_path)


@pytest.mark.parametrize(
    "options", [[], ["--direct=auto"], ["--direct", "true"], ["--direct", "[tf, tf/tfMessage]"]]
)
def test_direct_topics_are_played(
    bag: Path, tf_program: str, capsys: pytest.CaptureFixture[str], options: List[str]
) -> None:
    assert main(["bag", str(bag), "--program", tf_program, *options]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert set(captured.out.splitlines()) == {"output(std_msgs__0__String('\"x\"'),seen)."}


def test_direct_false_plays_no_direct_topic(
    bag: Path, tf_program: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bag", str(bag), "--program", tf_program, "--direct", "false"]) == 0
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "no producer of tf__0__tfMessage/1: no topic of that type is subscribed" in captured.err


@pytest.mark.slow
@pytest.mark.parametrize(("options", "has_output"), [(["--direct", "false"], False), ([], True)])
def test_many_bags_have_same_direct_topics(
    bag: Path, tf_program: str, capsys: pytest.CaptureFixture[str], options: List[str], has_output: bool
) -> None:
    assert main(["bag", str(bag), "--program", tf_program, "--jobs", "1", *options]) == 0
    assert bool(capsys.readouterr().out) == has_output


def test_topic_without_type_is_warned_of_once(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe></publish_subscribe>")
    (tmp_path / "goalPredicates.txt").write_text("subscribe(tf__0__tfMessage(_),[],seen,seen,i)\n")
    assert main(["bag", str(bag), "--program", str(tmp_path), "--topic", "/tf=tf/tfMessage", "--quiet"]) == 0
    warning, line, caret = capsys.readouterr().err.splitlines()
    assert warning.startswith(f"warning: {tmp_path}/goalPredicates.txt:1:39: topic seen has no type: ")
    assert '<publish_to name="seen" msg_type="package/Type"/> in pub_sub.xml' in warning
    assert line.index("seen,i") == caret.index("^")


def test_topics_of_written_bag_are_latched(bag: Path, tmp_path: Path) -> None:
    message_type = 'msg_type="std_msgs/String"'
    (tmp_path / "pub_sub.xml").write_text(
        f'<publish_subscribe><publish_to name="a" {message_type} latch="true"/><publish_to name="b" {message_type}/>'
        '<subscribe_to name="tf" msg_type="tf/tfMessage"/></publish_subscribe>'
    )
    goals = (
        f"subscribe(tf__0__tfMessage(_), [], std_msgs__0__String('\"x\"'), {topic}, i)\n" for topic in "ab"
    )
    (tmp_path / "goalPredicates.txt").write_text("".join(goals))
    target = tmp_path / "out.bag"
    arguments = ["bag", str(bag), "--program", str(tmp_path), "--quiet", "--output", str(target)]
    assert main(arguments) == 0
    with BagReader(target) as reader:
        assert {topic.name: topic.latched for topic in reader.topics} == {"/a": True, "/b": False}


@pytest.mark.parametrize("topic", ["tf", "tf=", "tf=tfMessage", "tf=a/b/c"])
def test_invalid_topic_is_an_error(bag: Path, capsys: pytest.CaptureFixture[str], topic: str) -> None:
    assert main(["bag", str(bag), "--program", PROGRAM, "--topic", topic]) == 1
    assert "expected TOPIC=package/Type" in capsys.readouterr().err


def test_missing_program_is_an_error(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bag", str(bag), "--program", str(tmp_path / "no")]) == 1
    assert str(tmp_path / "no") in capsys.readouterr().err


@pytest.mark.parametrize("name", ["wrong.bag", "missing.bag"])
def test_invalid_or_missing_bag_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    (tmp_path / "wrong.bag").write_text("no bag")
    assert main(["bag", str(tmp_path / name), "--program", PROGRAM]) == 1
    assert name in capsys.readouterr().err


def test_option_times_prints_time_of_bag(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bag", str(bag), "--program", PROGRAM, "--times", "--start", "1", "--duration", "1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines
    times = [re.search(r",datime\(2014,10,19,19,50,([67]),\d+\)\)\.$", line) for line in lines]
    assert all(times)


@pytest.mark.slow
def test_json_of_interval_has_all_record_types(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--json", "--events", "--start", "1", "--duration", "1"]
    explain_options = ["--explain", "face_by_marker(_,_,_)", "--explain", "never"]
    assert main(["bag", str(bag), "--program", PROGRAM, *options, *explain_options]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    record_types = Counter(next(iter(line)) for line in lines)
    assert set(record_types) == {"event", "output", "wait", "memory", "explain"}
    assert record_types["memory"] == 5
    assert [line["happened"] for line in lines if "explain" in line] == [True, False]
    start = 1413748206 * 10**9
    for line in lines:
        for name in ("start", "end", "time"):
            assert start - 10**9 < line.get(name, start) < start + 2 * 10**9
    assert all(line["start"] <= line["end"] for line in lines if "wait" in line)


@pytest.mark.slow
def test_option_events_prints_events_and_outputs(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bag", str(bag), "--program", PROGRAM, "--events", "--duration", "0.5"]) == 0
    record_types = {line.partition("(")[0] for line in capsys.readouterr().out.splitlines()}
    assert record_types == {"event", "output"}


@pytest.mark.slow
def test_bag_is_replaced_only_with_overwrite(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "out.bag"
    arguments = ["bag", str(bag), "--program", PROGRAM, "--quiet", "--duration", "1"]
    assert main([*arguments, "--output", str(target)]) == 0
    assert main([*arguments, "--output", str(target)]) == 1
    assert f"{target} already exists; --overwrite replaces it" in capsys.readouterr().err
    before = target.stat().st_ino, target.stat().st_mtime_ns
    assert main([*arguments, "--output", str(target), "--overwrite"]) == 0
    assert (target.stat().st_ino, target.stat().st_mtime_ns) != before


def test_bag_is_not_overwritten_by_its_own_results(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = bag.read_bytes()
    assert main(["bag", str(bag), "--program", PROGRAM, "--output", str(bag), "--overwrite"]) == 1
    assert "this is the bag that is read" in capsys.readouterr().err
    assert bag.read_bytes() == before


@pytest.mark.parametrize("command", ["bag", "events", "console"])
def test_help_has_defaults_of_limits(capsys: pytest.CaptureFixture[str], command: str) -> None:
    with pytest.raises(SystemExit):
        main([command, "--help-all"])
    text = " ".join(capsys.readouterr().out.split())
    descriptions = dict(re.findall(r"(--max-\w+|--watchdog) [A-Z]+ (.*?\))", text))
    assert {"--max-seconds", "--max-depth", "--watchdog"} <= descriptions.keys()
    for option, description in descriptions.items():
        assert re.search(r"\((\d+|0: [\w ]+)\)$", description), option


@pytest.mark.parametrize("folder", ["", "arm_msgs", "arm_msgs/msg"])
def test_types_of_silent_topic_are_found_in_folder(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], folder: str
) -> None:
    (tmp_path / "arm_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "arm_msgs" / "msg" / "Feedback.msg").write_text("int32 id\nbool ok\n")
    program = tmp_path / "program"
    program.mkdir()
    (program / "pub_sub.xml").write_text(
        '<publish_subscribe><subscribe_to name="feedback" msg_type="arm_msgs/Feedback"/></publish_subscribe>'
    )
    (program / "eventRules.txt").write_text(
        "silent <- ar_pose__0__ARMarkers(_, _) seq absent(arm_msgs__0__Feedback{ok: true}, 1).\n"
    )
    (program / "goalPredicates.txt").write_text(
        "compile_event_file('eventRules.txt')\nsubscribe(silent, [], silent, alarms, a)\n"
    )
    command = ["bag", str(bag), "--program", str(program), "--topic", "/ar_pose_marker=ar_pose/ARMarkers"]
    assert main(command) == 1
    assert "arm_msgs/Feedback" in capsys.readouterr().err
    assert main([*command, "--msg", str(tmp_path / folder)]) == 0
    assert "output(silent,alarms)." in capsys.readouterr().out


def test_flush_and_open_options_end_the_bag(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe></publish_subscribe>")
    (tmp_path / "eventRules.txt").write_text(
        "first <- ar_pose__0__ARMarkers(_, _) with throttle(1000).\nlost <- first seq absent(beat, 100).\n"
        ":- state(seen, from(first), until(beat)).\nmany(N) <- aggregate(count, first, N, every(5, events)).\n"
    )
    (tmp_path / "goalPredicates.txt").write_text(
        "compile_event_file('eventRules.txt')\nsubscribe(lost, [], lost, alarms, a)\n"
    )
    command = ["bag", str(bag), "--program", str(tmp_path), "--topic", "/ar_pose_marker=ar_pose/ARMarkers"]
    assert main(command) == 0
    assert capsys.readouterr().out == ""
    assert main([*command, "--flush", "200", "--open", "--json", "--watermark-delay", "0"]) == 0
    output, state, window = map(json.loads, capsys.readouterr().out.splitlines())
    assert (output["output"], state["open"]) == ("lost", "seen")
    assert (window["open_window"], window["rule"], window["elements"]) == ("every(5,events)", "many(N)", 1)
    # The alarm is 100 s after the event with which the state began.
    assert output["time"] == state["start"] + 100 * 10**9


def test_goal_output_with_json_is_on_stderr(
    tmp_path: Path, bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "program"
    folder.mkdir()
    (folder / "pub_sub.xml").write_text("<publish_subscribe/>")
    (folder / "goalPredicates.txt").write_text("write(loaded), nl\ncompile_event_file('eventRules.txt')\n")
    (folder / "eventRules.txt").write_text("seen <- tf__0__tfMessage(_) where (write(x), nl).\n")
    assert main(["bag", str(bag), "--program", str(folder), "--duration", "1", "--json", "--events"]) == 0
    captured = capsys.readouterr()
    assert captured.out.splitlines()
    assert all(map(json.loads, captured.out.splitlines()))
    assert set(captured.err.splitlines()) == {"loaded", "x"}


def test_calls_have_answers_of_file(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A delayed answer is an event between those of the bag."""
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe></publish_subscribe>")
    (tmp_path / "rules.txt").write_text(
        "first(T) <- tf__0__tfMessage(_) with throttle(1000) where ros_param('/limit', T).\n"
        "first(T) do ros_service('/dock', 'std_srvs/Trigger', std_srvs__0__Trigger_Request, d).\n"
        "docked(T) <- first(T) seq service_reply(_, d, _).\n"
    )
    (tmp_path / "goalPredicates.txt").write_text(
        "compile_event_file('rules.txt')\nsubscribe(docked(T), [], docked(T), out, i)\n"
    )
    answers = tmp_path / "answers.yaml"
    answers.write_text("services: [{name: /dock, reply: {}, delay: 1}]\nparameters: {/limit: 40}\n")
    command = ["bag", str(bag), "--program", str(tmp_path), "--topic", "/tf=tf/tfMessage"]
    assert main([*command, "--answers", str(answers)]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("output(docked(40),out)")
    assert main(command) == 0
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "there is no parameter /limit" in captured.err
