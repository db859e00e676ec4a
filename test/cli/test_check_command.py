"""The command ``check``: what it prints, where it looks for types, and how it ends."""

import json
import os
from pathlib import Path

import pytest
from source import ROOT

from retalis import BagWriter, Definitions
from retalis.cli.command_line import main

TOPICS = '<publish_subscribe><subscribe_to name="hot" msg_type="my_robot/Heat"/></publish_subscribe>'
RULES = "hot(X) <- my_robot__0__Heat(X, _) seq hot(X).\nprint_trigger(hot/1).\n"


@pytest.fixture
def folder(tmp_path):
    found = tmp_path / "program"
    found.mkdir()
    (found / "pub_sub.xml").write_text(TOPICS)
    (found / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt')\n")
    (found / "eventRules.txt").write_text(RULES)
    return found


def checked(capsys, *arguments):
    """Return the exit status and what is printed."""
    status = main(["check", *map(str, arguments)])
    return status, capsys.readouterr().out


def test_nothing_is_said_of_the_example(capsys):
    folder = ROOT / "application_source"
    assert checked(capsys, folder, "--strict") == (0, f"{folder}: no errors, no warnings\n")


def test_the_folder_is_the_working_directory_by_default(capsys, folder, monkeypatch):
    monkeypatch.chdir(folder)
    assert checked(capsys) == (0, ".: no errors, no warnings\n")


def test_warnings_count_where_that_is_wanted(capsys, folder):
    (folder / "eventRules.txt").write_text(f"{RULES}cold <- hto(_).\nprint_trigger(cold).\n")
    said = (
        f"warning: {folder}/eventRules.txt:3:9: no producer of hto/1: no topic, rule or goal; "
        "did you mean hot/1? [RT1201]\n"
        f"cold <- hto(_).\n        ^\n{folder}: no errors, 1 warning\n"
    )
    assert checked(capsys, folder) == (0, said)
    assert checked(capsys, folder, "--strict") == (2, said)


def test_errors_count_always(capsys, folder):
    (folder / "eventRules.txt").write_text("a <- .\n")
    status, said = checked(capsys, folder, "--strict")
    assert status == 1
    assert said.startswith(f"error: {folder}/eventRules.txt:1:6: ")
    assert said.endswith(f"{folder}: 1 error, no warnings\n")


def test_json_has_the_same(capsys, folder):
    (folder / "eventRules.txt").write_text(f"{RULES}cold <- hto(_).\nprint_trigger(cold).\n")
    status, said = checked(capsys, folder, "--format", "json")
    assert status == 0
    assert json.loads(said) == {
        "errors": 0,
        "warnings": 1,
        "infos": 0,
        "findings": [
            {
                "severity": "warning",
                "check": "never-made",
                "code": "RT1201",
                "message": "no producer of hto/1: no topic, rule or goal; did you mean hot/1?",
                "file": f"{folder}/eventRules.txt",
                "line": 3,
                "column": 9,
                "text": "cold <- hto(_).",
            }
        ],
    }


@pytest.mark.parametrize("where", ["my_robot", "my_robot/msg", "."])
def test_types_come_from_folders(capsys, folder, tmp_path, where):
    (tmp_path / "my_robot" / "msg").mkdir(parents=True)
    (tmp_path / "my_robot" / "msg" / "Heat.msg").write_text("float64 heat\n")
    status, said = checked(capsys, folder, "--msg", tmp_path / where)
    assert status == 0
    assert "my_robot__0__Heat/2 does not match its type: my_robot/Heat has 1 slot: heat" in said


def test_types_come_from_bags(capsys, folder, tmp_path):
    with BagWriter(tmp_path / "hot.bag") as bag:
        bag.write(bag.add("/hot", Definitions().add("my_robot/Heat", "float64 heat")), 1, bytes(8))
    assert "my_robot/Heat has 1 slot" in checked(capsys, folder, "--bag", tmp_path / "hot.bag")[1]


def test_what_is_missing_is_an_error(capsys, tmp_path):
    status, said = checked(capsys, tmp_path)
    assert status == 1
    assert f"error: cannot read {tmp_path}/pub_sub.xml: No such file or directory [RT1000]\n" in said
    assert f"error: cannot read {tmp_path}/goalPredicates.txt: No such file or directory [RT1000]\n" in said


def test_goals_print_nothing(capsys, folder):
    (folder / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt')\nwrite(hello), nl\n")
    assert checked(capsys, folder) == (0, f"{folder}: no errors, no warnings\n")


def test_a_folder_that_may_not_be_entered(capsys, folder, monkeypatch):
    """Who is root may enter all of them: here the system says no."""
    real_stat, real_text = os.stat, Path.read_text

    def refuse(path):
        if str(path).startswith(f"{folder}/"):
            raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(
        os, "stat", lambda path, *rest, **options: refuse(path) or real_stat(path, *rest, **options)
    )
    monkeypatch.setattr(Path, "read_text", lambda path, **options: refuse(path) or real_text(path, **options))
    status, said = checked(capsys, folder)
    assert status == 1
    assert f"error: cannot read {folder}/pub_sub.xml: Permission denied [RT1000]\n" in said


def test_a_bag_prints_the_events_that_a_program_shows(capsys, folder, tmp_path):
    definition = Definitions().add("my_robot/Heat", "float64 heat\nfloat64 wind")
    with BagWriter(tmp_path / "hot.bag") as bag:
        bag.write(bag.add("/hot", definition), 10**9, bytes(16))
    (folder / "eventRules.txt").write_text("hot(X) <- my_robot__0__Heat(X, _).\nprint_trigger(hot/1).\n")
    assert main(["bag", str(tmp_path / "hot.bag"), "--program", str(folder)]) == 0
    assert "event(hot(0.0),[datime(1970,1,1,0,0,1,0),datime(1970,1,1,0,0,1,0)])\n" in capsys.readouterr().err


def test_a_file_of_rules_is_looked_at_alone(capsys, tmp_path):
    rules = tmp_path / "rules.txt"
    rules.write_text("hot(T) <- warm(T) where T > 30.\nfire <- hot(_, _) seq smoke.\n")
    assert checked(capsys, rules) == (
        0,
        f"warning: {rules}:2:9: no producer of hot/2: no topic, rule or goal; did you mean hot/1? [RT1201]\n"
        f"fire <- hot(_, _) seq smoke.\n        ^\n{rules}: no errors, 1 warning\n",
    )


def test_goals_that_never_end_are_errors(capsys, folder):
    (folder / "eventRules.txt").write_text(RULES + "forever :- forever.\n:- forever.\n")
    status, text = checked(capsys, folder, "--max-seconds", "0.1")
    assert status == 1
    assert (
        f"{folder}/eventRules.txt:4:4: this directive raises an error: Not enough resources: seconds" in text
    )


def test_option_json_is_the_json_format(capsys, folder):
    texts = [checked(capsys, folder, *options)[1] for options in (["--json"], ["--format", "json"])]
    assert texts[0] == texts[1] and json.loads(texts[0])["errors"] == 0


@pytest.mark.parametrize(
    "topic, message",
    [
        ("/hto", "the bag has no topic hot; did you mean hto?"),
        ("/engine", "the bag has no topic hot; did you mean /engine?"),
        ("/hot", ""),
    ],
)
def test_topics_are_compared_with_bags(capsys, folder, tmp_path, topic, message):
    heat = Definitions().add("my_robot/Heat", "float64 heat\nfloat64 time")
    with BagWriter(tmp_path / "hot.bag") as bag:
        bag.write(bag.add(topic, heat), 1, bytes(16))
    status, printed = checked(capsys, folder, "--bag", tmp_path / "hot.bag")
    assert [line for line in printed.split("\n") if "RT1101" in line] == (
        [f"warning: {folder}/pub_sub.xml:1:20: {message} [RT1101]"] if message else []
    )


def test_type_of_topic_is_compared_with_bags(capsys, folder, tmp_path):
    with BagWriter(tmp_path / "hot.bag") as bag:
        bag.write(bag.add("/hot", Definitions().add("my_robot/Cold", "float64 heat")), 1, bytes(8))
    assert (
        "topic hot is my_robot/Cold in the bag, not my_robot/Heat"
        in checked(capsys, folder, "--bag", tmp_path / "hot.bag")[1]
    )


def test_rule_in_goal_file_is_reported(capsys, folder):
    (folder / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt')\nhot(X) <- cold(X)\n")
    status, printed = checked(capsys, folder)
    assert status == 1
    assert "goalPredicates.txt:2:1: this is a rule, not a goal: write it into a file" in printed


def test_spans_are_compared_with_the_rate_of_bags(capsys, folder, tmp_path):
    heat = Definitions().add("my_robot/Heat", "float64 heat\nfloat64 time")
    with BagWriter(tmp_path / "hot.bag") as bag:
        connection = bag.add("/hot", heat)
        for index in range(11):
            bag.write(connection, index * 10**8 + 1, bytes(16))
    rules = (
        "cold <- my_robot__0__Heat(_, _) seq absent(my_robot__0__Heat(_, _), 250).\nprint_trigger(cold/0).\n"
    )
    (folder / "eventRules.txt").write_text(rules)
    assert "RT1213" not in checked(capsys, folder)[1]
    printed = checked(capsys, folder, "--bag", tmp_path / "hot.bag")[1]
    assert (
        "250 is 4.17 minutes, because spans are in seconds; in the bag, a message of hot arrives every 0.1 s"
        in printed
    )


def test_missing_topics_are_reported_with_similar_file(capsys, folder):
    (folder / "pub_sub.xml").rename(folder / "pubsub.xml")
    assert (
        "pub_sub.xml: No such file or directory; did you mean pubsub.xml? [RT1000]"
        in checked(capsys, folder)[1]
    )
