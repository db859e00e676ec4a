"""Command ``diff``: output, formats, revisions of git, and exit status."""

import json
import pickle
import subprocess
from pathlib import Path
from typing import Any, Callable, Iterator, List, Sequence, Tuple
from xml.etree import ElementTree

import pytest

from retalis import BagWriter, Definitions, functor
from retalis.cli.command_line import main
from retalis.cli.dask_cluster import ClusterError, ClusterOptions

TOPICS = '<publish_subscribe><subscribe_to name="heat" msg_type="std_msgs/Int8"/></publish_subscribe>'
GOALS = "compile_event_file('eventRules.txt')\nsubscribe(hot(_), [], _, alarms, a)\n"


def write_program(folder: Path, threshold: int) -> None:
    folder.mkdir(exist_ok=True)
    (folder / "pub_sub.xml").write_text(TOPICS)
    (folder / "goalPredicates.txt").write_text(GOALS)
    (folder / "eventRules.txt").write_text(f"hot(T) <- std_msgs__0__Int8(T) where T > {threshold}.\n")


def write_bag(path: Path, numbers: Sequence[int]) -> None:
    """Write a bag with numbers on topic ``heat``, one a second from 100 s on."""
    path.parent.mkdir(exist_ok=True)
    definitions = Definitions()
    definition = definitions.find("std_msgs/Int8")
    with BagWriter(path) as bag:
        connection = bag.add("/heat", definition)
        for time, number in enumerate(numbers, 100):
            message = functor("std_msgs__0__Int8", 1)(number)
            bag.write(connection, time * 10**9, definitions.encoder(definition).encode(message, "heat"))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working folder, with two versions of a program and two bags."""
    monkeypatch.chdir(tmp_path)
    write_program(tmp_path / "old", 40)
    write_program(tmp_path / "new", 42)
    write_bag(tmp_path / "bags" / "a.bag", (39, 41, 43))
    write_bag(tmp_path / "bags" / "b.bag", (39, 45))
    return tmp_path


@pytest.fixture
def git(folder: Path) -> Callable[..., None]:
    """Return a function that runs git in the working folder, which is a repository."""

    def run_git(*arguments: str) -> None:
        names = ("-c", "user.name=me", "-c", "user.email=me@example.org")
        subprocess.run(
            ["git", *names, *arguments], cwd=str(folder), check=True, capture_output=True, timeout=60
        )

    run_git("init")
    return run_git


def run_diff(capsys: pytest.CaptureFixture[str], *arguments: Any) -> Tuple[int, str, str]:
    """Return the exit status, the output, and the errors."""
    status = main(["diff", *map(str, arguments)])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_equal_versions_have_status_0(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    assert run_diff(capsys, "old", "old", "bags", "--full") == (0, "2 bags: 3 equal outputs\n", "")
    rules = (folder / "old" / "eventRules.txt").read_text()
    write_program(folder / "new", 40)
    (folder / "new" / "eventRules.txt").write_text("% A comment.\n" + rules.replace(" where", "\n    where"))
    # No bag is opened.
    (folder / "bags" / "c.bag").write_bytes(b"no bag")
    expected = "3 bags: 3 not read (the programs are equal)\n"
    assert run_diff(capsys, "old", "new", "bags") == (0, expected, "")


def test_rules_that_cannot_differ_are_not_run(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    for version, threshold in (("old", 10), ("new", 40)):
        with (folder / version / "goalPredicates.txt").open("a") as goals:
            goals.write("subscribe(cold(_), [], _, notes, n)\n")
        with (folder / version / "eventRules.txt").open("a") as rules:
            rules.write(f"cold(T) <- std_msgs__0__Int8(T) where T < {threshold}.\n")
    write_rules = (folder / "old" / "eventRules.txt").read_text().replace("T > 40", "T > 42")
    (folder / "old" / "eventRules.txt").write_text(write_rules)
    status, text, _ = run_diff(capsys, "old", "new", "bags/a.bag")
    assert status == 1
    # Output `hot(43)` of the other rule is not counted.
    assert text.splitlines()[-1] == (
        "1 bag: 0 equal outputs, 1 gained, 1 run in part (the other rules cannot differ)"
    )
    assert run_diff(capsys, "old", "new", "bags/a.bag", "--full")[1].endswith(
        "1 bag: 1 equal output, 1 gained\n"
    )


def test_bag_without_needed_events_is_not_read(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    with (folder / "new" / "eventRules.txt").open("a") as rules:
        rules.write("cold(T) <- other(T).\n")
    (folder / "old" / "eventRules.txt").write_text("hot(T) <- std_msgs__0__Int8(T) where T > 42.\n")
    expected = "2 bags: 2 not read (no event for the rules that differ)\n"
    assert run_diff(capsys, "old", "new", "bags") == (0, expected, "")


def test_lost_output_has_reasons_of_both_versions(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    status, text, _ = run_diff(capsys, "old", "new", "bags", "-j", 2)
    assert status == 1
    lines = text.splitlines()
    assert lines[:3] == ["bags/a.bag", "  lost    1.000 s  alarms  hot(41)", "      old:"]
    assert lines[-1] == "2 bags: 2 equal outputs, 1 lost"
    reasons = text.partition("new:")
    assert "hot(41) at 1 s by rule hot(T) <-" in reasons[0]
    assert "- where 41 > 42" in reasons[2]


def test_json_has_one_object_for_each_change(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    status, text, _ = run_diff(capsys, "new", "old", "bags/a.bag", "--json")
    assert status == 1
    record = json.loads(text)
    assert record.pop("because")[0] == "old:"
    assert record == {
        "change": "gained",
        "bag": "bags/a.bag",
        "old": None,
        "new": {"time": 101 * 10**9, "topic": "alarms", "term": "hot(41)"},
    }


def test_junit_has_a_case_for_each_bag(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    run_diff(capsys, "old", "new", "bags", "--junit", "changes.xml")
    suite = ElementTree.parse(folder / "changes.xml").getroot()
    assert (suite.get("tests"), suite.get("failures")) == ("2", "1")
    assert [(case.get("name"), len(case)) for case in suite] == [("bags/a.bag", 1), ("bags/b.bag", 0)]


def test_revision_of_git_is_old_version(
    capsys: pytest.CaptureFixture[str], folder: Path, git: Callable[..., None]
) -> None:
    git("add", "old")
    git("commit", "-m", "first")
    write_program(folder / "old", 42)
    status, text, _ = run_diff(capsys, "--git", "HEAD", "old", "bags/a.bag")
    assert status == 1
    assert text.splitlines()[1] == "  lost    1.000 s  alarms  hot(41)"
    for revision in ("nowhere", "", "--output=made"):
        status, _, error = run_diff(capsys, f"--git={revision}", "old", "bags/a.bag")
        assert status == 1
        assert error == f"retalis: --git {revision}: unknown revision: expected a commit, branch or tag\n"
    assert not list(folder.rglob("made"))
    status, _, error = run_diff(capsys, "--git", "HEAD", "new", "bags/a.bag")
    assert status == 1
    assert error == "retalis: --git HEAD: has no folder new: expected a revision with the program\n"


def test_revision_has_files_of_other_folders(
    capsys: pytest.CaptureFixture[str], folder: Path, git: Callable[..., None]
) -> None:
    (folder / "common").mkdir()
    (folder / "old" / "eventRules.txt").rename(folder / "common" / "rules.txt")
    (folder / "old" / "eventRules.txt").symlink_to("../common/rules.txt")
    git("add", "old", "common")
    git("commit", "-m", "first")
    equal = (0, "1 bag: 1 not read (the programs are equal)\n", "")
    assert run_diff(capsys, "--git", "HEAD", "old", "bags/a.bag") == equal
    (folder / "old" / "goalPredicates.txt").write_text(GOALS.replace("eventRules", "../common/rules"))
    git("commit", "-a", "-m", "second")
    assert run_diff(capsys, "--git", "HEAD", "old", "bags/a.bag") == equal


def test_errors_name_files_of_the_revision(
    capsys: pytest.CaptureFixture[str], folder: Path, git: Callable[..., None]
) -> None:
    (folder / "new" / "eventRules.txt").write_text("hot(T) <- .\n")
    git("add", "new")
    git("commit", "-m", "first")
    write_program(folder / "new", 42)
    status, _, error = run_diff(capsys, "--git", "HEAD", "new", "bags/a.bag", "--junit", "changes.xml")
    assert status == 1
    assert "HEAD:new/eventRules.txt:1:11" in error
    assert "retalis-" not in error
    (failure,) = ElementTree.parse(folder / "changes.xml").getroot().iter("failure")
    assert "HEAD:new/eventRules.txt:1:11" in str(failure.get("message"))
    assert "\n" not in str(failure.get("message"))
    assert "\n" in str(failure.text)


def test_outputs_far_apart_have_not_moved(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    rules = "hot(T) <- std_msgs__0__Int8(T) where T > {}.\n"
    write_bag(folder / "c.bag", (41, 0, 0, 41))
    for version, counted in (("old", 1), ("new", 2)):
        (folder / version / "goalPredicates.txt").write_text(GOALS + "assert(seen(0))\n")
        (folder / version / "eventRules.txt").write_text(
            f"{rules.format(99)}hot(x) <- std_msgs__0__Int8(41)"
            f" where (retract(seen(N)), M is N + 1, assert(seen(M)), M =:= {counted}).\n"
        )
    assert run_diff(capsys, "old", "new", "c.bag")[1].endswith("1 bag: 0 equal outputs, 1 moved\n")
    text = run_diff(capsys, "old", "new", "c.bag", "--moved-within", 2.9)[1]
    assert text.endswith("1 bag: 0 equal outputs, 1 lost, 1 gained\n")


def test_errors_have_status_1(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "bags" / "c.bag").write_bytes(b"no bag")
    status, text, error = run_diff(capsys, "old", "old", "bags", "--full")
    assert status == 1
    assert text == "3 bags: 3 equal outputs, 1 bag failed\n"
    assert error.startswith("error: bags/c.bag")
    (folder / "new" / "eventRules.txt").write_text("hot(T) <- .\n")
    status, _, error = run_diff(capsys, "old", "new", "bags/a.bag")
    assert status == 1
    assert "new/eventRules.txt:1:11" in error


def test_bag_at_url_is_downloaded(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    pytest.importorskip("fsspec")
    status, text, error = run_diff(capsys, "old", "old", f"file://{folder}/bags/a.bag", "--full")
    assert (status, text, error) == (0, "1 bag: 2 equal outputs\n", "")
    (folder / "bags" / "c.bag").write_bytes(b"no bag")
    status, _, error = run_diff(capsys, "old", "new", f"file://{folder}/bags/c.bag")
    assert status == 1
    assert error.startswith(f"error: file://{folder}/bags/c.bag")


def test_cluster_compares_bags(
    capsys: pytest.CaptureFixture[str], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tasks: List[Any] = []

    def run_here(
        function: Any, sent: Sequence[Any], cluster: ClusterOptions, listener: Any
    ) -> Iterator[Tuple[int, Any]]:
        """Run the tasks in this process: `run_on_cluster` is tested with real workers."""
        assert cluster.address == "tcp://here:1"
        tasks.extend(pickle.loads(pickle.dumps(list(sent))))
        monkeypatch.chdir("/")
        yield from ((number, function(task, str(folder))) for number, task in enumerate(tasks))

    monkeypatch.setattr("retalis.cli.diff_command.run_on_cluster", run_here)
    status, text, error = run_diff(capsys, "old", "new", "bags", "--scheduler", "tcp://here:1")
    assert (status, error) == (1, "")
    assert text.endswith("2 bags: 2 equal outputs, 1 lost\n")
    assert [Path(task.bag) for task in tasks] == [folder / "bags" / "a.bag", folder / "bags" / "b.bag"]


def test_lost_cluster_is_one_line(
    capsys: pytest.CaptureFixture[str], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lose(function: Any, sent: Sequence[Any], cluster: Any, listener: Any) -> Iterator[Tuple[int, Any]]:
        yield 1, function(sent[1], str(folder))
        raise ClusterError("the scheduler is lost")

    monkeypatch.setattr("retalis.cli.diff_command.run_on_cluster", lose)
    status, text, error = run_diff(capsys, "old", "new", "bags", "--scheduler", "tcp://here:1")
    assert (status, error) == (1, "error: the scheduler is lost\n")
    assert "1 bag failed" in text


def test_wrong_use_is_reported(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    with pytest.raises(SystemExit) as raised:
        main(["diff", "old", "new"])
    assert raised.value.code == 2
    assert "expected OLD NEW BAG..." in capsys.readouterr().err
    for option, value in (("--jobs", "2"), ("--git", "HEAD")):
        with pytest.raises(SystemExit):
            main(["diff", "old", "new", "bags", "--scheduler", "tcp://here:1", option, value])
        assert f"{option}" in capsys.readouterr().err
    status, _, error = run_diff(capsys, "nowhere", "new", "bags")
    assert (status, error) == (1, "retalis: nowhere is not a folder: expected the folder of a program\n")


def test_incomplete_bag_has_status_3(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    path = folder / "bags" / "b.bag"
    path.write_bytes(path.read_bytes()[:-100])
    status, text, errors = run_diff(capsys, "old", "old", "bags", "--full", "--junit", "changes.xml")
    assert (status, text) == (3, "2 bags: 3 equal outputs, 1 bag incomplete\n")
    assert errors.startswith("warning: bags/b.bag is incomplete: its index is cut or damaged at byte ")
    suite = ElementTree.parse(folder / "changes.xml").getroot()
    assert suite.get("failures") == "0"
    assert [case.findtext("system-out") for case in suite] == [None, errors.rstrip("\n")]
    status, text, _ = run_diff(capsys, "old", "new", "bags/b.bag", "--json")
    assert json.loads(text)["incomplete"] == "bags/b.bag"
    status, _, errors = run_diff(capsys, "old", "new", "bags/b.bag", "--strict")
    assert (status, errors[:34]) == (1, "error: bags/b.bag is incomplete: i")
