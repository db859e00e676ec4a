"""``python3 -m retalis bag``: a program over a bag."""

import sys
from pathlib import Path

import pytest

from retalis.cli import main
from retalis.engine.playback import BagReader

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


def test_a_topic_without_a_type_is_warned_of_once(bag, tmp_path, capsys):
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe></publish_subscribe>")
    (tmp_path / "goalPredicates.txt").write_text("subscribe(tf__0__tfMessage(_),[],seen,seen,i)\n")
    assert main(["bag", str(bag), "--program", str(tmp_path), "--topic", "/tf=tf/tfMessage", "--quiet"]) == 0
    told, summed_up = capsys.readouterr().err.splitlines()
    assert told.startswith("warning: topic seen has no type: ")
    assert '<publish_to name="seen" msg_type="package/Type"/> in pub_sub.xml' in told
    assert "times in all: topic seen" in summed_up


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
