"""Command ``events``: a program over a stream of events."""

import io
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, Dict, List, Tuple

import pytest
from asserting_accessors import required
from subprocess_python_path import python_path
from subprocess_timeouts import running

from retalis import Engine
from retalis.cli.command_line import main
from retalis.cli.event_stream_command import has_unread_input
from retalis.events.rules.event_input_predicates import event_of
from retalis.prolog.syntax.term_reader import read_term

ROOT = Path(__file__).resolve().parents[2]
RULES = "alarm(X) <- smoke(X) seq heat(X) where X \\= lab.\n"


def test_events_are_printed_in_order_of_dispatch(run_events: Any) -> None:
    stream = "event(smoke(a),[1,2]).\nevent(heat(a),[3,4.5]).\n"
    assert run_events(rules=RULES, stream=stream) == (
        0,
        ["event(smoke(a),[1,2]).", "event(heat(a),[3,4.5]).", "event(alarm(a),[1,4.5])."],
        "",
    )


def test_growth_of_heap_is_checked_for_each_event(run_events: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    checks: List[bool] = []
    monkeypatch.setattr("retalis.cli.event_stream_command.collect_if_grown", lambda: checks.append(True))
    run_events(rules="a <- b.", stream="event(b, [1, 1]).\nevent(b, [2, 2]).\n")
    assert len(checks) == 2


def test_printed_events_can_be_read_again(run_events: Any) -> None:
    stream = "event('A b'(\"s\",[x|T],'it''s',-1,- 1,a+b*c,{q},T,U),[1,1]).\n"
    status, lines, _ = run_events(stream=stream)
    assert (status, len(lines)) == (0, 1)
    assert run_events(stream="\n".join(lines)) == (0, lines, "")


def test_event_with_strings_and_variables_is_read(run_events: Any) -> None:
    rules = 'yes(1) <- a("text",inf) . yes(2) <- a("text",X) where var(X).\n'
    for stream in ('event(a("text",inf),[1,1]).\n', 'event(a("text",inf),[1,1]). true.\n'):
        assert run_events(rules=rules, stream=stream)[1] == [
            'event(a("text",inf),[1,1]).',
            "event(yes(1),[1,1]).",
        ]
    assert run_events(rules=rules, stream='event(a("text",True),[1,1]).')[1][0] == 'event(a("text",A),[1,1]).'


def test_stamps_keep_their_form(run_events: Any) -> None:
    stream = "event(a,[datime(2001,1,1,0,0,0,5),datime(2001,1,1,0,0,1.0,0)]).\nevent(b,[datime(2001,1,1,0,0,2),3e9])."
    assert run_events(stream=stream)[1] == [
        "event(a,[datime(2001,1,1,0,0,0,5),datime(2001,1,1,0,0,1.0,0)]).",
        "event(b,[datime(2001,1,1,0,0,2),3000000000.0]).",
    ]


def test_goals_precede_rules_and_stream(run_events: Any) -> None:
    goals = "set_etalis_flag(event_consumption_policy,unrestricted)\nassert(hot(a))\n"
    rules = "alarm(X) <- smoke(X) seq heat(X) where hot(X).\n"
    stream = "event(smoke(a),[1,1]). event(heat(a),[2,2]). event(heat(a),[3,3]).\n"
    assert run_events(goals=goals, rules=rules, stream=stream)[1][-1] == "event(alarm(a),[1,3])."


def test_other_terms_of_stream_are_goals(run_events: Any) -> None:
    stream = "assert(hot(a)).\nevent(go,[1,1]).\nwrite(hello), nl.\n"
    assert run_events(rules=":- dynamic(hot/1).\nyes <- go where hot(a).\n", stream=stream) == (
        0,
        ["event(go,[1,1]).", "event(yes,[1,1]).", "hello"],
        "",
    )


def test_goals_may_be_directives(run_events: Any) -> None:
    stream = ":- assertz(f(1)).\n?- assertz(f(2)).\n"
    assert run_events(goals=":- assertz(f(0)).", stream=stream, queries=":- f(X).\n?- f(2).") == (
        0,
        ["f(0).", "f(1).", "f(2).", "f(2)."],
        "",
    )


@pytest.mark.parametrize("time", ["-1", "x", "_", "inf"])
def test_invalid_sleep_is_an_error(run_events: Any, time: str) -> None:
    status, _, error = run_events(stream=f"sleep({time}).\n")
    assert status == 1
    assert "stream.txt:1:1: sleep/1: expected a number of seconds" in error


def test_outputs_are_written_to_file(run_events: Any, tmp_path: Path) -> None:
    goals = "subscribe(alarm(X),[],at(X),topic,'my id')"
    stream = "event(smoke(a),[1,1]). event(heat(a),[2,2])."
    status, lines, _ = run_events(goals=goals, rules=RULES, stream=stream, outputs=None)
    assert (status, len(lines)) == (0, 3)
    assert (tmp_path / "outputs.out").read_text() == "output(at(a),topic,'my id').\n"


def test_outputs_can_be_printed(run_events: Any) -> None:
    goals = "subscribe(alarm(X),[],at(X),topic,i)"
    stream = "event(smoke(a),[1,1]). event(heat(a),[2,2])."
    assert (
        "output(at(a),topic,i)." in run_events("--outputs", "-", goals=goals, rules=RULES, stream=stream)[1]
    )


MEMORY = "memorize(a(X),[],X,m,2)"


def test_memory_events_are_printed_on_request_only(run_events: Any) -> None:
    assert run_events(goals=MEMORY, stream="event(a(1),[1,1]).")[1] == ["event(a(1),[1,1])."]
    lines = run_events("--memory-events", goals=MEMORY, stream="event(a(1),[1,1]).")[1]
    assert [line.partition("(")[0] for line in lines] == ["memory_event", "event", "memory_event"]
    assert lines[2].startswith("memory_event(memory_updated(m,1),[")


def test_queries_print_their_solutions(run_events: Any) -> None:
    queries = "member(X,[1,2])\naccess_mem(m,X,[T1,T2]).\nfail\n"
    status, lines, _ = run_events(goals=MEMORY, stream="event(a(q),[1,2]).", queries=queries)
    assert status == 0
    assert lines == ["event(a(q),[1,2]).", "member(1,[1,2]).", "member(2,[1,2]).", "access_mem(m,q,[1,2])."]


def test_error_in_query_does_not_stop_others(run_events: Any) -> None:
    status, lines, error = run_events(queries="member(X,[1])\nunknown_one(1)\nmember(X,[2])\n")
    assert status == 1
    assert lines == ["member(1,[1]).", "member(2,[2])."]
    assert "queries.txt:2:1" in error


# ---- time -----------------------------------------------------------------------------------------------


def test_clock_follows_stream(run_events: Any) -> None:
    stream = "event(a,[10,10]).\nevent(b).\nsleep(2.5).\nevent(c).\n"
    lines = run_events(stream=stream)[1]
    assert lines[1:] == ["event(b,[10,10]).", "event(c,[12.5,12.5])."]


@pytest.mark.parametrize(
    ("start", "end"),
    [("1", "6"), ("1.5", "6.5"), ("datime(2026,1,1,0,0,1,0)", "datime(2026,1,1,0,0,6,0)")],
)
def test_clock_times_have_form_of_stream(run_events: Any, start: str, end: str) -> None:
    stream = f"event(beat,[{start},{start}]).\nsleep(9).\n"
    lines = run_events("--explain", "lost", rules="lost <- beat seq absent(beat, 5).\n", stream=stream)[1]
    assert lines[1] == f"event(lost,[{start},{end}])."
    assert lines[3].startswith(f"%   lost [{start},{end}] by rule")


def test_sleep_lets_alarms_fire(run_events: Any) -> None:
    rules = "exceptionAlarm(late,5) <- start.\n"
    assert run_events(rules=rules, stream="event(start,[1,1]).\nsleep(4).\n")[1] == ["event(start,[1,1])."]
    lines = run_events(rules=rules, stream="event(start,[1,1]).\nsleep(4).\nsleep(1).\n")[1]
    assert lines[1].startswith("event(late,[1,")


def test_due_alarms_fire_before_event(run_events: Any) -> None:
    lines = run_events(
        rules="exceptionAlarm(late,5) <- start.\n", stream="event(start,[1,1]).\nevent(x,[20,20]).\n"
    )[1]
    assert [line[: line.index(",")] for line in lines] == ["event(start", "event(late", "event(x"]


def test_pinned_clock_is_constant(run_events: Any) -> None:
    stream = "event(a).\nevent(x,[datime(2005,1,1,0,0,0,0),datime(2005,1,1,0,0,0,0)]).\nevent(b).\n"
    lines = run_events("--clock", "datime(2001,1,1,0,0,0,0)", stream=stream)[1]
    assert lines[0] == "event(a,[datime(2001,1,1,0,0,0,1),datime(2001,1,1,0,0,0,1)])."
    assert lines[2] == "event(b,[datime(2001,1,1,0,0,0,2),datime(2001,1,1,0,0,0,2)])."


def test_invalid_clock_is_an_error(run_events: Any) -> None:
    status, _, error = run_events("--clock", "monday", stream="event(a).")
    assert status == 1
    assert "--clock monday: expected datime" in error


# ---- errors ---------------------------------------------------------------------------------------------


def test_rule_file_with_errors_is_not_active(run_events: Any) -> None:
    rules = "a <- b ntimes zero.\nc <- (d.\ne <- f.\ng <- h cnott i.\n"
    status, lines, error = run_events(rules=rules, stream="event(f,[1,1]).")
    assert (status, lines) == (1, ["event(f,[1,1])."])
    assert error.count("error: ") == 3
    for line in (1, 2, 4):
        assert f"rules.txt:{line}:" in error
    assert "^" in error


@pytest.mark.parametrize(
    ("text", "position"),
    [
        ("event(a,[2,1]).", "2:1"),
        ("event(X).", "2:1"),
        ("event(3).", "2:1"),
        ("event(a,[x,y]).", "2:1"),
        ("event(a, .", "2:10"),
        ("no_such_goal.", "2:1"),
        ("fail.", "2:1"),
        ("event(a,[1,1])", "4:1"),
    ],
)
def test_error_in_stream_does_not_stop_others(run_events: Any, text: str, position: str) -> None:
    status, lines, error = run_events(stream=f"event(before,[1,1]).\n{text}\n\nevent(after,[1,1]).\n")
    assert (status, lines) == (1, ["event(before,[1,1]).", "event(after,[1,1])."])
    assert f"stream.txt:{position}" in error


def test_event_unlike_declaration_is_refused(run_events: Any) -> None:
    rules = ":- event smoke(room:atom).\n" + RULES.replace("seq heat(X) ", "")
    status, lines, error = run_events(
        rules=rules, stream="event(smoke(a),[1,1]).\nevent(smoke(7),[2,2]).\nevent(smoke,[3,3]).\n"
    )
    assert (status, lines) == (1, ["event(smoke(a),[1,1]).", "event(alarm(a),[1,1])."])
    assert (
        "stream.txt:2:1: event refused: room of smoke/1 is an atom, found 7; declared as smoke(room:atom)"
        in error
    )
    assert (
        "stream.txt:3:1: event refused: smoke/0 does not match its declaration: smoke(room:atom) has 1 argument"
        in error
    )


def test_error_in_condition_is_reported(run_events: Any) -> None:
    rules = "x <- a where 1 < foo.\ny <- a.\n"
    status, lines, error = run_events(rules=rules, stream="event(a,[1,1]).")
    assert (status, lines) == (1, ["event(a,[1,1]).", "event(y,[1,1])."])
    assert "rules.txt:1" in error


def test_failed_goal_is_an_error_with_position(run_events: Any) -> None:
    status, lines, error = run_events(goals="true\nfail\n", stream="event(a,[1,1]).")
    assert (status, lines) == (1, ["event(a,[1,1])."])
    assert "goals.txt:2:1" in error


def test_missing_files_are_errors(
    run_events: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    missing, output = tmp_path / "no.txt", tmp_path / "no" / "no.txt"
    assert main(["events", "--rules", str(missing)]) == 1
    assert main(["events", "--stream", str(missing)]) == 1
    assert main(["events", "--stream", os.devnull, "--outputs", str(output)]) == 1
    assert capsys.readouterr().err.splitlines() == [
        f"retalis: cannot read {missing}: No such file or directory",
        f"retalis: cannot read {missing}: No such file or directory",
        f"retalis: cannot write {output}: No such file or directory",
    ]


def test_stream_in_other_encoding_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stream = tmp_path / "stream.txt"
    stream.write_bytes(b"event(a,[1,1]).\n\xff\xfe\n")
    assert main(["events", "--stream", str(stream)]) == 1
    assert "UTF-8" in capsys.readouterr().err


# ---- JSON -----------------------------------------------------------------------------------------------


def test_json_has_object_per_record(run_events: Any, tmp_path: Path) -> None:
    goals = MEMORY + "\nsubscribe(a(X),[],X,t,i)\n"
    status, lines, _ = run_events(
        "--json",
        "--memory-events",
        "--explain",
        "a(_)",
        goals=goals,
        stream="event(a('X y'),[1,2]). event(b,[datime(1970,1,1,0,0,2,5),2.5]).",
        queries="access_mem(m,X,_)\n",
        outputs=None,
    )
    assert status == 0
    objects = [json.loads(line) for line in lines]
    assert objects[1] == {"event": "a('X y')", "start": 1_000_000_000, "end": 2_000_000_000}
    assert objects[2]["memory_event"] == "memory_updated(m,2)"
    assert objects[3] == {"event": "b", "start": 2_000_000_005, "end": 2_500_000_000}
    assert objects[4] == {"query": "access_mem(m,A,B)", "solutions": ["access_mem(m,'X y',[1,2])"]}
    assert objects[5] == {
        "explain": "a(A)",
        "happened": True,
        "because": [{"text": "a('X y') [1,2] came from outside", "below": []}],
    }
    output = {"output": "'X y'", "topic": "t", "id": "i", "time": 2_000_000_000}
    assert json.loads((tmp_path / "outputs.out").read_text()) == output


# ---- standard input -------------------------------------------------------------------------------------


def test_term_may_span_several_lines(run_events: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "/* dots. in\n a comment. */ event(a,\n [1,\n  1]). event(b,[2,2]). event('c.\\\nd'\n,[3,3]).\n"
    monkeypatch.setattr("sys.stdin", io.StringIO(text))
    assert run_events("--stream", "-") == (
        0,
        ["event(a,[1,1]).", "event(b,[2,2]).", "event('c.d',[3,3])."],
        "",
    )


def test_event_is_printed_before_next_line(tmp_path: Path) -> None:
    rules = tmp_path / "rules.txt"
    rules.write_text("pong(X) <- ping(X).\n")
    command = [sys.executable, "-m", "retalis", "events", "--rules", str(rules), "--stream", "-"]
    with running(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={"PYTHONPATH": python_path(), "PATH": "/usr/bin:/bin"},
        bufsize=0,
    ) as child:
        for number in (1, 2):
            required(child.stdin).write(f"event(ping({number}),[{number},{number}]).\n".encode())
            assert required(child.stdout).readline().startswith(b"event(ping")
            assert (
                required(child.stdout).readline() == f"event(pong({number}),[{number},{number}]).\n".encode()
            )
        required(child.stdin).close()
        assert child.wait(30) == 0


def test_closed_reader_ends_command_silently(tmp_path: Path) -> None:
    stream = tmp_path / "stream.txt"
    stream.write_text("".join(f"event(a({number}),[{number},{number}]).\n" for number in range(20000)))
    with running(
        [sys.executable, "-m", "retalis", "events", "--stream", str(stream)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={"PYTHONPATH": python_path(), "PATH": "/usr/bin:/bin"},
    ) as child:
        assert required(child.stdout).readline() == b"event(a(0),[0,0]).\n"
        required(child.stdout).close()
        assert required(child.stderr).read() == b""
        assert child.wait(30) == 1


def test_missing_options_are_a_usage_error(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as raised:
        main(["events", "--json"])
    assert raised.value.code == 2
    assert "nothing to do: give --rules, --goals, --stream, --queries or --explain" in capsys.readouterr().err


def test_stream_goals_open_files_of_allowed_folders(
    run_events: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("here", "data", "out", "program"):
        (tmp_path / name).mkdir()
    monkeypatch.chdir(tmp_path / "here")
    (tmp_path / "program" / "rules.txt").write_text("persistent_event(a).")
    (tmp_path / "program" / "more.pl").write_text("p(1).")
    (tmp_path / "data" / "more.pl").write_text("p(2).")
    stream = "consult(more).\nconsult('../data/more').\nevent(a,[1,1]).\n"
    rules = ("--rules", str(tmp_path / "program" / "rules.txt"))
    status, lines, errors = run_events(*rules, stream=stream, queries="p(X)\n")
    assert (status, lines) == (1, ["event(a,[1,1]).", "p(1)."])
    assert "stream.txt:2:1: No permission to open source_sink" in errors
    assert "persistent events could not be written" in errors
    folders = ("--folder", str(tmp_path / "data"), "--write-folder", str(tmp_path / "out"))
    status, lines, errors = run_events(*rules, *folders, stream=stream, queries="p(X)\n")
    assert (status, lines, errors) == (0, ["event(a,[1,1]).", "p(1).", "p(2)."], "")
    assert (tmp_path / "out" / "persistent.txt").read_text() == "event(a,[1,1]).\n"
    assert list((tmp_path / "here").iterdir()) == []


def test_unread_input_is_detected_without_blocking(tmp_path: Path) -> None:
    reading, writing = os.pipe()
    assert not has_unread_input(reading)
    os.write(writing, b"event(a).\n")
    assert has_unread_input(reading)
    os.read(reading, 100)
    os.close(writing)
    assert not has_unread_input(reading)
    os.close(reading)
    assert not has_unread_input(reading)
    with open(os.devnull, "rb") as empty:
        assert not has_unread_input(empty.fileno())
    path = tmp_path / "events.txt"
    path.write_text("event(a).\n")
    with open(path, "rb") as file:
        assert has_unread_input(file.fileno())
        os.lseek(file.fileno(), 0, os.SEEK_END)
        assert not has_unread_input(file.fileno())


@pytest.mark.parametrize(("options", "is_warned"), [((), True), (("--stream", "-"), False)])
def test_unread_standard_input_is_warned_of(
    tmp_path: Path, options: Tuple[Any, ...], is_warned: bool
) -> None:
    rules = tmp_path / "rules.txt"
    rules.write_text(RULES)
    process = subprocess.run(
        [sys.executable, "-m", "retalis", "events", "--rules", str(rules), *options],
        input="event(smoke(a),[1,2]).\n",
        env={**os.environ, "PYTHONPATH": python_path()},
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert ("standard input was not read; --stream -" in process.stderr) is is_warned
    assert process.stdout == ("" if is_warned else "event(smoke(a),[1,2]).\n")


def test_error_while_stream_is_read_names_stream(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    outputs = tmp_path / "outputs.txt"
    outputs.write_text("former outputs\n")
    # The first page of a process is not mapped, so reading it is an error.
    assert main(["events", "-s", "/proc/self/mem", "-o", str(outputs)]) == 1
    assert capsys.readouterr().err == "retalis: cannot read /proc/self/mem: Input/output error\n"
    assert outputs.read_text() == "former outputs\n"


def test_missing_rule_file_ends_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stream = tmp_path / "stream.txt"
    stream.write_text("event(smoke(a),[1,1]).\n")
    assert main(["events", "-r", str(tmp_path / "none.txt"), "-s", str(stream)]) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == f"retalis: cannot read {tmp_path}/none.txt: No such file or directory\n"


def test_decreasing_stamps_are_reported_once(run_events: Any) -> None:
    stream = "event(a(1),[50,50]).\nevent(a(2),[39,39]).\nevent(a(3),[60,60]).\nevent(a(4),[10,49]).\n"
    status, lines, errors = run_events(stream=stream)
    assert (status, len(lines)) == (0, 4)
    assert "stream.txt:2:1: the stream goes back in time here: " in errors
    assert errors.count("goes back in time here") == 2
    assert "2 times in all" in errors


@pytest.mark.parametrize(
    "stream",
    [
        "event(a,[15,15]).\nevent(b,[15,15]).\n",
        "event(a,[15,15]).\nevent(b,[5,5]).\n",
        "event(a).\nevent(b).\n",
    ],
)
def test_usual_order_of_stamps_is_not_reported(run_events: Any, stream: str) -> None:
    assert run_events(stream=stream)[2] == ""


def test_all_output_has_relative_times(run_events: Any) -> None:
    stream = "event(smoke(a),[100,100]).\nevent(heat(a),[102,103.5]).\nevent(late,[99,100.5]).\n"
    lines = run_events("--times", "relative", "--explain", "alarm(a)", rules=RULES, stream=stream)[1]
    assert lines[:4] == [
        "event(smoke(a),[0.0,0.0]).",
        "event(heat(a),[2.0,3.5]).",
        "event(alarm(a),[0.0,3.5]).",
        "event(late,[0.0,0.5]).",  # begins before the start of the run
    ]
    assert "% alarm(a) happened" in lines
    assert not any("100" in line for line in lines)
    records = map(json.loads, run_events("--times", "relative", "--json", rules=RULES, stream=stream)[1])
    times = [(record["start"], record["end"]) for record in records]
    assert times == [(0, 0), (2 * 10**9, 35 * 10**8), (0, 35 * 10**8), (0, 5 * 10**8)]


def test_absent_event_with_similar_name_is_reported(run_events: Any) -> None:
    *_, errors = run_events(rules="hot(M) <- tmep(M, _).", stream="event(temp(a, 40), [1, 1]).")
    assert "no event tmep/2 occurred; did you mean temp/2? [RT1201]" in errors


def test_absent_event_of_other_name_is_ignored(run_events: Any) -> None:
    rules = "hot(M) <- temp(M, _). hotter(M) <- temps(M, _)."
    assert run_events(rules=rules, stream="event(temp(a, 40), [1, 1]).")[2] == ""


OPEN_RULES = ":- state(docked(R), from(dock(R)), until(undock(R))).\nlost <- dock(_) seq absent(beat, 5).\n"
OPEN_STREAM = "event(dock(a), [10, 10]).\nevent(dock(b), [12, 12]).\n"


def test_flush_advances_clock_after_stream(run_events: Any) -> None:
    assert not any("lost" in line for line in run_events(rules=OPEN_RULES, stream=OPEN_STREAM)[1])
    for seconds, count in (("4", 1), ("5", 2)):
        lines = run_events("--flush", seconds, rules=OPEN_RULES, stream=OPEN_STREAM)[1]
        assert sum(line.startswith("event(lost,") for line in lines) == count, lines


def test_open_states_are_printed_at_end(run_events: Any) -> None:
    lines = run_events("--open", rules=OPEN_RULES, stream=OPEN_STREAM)[1]
    assert lines[-2:] == ["% docked(a) is open since 10", "% docked(b) is open since 12"]
    lines = run_events("--open", "--times=relative", rules=OPEN_RULES, stream=OPEN_STREAM)[1]
    assert lines[-1] == "% docked(b) is open since 2.0"
    lines = run_events("--open", "--json", rules=OPEN_RULES, stream=OPEN_STREAM)[1]
    assert lines[-1] == '{"open": "docked(b)", "start": 12000000000}'


def test_relative_times_are_rounded_once(run_events: Any) -> None:
    stream = "event(a, [1.0, 1.0]).\nevent(b, [1.013, 1.097]).\n"
    lines = run_events("--times=relative", rules="c <- a.\n", stream=stream)[1]
    assert lines == ["event(a,[0.0,0.0]).", "event(c,[0.0,0.0]).", "event(b,[0.013,0.097])."]


OPEN_WINDOW_RULES = """\
by_time(R, N) <- aggregate(count, task(R), N, every(10)).
by_first(N) <- aggregate(count, task(_), N, every(30, first)).
by_count(R, N) <- aggregate(count, task(R), N, every(2, events)).
sum(N) <- aggregate(count, task(_), N, running(every(10))).
hopping(N) <- aggregate(count, task(_), N, last(20, every(5))).
sliding(N) <- aggregate(count, task(_), N, last(20)).
by_pause(R, N) <- aggregate(count, task(R), N, session(3, max(60))).
null do true <- aggregate(count, task(_), _, every(7, events)).
"""
OPEN_WINDOW_STREAM = """\
event(task(a), [datime(2026,1,1,0,0,11,0), datime(2026,1,1,0,0,11,0)]).
event(task(b), [datime(2026,1,1,0,0,12,0), datime(2026,1,1,0,0,12,0)]).
event(task(a), [datime(2026,1,1,0,0,14,0), datime(2026,1,1,0,0,14,0)]).
"""


def test_open_windows_are_printed_at_end(run_events: Any) -> None:
    lines = run_events("--open", rules=OPEN_WINDOW_RULES, stream=OPEN_WINDOW_STREAM)[1]
    since = "is open since datime(2026,1,1,0,0"
    assert [line for line in lines if line.startswith("%")] == [
        f"% window every(10) of by_time(R,N) for R = a {since},10,0), with 2 elements",
        f"% window every(10) of by_time(R,N) for R = b {since},10,0), with 1 element",
        f"% window every(30,first) of by_first(N) {since},11,0), with 3 elements",
        f"% window every(2,events) of by_count(R,N) for R = b {since},12,0), with 1 element",
        f"% window running(every(10)) of sum(N) {since},10,0), with 3 elements",
        "% window last(20,every(5)) of hopping(N) is open since datime(2025,12,31,23,59,55,0), with 3 elements",
        f"% window session(3,max(60)) of by_pause(R,N) for R = b {since},12,0), with 1 element",
        f"% window session(3,max(60)) of by_pause(R,N) for R = a {since},14,0), with 1 element",
        f"% window every(7,events) of do true {since},11,0), with 3 elements",
    ]


def test_flushed_windows_are_not_open(run_events: Any) -> None:
    lines = run_events(
        "--open", "--json", "--flush", "16", rules=OPEN_WINDOW_RULES, stream=OPEN_WINDOW_STREAM
    )[1]
    windows = [record for record in map(json.loads, lines) if "open_window" in record]
    start = 1767225611 * 10**9
    assert windows[:2] == [
        {
            "open_window": "every(30,first)",
            "rule": "by_first(N)",
            "name": "by_first(N)",
            "key": {},
            "elements": 3,
            "start": start,
            "end": start + 30 * 10**9,
        },
        {
            "open_window": "every(2,events)",
            "rule": "by_count(R,N)",
            "name": "by_count(R,N)",
            "key": {"R": "b"},
            "elements": 1,
            "start": start + 10**9,
            "end": None,
        },
    ]
    assert [window["open_window"] for window in windows[2:]] == ["every(7,events)"]


def test_goal_output_with_json_is_on_stderr(run_events: Any) -> None:
    rules = "a(X) <- b(X) where (write(seen(X)), nl).\n"
    status, lines, errors = run_events("--json", rules=rules, stream="event(b(1),[1,1]).\n")
    assert status == 0
    assert [json.loads(line)["event"] for line in lines] == ["b(1)", "a(1)"]
    assert errors == "seen(1)\n"


AHEAD_RULES = """
last_10(N) <- aggregate(count, tick, N, last(10)).
pair <- (left seq right) within 3.
hopping(N) <- aggregate(count, tick, N, every(5)).
silent <- left seq absent(never, 0.5).
"""


def stream_with_wrong_stamps(offsets: Any) -> str:
    """Return a stream of 200 s in which some ticks have a stamp that is an offset (s) too late."""
    lines: List[Any] = []
    for second in range(1000, 1200):
        end = second + dict(offsets).get(second, 0)
        lines += [f"event(tick,[{end},{end}]).", f"event(left,[{second}.25,{second}.25])."]
        lines.append(f"event(right,[{second}.5,{second}.5]).")
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("offsets", [{}, {1050: 3600}, {1050: 10**9}, {1010: 60, 1100: 3600, 1101: 7200}])
def test_command_and_engine_derive_same_events(run_events: Any, offsets: Dict[Any, Any]) -> None:
    stream = stream_with_wrong_stamps(offsets)
    _, lines, _ = run_events(rules=AHEAD_RULES, goals="timer(beat, every(10)).\n", stream=stream)
    engine, outputs = Engine(), []
    engine.on_event(lambda term, start, end: outputs.append(f"{engine.show(term)} {start} {end}"))
    engine.load(rules=AHEAD_RULES, goals="timer(beat, every(10)).")
    events = [read_term(line, engine.operators, "line").term for line in stream.splitlines()]
    for event in (required(event_of(term)) for term in events):
        engine.event(event.term, *event.interval_terms())
    printed = [required(event_of(read_term(line, engine.operators, "line").term)) for line in lines]
    assert len(outputs) > 1000
    assert [f"{engine.show(event.term)} {event.start} {event.end}" for event in printed] == outputs


CALLING_RULES = """\
press do ros_service('/dock', 'std_srvs/Trigger', std_srvs__0__Trigger_Request, d).
docked <- service_reply(_, d, _).
hot(T) <- heat(T) where (ros_param('/limit', Limit), T > Limit).
"""
ANSWERS = "services: [{name: /dock, reply: {success: true}, delay: 2}]\nparameters: {/limit: 40}\n"


def test_calls_have_answers_of_file(run_events: Any) -> None:
    """A delayed answer is an event between those of the stream, or within the time of ``--flush``."""
    stream = "event(press, [1,1]).\nevent(heat(41), [5,5]).\nevent(press, [6,6]).\n"
    status, lines, errors = run_events("--flush", "3", rules=CALLING_RULES, stream=stream, answers=ANSWERS)
    assert (status, errors) == (0, "")
    assert [line for line in lines if not line.startswith("event(service")] == [
        "event(press,[1,1]).",
        "event(docked,[3,3]).",
        "event(heat(41),[5,5]).",
        "event(hot(41),[5,5]).",
        "event(press,[6,6]).",
        "event(docked,[8,8]).",
    ]


def test_empty_answers_are_none(run_events: Any) -> None:
    rules = f"{CALLING_RULES}failed(R) <- service_failed(_, d, R)."
    arguments = {"rules": rules, "stream": "event(heat(41), [1,1]).\nevent(press, [2,2]).\n"}
    _, lines, errors = run_events("--flush", "1", answers="parameters: {}\nservices: []\n", **arguments)
    assert "ros_param" not in errors
    assert lines[-1].startswith("event(failed('no answer is prepared for this call')")
    _, _, errors = run_events("--flush", "1", answers="services: []\n", **arguments)
    assert (
        "ros_param: there is no parameter /limit: parameters are read only in a node: use --answers" in errors
    )


def test_call_within_flush_has_time_of_its_alarm(run_events: Any) -> None:
    rules = f"press <- start seq absent(stop, 2). {CALLING_RULES}called <- service_call(_, d, _)."
    _, lines, _ = run_events("--flush", "10", rules=rules, stream="event(start, [1,1]).\n")
    assert "event(called,[3,3])." in lines
