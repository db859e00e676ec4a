"""Demonstration of the NAO example: processes, progress, and report."""

import io
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, Iterator, List

import pytest
from script_modules import load_script

NAO = Path(__file__).resolve().parents[2] / "examples" / "nao"


@pytest.fixture(scope="module")
def demo() -> Iterator[ModuleType]:
    sys.path.append(str(NAO))
    module = load_script(NAO / "demo.py")
    yield module
    sys.path.remove(str(NAO))


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def pose_message(name: str, x: float, y: float, z: float) -> Any:
    position = SimpleNamespace(x=x, y=y, z=z)
    return SimpleNamespace(header=SimpleNamespace(frame_id=name), pose=SimpleNamespace(position=position))


@pytest.fixture
def processes(demo: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    monkeypatch.setattr(demo.signal, "signal", lambda number, handler: None)
    demo_processes = demo.Processes(tmp_path, {})
    yield demo_processes
    demo_processes.close()


def test_close_ends_running_processes(processes: Any, tmp_path: Path) -> None:
    short = processes.start("short", sys.executable, "-c", "print('over')")
    short.wait(20)
    long = processes.start("long", sys.executable, "-c", "import time; time.sleep(60)")
    processes.close()
    assert short.returncode == 0
    assert long.returncode != 0
    assert (tmp_path / "short.log").read_text() == "over\n"


def test_wait_ends_with_process(demo: ModuleType, processes: Any) -> None:
    process = processes.start("short", sys.executable, "-c", "pass")
    process.wait(20)
    with pytest.raises(demo.DemoError, match="the master did not start"):
        demo.wait_until(lambda: False, "the master", [process])


def test_progress_is_a_bar_on_terminal(demo: ModuleType) -> None:
    stream = Terminal()
    progress = demo.Progress(stream)
    progress.show(0.5, "5 poses")
    progress.close()
    line = stream.getvalue()
    assert line.startswith("\r[#")
    assert line.count("#") == line.count(".")
    assert " 50% 5 poses" in line


def test_progress_is_a_line_per_quarter_elsewhere(demo: ModuleType) -> None:
    stream = io.StringIO()
    progress = demo.Progress(stream)
    for share in (-1.0, 0.1, 0.26, 0.3, 0.6, 2.0):
        progress.show(share, "")
    progress.close()
    assert [line.strip() for line in stream.getvalue().splitlines()] == ["26%", "60%", "100%"]


def test_last_pose_of_marker_counts(demo: ModuleType) -> None:
    poses = demo.Poses()
    for name, x in (('"4x4_1"', 1.0), ("4x4_1", 2.0), ("4x4_2", 3.0)):
        poses.add(pose_message(name, x, 0.0, 0.0))
    assert poses.located == {"4x4_1": (2.0, 0.0, 0.0), "4x4_2": (3.0, 0.0, 0.0)}
    assert poses.count == 3


def test_bag_without_truth_is_reported(
    demo: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    poses = demo.Poses()
    poses.add(pose_message("4x4_1", 1.0, 2.0, 3.0))
    assert not demo.report(poses, tmp_path / "own.bag", {"4x4_1", "4x4_2"})
    assert demo.report(poses, tmp_path / "own.bag", {"4x4_1"})
    assert capsys.readouterr().out.splitlines() == [
        "4x4_1       1.000    2.000    3.000",
        "4x4_2    not located",
        "1 of 2 markers located by 1 poses; the true positions are not known",
        "4x4_1       1.000    2.000    3.000",
        "1 of 1 markers located by 1 poses; the true positions are not known",
    ]


def test_report_requires_markers_near_truth(
    demo: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = tmp_path / "nao.bag"
    markers = dict.fromkeys(("4x4_1", "4x4_2"), ((1.0, 2.0, 0.5), (0.0, 0.0, 0.0, 1.0)))
    demo.nao_truth.save(demo.nao_truth.Truth(1.0, 1, 0, markers, []), bag)
    poses = demo.Poses()
    poses.add(pose_message("4x4_1", 1.0, 2.0, 0.51))
    assert not demo.report(poses, bag, markers)
    assert "not located" in capsys.readouterr().out
    poses.add(pose_message("4x4_2", 1.0, 2.0, 0.53))
    assert not demo.report(poses, bag, markers)
    poses.add(pose_message("4x4_2", 1.0, 2.0, 0.5))
    assert demo.report(poses, bag, markers)
    assert "2 of 2 markers located within 2 cm" in capsys.readouterr().out


@pytest.mark.parametrize("argv", [["--bag", "no-such.bag"], ["--seconds", "0"], ["--input", "telepathy"]])
def test_invalid_arguments_are_usage_errors(
    demo: ModuleType, argv: List[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as raised:
        demo.arguments(argv)
    assert raised.value.code == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith("demo: error: ")


def test_help_needs_no_ros() -> None:
    process = subprocess.run(
        [sys.executable, "-S", str(NAO / "demo.py"), "--help"], stdout=subprocess.PIPE, text=True, check=True
    )
    assert "--input" in process.stdout


def test_free_port_is_free(demo: ModuleType) -> None:
    port = demo.free_port()
    with demo.socket.socket() as client:
        assert client.connect_ex(("localhost", port)) != 0
    with demo.socket.socket() as server:
        server.bind(("localhost", port))
        assert server.getsockname()[1] == port
