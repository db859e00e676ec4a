"""Command ``check``: findings, message types, and exit status."""

import json
import os
from pathlib import Path
from typing import Any, List, Tuple

import pytest
from parsed_sources import ROOT
from recorded_calls import preceded_by

from retalis import BagWriter, Definitions
from retalis.cli.command_line import main

TOPICS = '<publish_subscribe><subscribe_to name="hot" msg_type="my_robot/Heat"/></publish_subscribe>'
RULES = "hot(X) <- my_robot__0__Heat(X, _) seq hot(X).\nprint_trigger(hot/1).\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    program = tmp_path / "program"
    program.mkdir()
    (program / "pub_sub.xml").write_text(TOPICS)
    (program / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt')\n")
    (program / "eventRules.txt").write_text(RULES)
    return program


def run_check(capsys: pytest.CaptureFixture[str], *arguments: Any) -> Tuple[Any, ...]:
    """Return the exit status and the printed text."""
    status = main(["check", *map(str, arguments)])
    return status, capsys.readouterr().out


def test_example_has_no_findings(capsys: pytest.CaptureFixture[str]) -> None:
    folder = ROOT / "application_source"
    assert run_check(capsys, folder, "--strict") == (0, f"{folder}: no errors, no warnings\n")


def test_default_folder_is_working_folder(
    capsys: pytest.CaptureFixture[str], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    assert run_check(capsys) == (0, ".: no errors, no warnings\n")


def test_warnings_are_errors_if_strict(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "eventRules.txt").write_text(f"{RULES}cold <- hto(_).\nprint_trigger(cold).\n")
    text = (
        f"warning: {folder}/eventRules.txt:3:9: no producer of hto/1: no topic, rule or goal; "
        "did you mean hot/1? [RT1201]\n"
        f"cold <- hto(_).\n        ^\n{folder}: no errors, 1 warning\n"
    )
    assert run_check(capsys, folder) == (0, text)
    assert run_check(capsys, folder, "--strict") == (2, text)


def test_error_has_status_1(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "eventRules.txt").write_text("a <- .\n")
    status, text = run_check(capsys, folder, "--strict")
    assert status == 1
    assert text.startswith(f"error: {folder}/eventRules.txt:1:6: ")
    assert text.endswith(f"{folder}: 1 error, no warnings\n")


def test_json_has_findings(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "eventRules.txt").write_text(f"{RULES}cold <- hto(_).\nprint_trigger(cold).\n")
    status, text = run_check(capsys, folder, "--format", "json")
    assert status == 0
    assert json.loads(text) == {
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


@pytest.mark.parametrize("folder_name", ["my_robot", "my_robot/msg", "."])
def test_types_are_found_in_folders(
    capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path, folder_name: str
) -> None:
    (tmp_path / "my_robot" / "msg").mkdir(parents=True)
    (tmp_path / "my_robot" / "msg" / "Heat.msg").write_text("float64 heat\n")
    status, text = run_check(capsys, folder, "--msg", tmp_path / folder_name)
    assert status == 0
    assert "my_robot__0__Heat/2 does not match its type: my_robot/Heat has 1 slot: heat" in text


def test_types_are_found_in_bags(capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "hot.bag") as bag:
        bag.write(bag.add("/hot", Definitions().add("my_robot/Heat", "float64 heat")), 1, bytes(8))
    assert "my_robot/Heat has 1 slot" in run_check(capsys, folder, "--bag", tmp_path / "hot.bag")[1]


def test_missing_files_are_errors(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    status, text = run_check(capsys, tmp_path)
    assert status == 1
    assert f"error: cannot read {tmp_path}/pub_sub.xml: No such file or directory [RT1000]\n" in text
    assert f"error: cannot read {tmp_path}/goalPredicates.txt: No such file or directory [RT1000]\n" in text


def test_goals_print_nothing(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt')\nwrite(hello), nl\n")
    assert run_check(capsys, folder) == (0, f"{folder}: no errors, no warnings\n")


def test_forbidden_folder_is_an_error(
    capsys: pytest.CaptureFixture[str], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The system call is replaced, because root may enter all folders."""
    real_stat, real_text = os.stat, Path.read_text

    def refuse(path: Any) -> None:
        if str(path).startswith(f"{folder}/"):
            raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(os, "stat", preceded_by(refuse, real_stat))
    monkeypatch.setattr(Path, "read_text", preceded_by(refuse, real_text))
    status, text = run_check(capsys, folder)
    assert status == 1
    assert f"error: cannot read {folder}/pub_sub.xml: Permission denied [RT1000]\n" in text


def test_playback_prints_traced_events(
    capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path
) -> None:
    definition = Definitions().add("my_robot/Heat", "float64 heat\nfloat64 wind")
    with BagWriter(tmp_path / "hot.bag") as bag:
        bag.write(bag.add("/hot", definition), 10**9, bytes(16))
    (folder / "eventRules.txt").write_text("hot(X) <- my_robot__0__Heat(X, _).\nprint_trigger(hot/1).\n")
    assert main(["bag", str(tmp_path / "hot.bag"), "--program", str(folder)]) == 0
    assert "event(hot(0.0),[datime(1970,1,1,0,0,1,0),datime(1970,1,1,0,0,1,0)])\n" in capsys.readouterr().err


def test_single_rule_file_is_checked(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    rules = tmp_path / "rules.txt"
    rules.write_text("hot(T) <- warm(T) where T > 30.\nfire <- hot(_, _) seq smoke.\n")
    assert run_check(capsys, rules) == (
        0,
        f"warning: {rules}:2:9: no producer of hot/2: no topic, rule or goal; did you mean hot/1? [RT1201]\n"
        f"fire <- hot(_, _) seq smoke.\n        ^\n{rules}: no errors, 1 warning\n",
    )


def test_endless_goal_is_an_error(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "eventRules.txt").write_text(RULES + "forever :- forever.\n:- forever.\n")
    status, text = run_check(capsys, folder, "--max-seconds", "0.1")
    assert status == 1
    assert (
        f"{folder}/eventRules.txt:4:4: this directive raises an error: Not enough resources: seconds" in text
    )


def test_option_json_is_json_format(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    texts = [run_check(capsys, folder, *options)[1] for options in (["--json"], ["--format", "json"])]
    assert texts[0] == texts[1]
    assert json.loads(texts[0])["errors"] == 0


@pytest.mark.parametrize(
    ("topic", "message"),
    [
        ("/hto", "the bag has no topic hot; did you mean hto?"),
        ("/engine", "the bag has no topic hot; did you mean /engine?"),
        ("/hot", ""),
    ],
)
def test_topics_are_compared_with_bags(
    capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path, topic: str, message: str
) -> None:
    heat = Definitions().add("my_robot/Heat", "float64 heat\nfloat64 time")
    with BagWriter(tmp_path / "hot.bag") as bag:
        bag.write(bag.add(topic, heat), 1, bytes(16))
    status, printed = run_check(capsys, folder, "--bag", tmp_path / "hot.bag")
    assert [line for line in printed.split("\n") if "RT1101" in line] == (
        [f"warning: {folder}/pub_sub.xml:1:20: {message} [RT1101]"] if message else []
    )


def test_type_of_topic_is_compared_with_bags(
    capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path
) -> None:
    with BagWriter(tmp_path / "hot.bag") as bag:
        bag.write(bag.add("/hot", Definitions().add("my_robot/Cold", "float64 heat")), 1, bytes(8))
    assert (
        "topic hot is my_robot/Cold in the bag, not my_robot/Heat"
        in run_check(capsys, folder, "--bag", tmp_path / "hot.bag")[1]
    )


def test_rule_in_goal_file_is_reported(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt')\nhot(X) <- cold(X)\n")
    status, printed = run_check(capsys, folder)
    assert status == 1
    assert "goalPredicates.txt:2:1: this is a rule, not a goal: write it into a file" in printed


def test_spans_are_compared_with_rate_of_bags(
    capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path
) -> None:
    heat = Definitions().add("my_robot/Heat", "float64 heat\nfloat64 time")
    with BagWriter(tmp_path / "hot.bag") as bag:
        connection = bag.add("/hot", heat)
        for index in range(11):
            bag.write(connection, index * 10**8 + 1, bytes(16))
    rules = (
        "cold <- my_robot__0__Heat(_, _) seq absent(my_robot__0__Heat(_, _), 250).\nprint_trigger(cold/0).\n"
    )
    (folder / "eventRules.txt").write_text(rules)
    assert "RT1213" not in run_check(capsys, folder)[1]
    printed = run_check(capsys, folder, "--bag", tmp_path / "hot.bag")[1]
    assert (
        "250 is 4.17 minutes, because spans are in seconds; in the bag, a message of hot arrives every 0.1 s"
        in printed
    )


def test_missing_topic_file_has_similar_name(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "pub_sub.xml").rename(folder / "pubsub.xml")
    assert (
        "pub_sub.xml: No such file or directory; did you mean pubsub.xml? [RT1000]"
        in run_check(capsys, folder)[1]
    )


# ---- actions and services ----------------------------------------------------------------------------


@pytest.fixture
def docking(tmp_path: Path) -> Path:
    """Return the folder of a program that observes an action, beside a package with its type."""
    for folder, name in (("action", "Dock.action"), ("srv", "Go.srv")):
        path = tmp_path / "lab" / folder / name
        path.parent.mkdir(parents=True)
        path.write_text("---\n---\nfloat64 distance\n" if folder == "action" else "---\n")
    program = tmp_path / "docking"
    program.mkdir()
    (program / "goalPredicates.txt").write_text("compile_event_file('rules.txt')\n")
    return program


def check_docking(
    capsys: pytest.CaptureFixture[str], program: Path, element: str, rules: str, *options: Any
) -> List[str]:
    """Return the findings for a program with an element in ``pub_sub.xml``, except for heads without a consumer."""
    (program / "pub_sub.xml").write_text(f"<publish_subscribe>{element}</publish_subscribe>")
    (program / "rules.txt").write_text(rules)
    _, text = run_check(capsys, program, "--msg", program.parent / "lab", *options)
    findings = [line for line in text.splitlines() if line.startswith(("error", "warning"))]
    return [finding for finding in findings if "RT1202" not in finding]


ACTION = '<observe_action name="dock" action_type="{}" event="dock"/>'
FAR = "far(G) <- dock__feedback{goal_id: G, feedback: {distance: D}} where D > 5.\n"


def test_program_with_action_has_no_findings(capsys: pytest.CaptureFixture[str], docking: Path) -> None:
    rules = FAR + "near(D) <- dock__feedback(_, lab__0__Dock_Feedback(D)).\nsaid(S) <- dock__status(_, S).\n"
    assert check_docking(capsys, docking, ACTION.format("lab/action/Dock"), rules) == []


def test_misspelt_type_of_action_is_reported(capsys: pytest.CaptureFixture[str], docking: Path) -> None:
    rules = "docked(S) <- dock__status(_, S).\n"
    assert check_docking(capsys, docking, ACTION.format("lab/Dok"), rules) == [
        f"warning: {docking}/pub_sub.xml:1:20: there is no action type lab/Dok; did you mean lab/Dock? [RT1101]"
    ]
    element = '<observe_service name="go" srv_type="lab/Goo" event="go"/>'
    assert check_docking(capsys, docking, element, "went <- go(_, _, _).\n")[0] == (
        f"warning: {docking}/pub_sub.xml:1:20: there is no service type lab/Goo; did you mean lab/Go? [RT1101]"
    )


def test_misspelt_event_of_action_is_reported(capsys: pytest.CaptureFixture[str], docking: Path) -> None:
    (finding,) = check_docking(capsys, docking, ACTION.format("lab/Dock"), "far(G) <- dock__fedback(G, _).\n")
    assert "no producer of dock__fedback/2" in finding
    assert "did you mean dock__feedback/2?" in finding


def test_wrong_number_of_slots_of_action_is_reported(
    capsys: pytest.CaptureFixture[str], docking: Path
) -> None:
    (finding,) = check_docking(capsys, docking, ACTION.format("lab/Dock"), "docked(S) <- dock__status(S).\n")
    assert "lab/Dock__status has 2 slots: goal_id, status" in finding


def test_misspelt_status_of_action_is_reported(capsys: pytest.CaptureFixture[str], docking: Path) -> None:
    rules = (
        "begun(G) <- dock__status(G, '\"excuting\"').\n"
        "ended(G) <- dock__status{goal_id: G, status: '\"aborted\"'}.\n"
    )
    (finding,) = check_docking(capsys, docking, ACTION.format("lab/Dock"), rules)
    assert "status of lab/Dock__status is unknown or accepted or executing or" in finding
    assert "did you mean executing?" in finding


def test_action_is_compared_with_bags(
    capsys: pytest.CaptureFixture[str], docking: Path, tmp_path: Path
) -> None:
    goal = Definitions().find("actionlib_msgs/GoalID")
    for topic, expected in (
        ("/dok/cancel", ["the bag has no action dock; did you mean dok?"]),
        ("/dock/cancel", []),
        ("/other", []),
    ):
        path = tmp_path / "a.bag"
        with BagWriter(path) as bag:
            bag.write(bag.add(topic, goal), 1, bytes(12))
        findings = check_docking(capsys, docking, ACTION.format("lab/Dock"), FAR, "--bag", path)
        assert [text.split(": ", 2)[2].partition(" [")[0] for text in findings] == expected
        path.unlink()


def test_rules_are_explained_in_words(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "eventRules.txt").write_text(
        f"{RULES}quiet : silent <- hot(_) seq absent(hot(_), 5400). % retalis: ignore=RT1213\n"
        "print_trigger(silent).\n"
    )
    assert run_check(capsys, folder, "--explain") == (
        0,
        f"hot(X) ({folder}/eventRules.txt:1)\n`hot(X)` is emitted when\n"
        "- `my_robot__0__Heat(X, _)` ended before `hot(X)` started\n\n"
        f"quiet ({folder}/eventRules.txt:3)\n`silent` is emitted when\n"
        "- 1 h 30 min passed after `hot(_)` ended, with no `hot(_)` in between\n\n"
        f"{folder}: no errors, no warnings\n",
    )


def test_json_has_explained_rules(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    rules = tmp_path / "rules.txt"
    rules.write_text("p.\nnull do p <- (a or b) seq c.\n")
    status, text = run_check(capsys, rules, "--explain", "--json")
    assert status == 0
    assert json.loads(text)["rules"] == [
        {
            "rule": "do p",
            "file": str(rules),
            "line": 2,
            "text": "goal `p` is called when\n- P ended before `c` started\n  - P:\n    - `a` or `b` happened",
        }
    ]


def test_clause_with_error_has_no_reading(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    rules = tmp_path / "rules.txt"
    rules.write_text("a <- b c.\nd <- e.\n")
    status, text = run_check(capsys, rules, "--explain")
    assert status == 1
    assert text.startswith(f"d ({rules}:2)\n`d` is emitted when\n- `e` happened\n\nerror: {rules}:1:8: ")


def test_missing_file_has_no_readings(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    status, text = run_check(capsys, tmp_path / "none.txt", "--explain")
    assert status == 1
    assert "cannot read" in text


def test_incomplete_bag_is_a_warning(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    definitions = Definitions()
    with BagWriter(tmp_path / "a.bag") as bag:
        heat = bag.add("/hot", definitions.add("my_robot/Heat", "int8 x\nint8 y\n"))
        bag.write(heat, 1, bytes(2))
    content = (tmp_path / "a.bag").read_bytes()
    (tmp_path / "a.bag").write_bytes(content[:-20])
    assert main(["check", str(folder), "--bag", str(tmp_path / "a.bag")]) == 0
    captured = capsys.readouterr()
    assert captured.out == f"{folder}: no errors, no warnings\n"
    assert captured.err.startswith(f"warning: {tmp_path}/a.bag is incomplete: ")
