"""``python3 -m retalis bag``: a program over a bag."""

import json
import re
import sys
from collections import Counter
from pathlib import Path

import pytest

from retalis import BagReader
from retalis.cli.command_line import main

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "examples" / "nao"))
from make_bag import make_bag  # noqa: E402

PROGRAM = str(ROOT / "application_source")


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp("bags") / "nao.bag"
    make_bag(path, 3.0, 1)
    return path


def test_prints_what_is_published(bag, capsys):
    assert main(["bag", str(bag), "--program", PROGRAM]) == 0
    shown = capsys.readouterr()
    lines = shown.out.splitlines()
    assert shown.err == ""
    assert lines
    assert all(line.startswith("output(") and line.endswith(").") for line in lines)
    assert any(line.endswith(",marker1).") for line in lines)


def test_writes_what_is_published_into_a_bag(bag, tmp_path, capsys):
    written = tmp_path / "out.bag"
    assert main(["bag", str(bag), "--program", PROGRAM, "--output", str(written)]) == 0
    printed = len(capsys.readouterr().out.splitlines())
    with BagReader(written) as reader:
        assert reader.messages == printed > 0


def test_prints_nothing_when_quiet(bag, capsys):
    assert main(["bag", str(bag), "--program", PROGRAM, "--quiet"]) == 0
    assert capsys.readouterr().out == ""


def test_more_topics_become_events(bag, tmp_path, capsys):
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe></publish_subscribe>")
    (tmp_path / "goalPredicates.txt").write_text("subscribe(tf__0__tfMessage(_),[],seen,seen,i)\n")
    status = main(["bag", str(bag), "--program", str(tmp_path), "--topic", "/tf=tf/tfMessage"])
    lines = capsys.readouterr().out.splitlines()
    assert set(lines) == {"output(seen,seen)."}
    assert status == 0


@pytest.fixture
def reads_tf(tmp_path):
    """Return a program that leaves ``tf`` to the node, as ``direct:=auto`` has it."""
    (tmp_path / "pub_sub.xml").write_text(
        '<publish_subscribe><publish_to name="seen" msg_type="std_msgs/String"/></publish_subscribe>'
    )
    goal = "subscribe(tf__0__tfMessage(_), [], std_msgs__0__String('\"x\"'), seen, i)\n"
    (tmp_path / "goalPredicates.txt").write_text(goal)
    return str(tmp_path)


@pytest.mark.parametrize(
    "options", [[], ["--direct=auto"], ["--direct", "true"], ["--direct", "[tf, tf/tfMessage]"]]
)
def test_topics_that_a_node_subscribes_by_itself_are_played_too(bag, reads_tf, capsys, options):
    assert main(["bag", str(bag), "--program", reads_tf, *options]) == 0
    shown = capsys.readouterr()
    assert shown.err == ""
    assert set(shown.out.splitlines()) == {"output(std_msgs__0__String('\"x\"'),seen)."}


def test_no_topic_is_direct_on_request(bag, reads_tf, capsys):
    assert main(["bag", str(bag), "--program", reads_tf, "--direct", "false"]) == 0
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "no topic" in shown.err or "no producer of" in shown.err


@pytest.mark.slow
def test_many_bags_have_the_same_direct_topics(bag, reads_tf, capsys):
    for options, lines in ((["--direct", "false"], False), ([], True)):
        assert main(["bag", str(bag), "--program", reads_tf, "--jobs", "1", *options]) == 0
        assert bool(capsys.readouterr().out) == lines


def test_a_topic_without_a_type_is_warned_of_once(bag, tmp_path, capsys):
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe></publish_subscribe>")
    (tmp_path / "goalPredicates.txt").write_text("subscribe(tf__0__tfMessage(_),[],seen,seen,i)\n")
    assert main(["bag", str(bag), "--program", str(tmp_path), "--topic", "/tf=tf/tfMessage", "--quiet"]) == 0
    told, line, caret = capsys.readouterr().err.splitlines()
    assert told.startswith(f"warning: {tmp_path}/goalPredicates.txt:1:39: topic seen has no type: ")
    assert '<publish_to name="seen" msg_type="package/Type"/> in pub_sub.xml' in told
    assert line.index("seen,i") == caret.index("^")


def test_topics_are_latched_in_the_bag_that_is_written(bag, tmp_path):
    kinds = 'msg_type="std_msgs/String"'
    (tmp_path / "pub_sub.xml").write_text(
        f'<publish_subscribe><publish_to name="a" {kinds} latch="true"/><publish_to name="b" {kinds}/>'
        '<subscribe_to name="tf" msg_type="tf/tfMessage"/></publish_subscribe>'
    )
    goals = (
        f"subscribe(tf__0__tfMessage(_), [], std_msgs__0__String('\"x\"'), {topic}, i)\n" for topic in "ab"
    )
    (tmp_path / "goalPredicates.txt").write_text("".join(goals))
    written = tmp_path / "out.bag"
    arguments = ["bag", str(bag), "--program", str(tmp_path), "--quiet", "--output", str(written)]
    assert main(arguments) == 0
    with BagReader(written) as reader:
        assert {topic.name: topic.latched for topic in reader.topics} == {"/a": True, "/b": False}


@pytest.mark.parametrize("topic", ["tf", "tf=", "tf=tfMessage", "tf=a/b/c"])
def test_a_wrong_topic_is_refused(bag, capsys, topic):
    assert main(["bag", str(bag), "--program", PROGRAM, "--topic", topic]) == 1
    assert "expected TOPIC=package/Type" in capsys.readouterr().err


def test_a_program_that_is_not_there_is_an_error(bag, tmp_path, capsys):
    assert main(["bag", str(bag), "--program", str(tmp_path / "no")]) == 1
    assert str(tmp_path / "no") in capsys.readouterr().err


def test_a_bag_that_is_none_is_an_error(tmp_path, capsys):
    wrong = tmp_path / "wrong.bag"
    wrong.write_text("no bag")
    assert main(["bag", str(wrong), "--program", PROGRAM]) == 1
    assert main(["bag", str(tmp_path / "no.bag"), "--program", PROGRAM]) == 1
    assert "no.bag" in capsys.readouterr().err


def test_outputs_have_the_time_of_the_bag_where_it_is_asked_for(bag, capsys):
    assert main(["bag", str(bag), "--program", PROGRAM, "--times", "--start", "1", "--duration", "1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines
    times = [re.search(r",datime\(2014,10,19,19,50,([67]),\d+\)\)\.$", line) for line in lines]
    assert all(times)


@pytest.mark.slow
def test_a_part_of_a_bag_as_json_with_events_waits_and_memories(bag, capsys):
    asked = ["--json", "--events", "--start", "1", "--duration", "1"]
    explained = ["--explain", "face_by_marker(_,_,_)", "--explain", "never"]
    assert main(["bag", str(bag), "--program", PROGRAM, *asked, *explained]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    kinds = Counter(next(iter(line)) for line in lines)
    assert set(kinds) == {"event", "output", "wait", "memory", "explain"}
    assert kinds["memory"] == 5
    assert [line["happened"] for line in lines if "explain" in line] == [True, False]
    first = 1413748206 * 10**9
    for line in lines:
        for name in ("start", "end", "time"):
            assert first - 10**9 < line.get(name, first) < first + 2 * 10**9
    assert all(line["start"] <= line["end"] for line in lines if "wait" in line)


@pytest.mark.slow
def test_events_are_printed_beside_outputs(bag, capsys):
    assert main(["bag", str(bag), "--program", PROGRAM, "--events", "--duration", "0.5"]) == 0
    kinds = {line.partition("(")[0] for line in capsys.readouterr().out.splitlines()}
    assert kinds == {"event", "output"}


@pytest.mark.slow
def test_a_bag_is_replaced_only_where_that_is_asked_for(bag, tmp_path, capsys):
    written = tmp_path / "out.bag"
    arguments = ["bag", str(bag), "--program", PROGRAM, "--quiet", "--duration", "1"]
    assert main([*arguments, "--output", str(written)]) == 0
    assert main([*arguments, "--output", str(written)]) == 1
    assert f"{written} already exists; --overwrite replaces it" in capsys.readouterr().err
    before = written.stat().st_ino, written.stat().st_mtime_ns
    assert main([*arguments, "--output", str(written), "--overwrite"]) == 0
    assert (written.stat().st_ino, written.stat().st_mtime_ns) != before
    assert main([*arguments, "--output", str(bag), "--overwrite"]) == 1
    assert "this is the bag that is read" in capsys.readouterr().err
    assert bag.stat().st_size > 0


def test_defaults_of_limits_are_in_the_help(capsys):
    for command in ("bag", "events", "console"):
        with pytest.raises(SystemExit):
            main([command, "--help"])
        shown = " ".join(capsys.readouterr().out.split())
        for option in re.findall(r"(--max-\w+|--watchdog) [A-Z]+ (.*?\))", shown):
            assert re.search(r"\((\d+|0: [\w ]+)\)$", option[1]), option


@pytest.mark.parametrize("folder", ["", "arm_msgs", "arm_msgs/msg"])
def test_message_types_of_topic_without_messages_come_from_folder(bag, tmp_path, capsys, folder):
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
    play = ["bag", str(bag), "--program", str(program), "--topic", "/ar_pose_marker=ar_pose/ARMarkers"]
    assert main(play) == 1
    assert "arm_msgs/Feedback" in capsys.readouterr().err
    assert main([*play, "--msg", str(tmp_path / folder)]) == 0
    assert "output(silent,alarms)." in capsys.readouterr().out


def test_flush_ends_windows_after_bag_and_what_is_open_is_printed(bag, tmp_path, capsys):
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe></publish_subscribe>")
    (tmp_path / "eventRules.txt").write_text(
        "first <- ar_pose__0__ARMarkers(_, _) with throttle(1000).\nlost <- first seq absent(beat, 100).\n"
        ":- state(seen, from(first), until(beat)).\nmany(N) <- aggregate(count, first, N, every(5, events)).\n"
    )
    (tmp_path / "goalPredicates.txt").write_text(
        "compile_event_file('eventRules.txt')\nsubscribe(lost, [], lost, alarms, a)\n"
    )
    play = ["bag", str(bag), "--program", str(tmp_path), "--topic", "/ar_pose_marker=ar_pose/ARMarkers"]
    assert main(play) == 0
    assert capsys.readouterr().out == ""
    assert main([*play, "--flush", "200", "--open", "--json", "--watermark-delay", "0"]) == 0
    output, state, window = map(json.loads, capsys.readouterr().out.splitlines())
    assert (output["output"], state["open"]) == ("lost", "seen")
    assert (window["open_window"], window["rule"], window["elements"]) == ("every(5,events)", "many(N)", 1)
    # The alarm is 100 s after the event with which the state began.
    assert output["time"] == state["start"] + 100 * 10**9


def test_goal_output_beside_json_goes_to_stderr(tmp_path, bag, capsys):
    folder = tmp_path / "program"
    folder.mkdir()
    (folder / "pub_sub.xml").write_text("<publish_subscribe/>")
    (folder / "goalPredicates.txt").write_text("write(loaded), nl\ncompile_event_file('eventRules.txt')\n")
    (folder / "eventRules.txt").write_text("seen <- tf__0__tfMessage(_) where (write(x), nl).\n")
    assert main(["bag", str(bag), "--program", str(folder), "--duration", "1", "--json", "--events"]) == 0
    captured = capsys.readouterr()
    assert captured.out.splitlines() and all(map(json.loads, captured.out.splitlines()))
    assert set(captured.err.splitlines()) == {"loaded", "x"}
