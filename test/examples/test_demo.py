import importlib.util
import io
import subprocess
import sys
from pathlib import Path

import pytest

NAO = Path(__file__).resolve().parents[2] / "examples" / "nao"


@pytest.fixture(scope="module")
def demo():
    sys.path.append(str(NAO))
    spec = importlib.util.spec_from_file_location("demo", str(NAO / "demo.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    sys.path.remove(str(NAO))


class Terminal(io.StringIO):
    def isatty(self):
        return True


class Place:
    def __init__(self, x, y, z):
        self.x, self.y, self.z = x, y, z


def message(name, *place):
    def record(**fields):
        return type("Record", (), fields)

    return record(header=record(frame_id=name), pose=record(position=Place(*place)))


@pytest.fixture
def processes(demo, tmp_path, monkeypatch):
    monkeypatch.setattr(demo.signal, "signal", lambda number, handler: None)
    them = demo.Processes(tmp_path, {})
    yield them
    them.close()


def test_close_ends_what_runs_and_leaves_what_ended(processes, tmp_path):
    ended = processes.start("short", sys.executable, "-c", "print('over')")
    ended.wait(20)
    waiting = processes.start("long", sys.executable, "-c", "import time; time.sleep(60)")
    processes.close()
    assert ended.returncode == 0 and waiting.returncode != 0
    assert (tmp_path / "short.log").read_text() == "over\n"


def test_waiting_ends_when_the_process_does(demo, processes):
    process = processes.start("short", sys.executable, "-c", "pass")
    process.wait(20)
    with pytest.raises(demo.DemoError, match="the master did not start"):
        demo.wait_until(lambda: False, "the master", [process])


def test_bar_on_a_terminal(demo):
    stream = Terminal()
    progress = demo.Progress(stream)
    progress.show(0.5, "5 poses")
    progress.close()
    line = stream.getvalue()
    assert line.startswith("\r[#") and line.count("#") == line.count(".") and " 50% 5 poses" in line


def test_a_line_at_each_quarter_elsewhere(demo):
    stream = io.StringIO()
    progress = demo.Progress(stream)
    for share in (-1.0, 0.1, 0.26, 0.3, 0.6, 2.0):
        progress.show(share, "")
    progress.close()
    assert [line.strip() for line in stream.getvalue().splitlines()] == ["26%", "60%", "100%"]


def test_last_pose_of_each_marker_counts(demo):
    poses = demo.Poses()
    for name, x in (('"4x4_1"', 1.0), ("4x4_1", 2.0), ("4x4_2", 3.0)):
        poses.add(message(name, x, 0.0, 0.0))
    assert poses.located == {"4x4_1": (2.0, 0.0, 0.0), "4x4_2": (3.0, 0.0, 0.0)}
    assert poses.count == 3


def test_report_of_a_bag_without_truth(demo, tmp_path, capsys):
    poses = demo.Poses()
    poses.add(message("4x4_1", 1.0, 2.0, 3.0))
    assert not demo.report(poses, tmp_path / "own.bag", {"4x4_1", "4x4_2"})
    assert demo.report(poses, tmp_path / "own.bag", {"4x4_1"})
    assert capsys.readouterr().out.splitlines() == [
        "4x4_1       1.000    2.000    3.000",
        "4x4_2    not located",
        "1 of 2 markers located by 1 poses; the true positions are not known",
        "4x4_1       1.000    2.000    3.000",
        "1 of 1 markers located by 1 poses; the true positions are not known",
    ]


def test_report_wants_every_marker_near_its_truth(demo, tmp_path, capsys):
    bag = tmp_path / "nao.bag"
    markers = dict.fromkeys(("4x4_1", "4x4_2"), ((1.0, 2.0, 0.5), (0.0, 0.0, 0.0, 1.0)))
    demo.nao_truth.save(demo.nao_truth.Truth(1.0, 1, 0, markers, []), bag)
    poses = demo.Poses()
    poses.add(message("4x4_1", 1.0, 2.0, 0.51))
    assert not demo.report(poses, bag, markers)
    assert "not located" in capsys.readouterr().out
    poses.add(message("4x4_2", 1.0, 2.0, 0.53))
    assert not demo.report(poses, bag, markers)
    poses.add(message("4x4_2", 1.0, 2.0, 0.5))
    assert demo.report(poses, bag, markers)
    assert "2 of 2 markers located within 2 cm" in capsys.readouterr().out


@pytest.mark.parametrize("argv", [["--bag", "no-such.bag"], ["--seconds", "0"], ["--input", "telepathy"]])
def test_wrong_arguments_are_one_line(demo, argv, capsys):
    with pytest.raises(SystemExit) as raised:
        demo.arguments(argv)
    assert raised.value.code == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith("demo: error: ")


def test_help_needs_no_ros():
    shown = subprocess.run(
        [sys.executable, "-S", str(NAO / "demo.py"), "--help"], stdout=subprocess.PIPE, text=True, check=True
    )
    assert "--input" in shown.stdout


def test_free_port_is_free(demo):
    port = demo.free_port()
    with demo.socket.socket() as client:
        assert client.connect_ex(("localhost", port)) != 0  # nobody listens
    with demo.socket.socket() as server:
        server.bind(("localhost", port))
        assert server.getsockname()[1] == port
