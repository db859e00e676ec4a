"""Comparison of the speed of two checkouts that run alternately."""

import subprocess
from pathlib import Path
from typing import Any, Callable

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = """
import sys
from pathlib import Path

log = Path(__file__).resolve().parent / "runs"
before = log.read_text() if log.exists() else ""
log.write_text(before + "x")
print("case", sys.argv[1], "us_per_event", {figures}["{case}"][len(before) % 2])
"""


@pytest.fixture
def alternating(import_benchmark: Callable[[str], Any]) -> Any:
    return import_benchmark("alternating")


def write_checkout(folder: Path, first: float, second: float, case: str = "nao") -> Any:
    """Write a checkout whose only case takes two times (µs) alternately."""
    script = folder / "bench" / "engine.py"
    script.parent.mkdir(parents=True, exist_ok=True)
    script.write_text(SCRIPT.format(figures={case: [first, second]}, case=case).replace("'", '"'))
    return folder


def git(folder: Any, *arguments: Any) -> None:
    """Run git with a fixed identity, independent of the settings of the machine."""
    settings = [
        "-c",
        "user.name=someone",
        "-c",
        "user.email=someone@example.org",
        "-c",
        "commit.gpgsign=false",
    ]
    subprocess.run(["git", "-C", str(folder), *settings, *arguments], check=True, stdout=subprocess.DEVNULL)


def test_best_runs_are_compared(alternating: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = write_checkout(tmp_path / "before", 2.0, 9.0)
    now = write_checkout(tmp_path / "now", 5.0, 2.05)
    assert alternating.main([str(before), "--case", "nao", "--runs", "2"], now) == 0
    assert " ".join(capsys.readouterr().out.split()) == "nao before 2.000 now 2.050 us +2.5 %"


def test_slower_case_is_reported(
    alternating: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = write_checkout(tmp_path / "before", 2.0, 2.0)
    now = write_checkout(tmp_path / "now", 2.1, 2.1)
    assert alternating.main([str(before), "--case", "nao", "--runs", "1"], now) == 1
    assert capsys.readouterr().out.splitlines()[-1] == "slower by more than 3 %: nao"
    assert alternating.main([str(before), "--case", "nao", "--runs", "1", "--most", "6"], now) == 0


def test_case_that_seems_slower_is_repeated(
    alternating: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = write_checkout(tmp_path / "before", 2.0, 2.0)
    now = write_checkout(tmp_path / "now", 3.0, 1.9)
    assert alternating.main([str(before), "--case", "nao", "--runs", "1"], now) == 0
    assert " ".join(capsys.readouterr().out.split()) == "nao before 2.000 now 1.900 us -5.0 %"
    assert (now / "bench" / "runs").read_text() == "xx"


def test_revision_is_checked_out(
    alternating: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    git(tmp_path, "init", "--quiet")
    write_checkout(tmp_path, 4.0, 4.0)
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "--quiet", "-m", "Before")
    write_checkout(tmp_path, 2.0, 2.0)
    assert alternating.main(["HEAD", "--case", "nao", "--runs", "1"], tmp_path) == 0
    assert " ".join(capsys.readouterr().out.split()) == "nao before 4.000 now 2.000 us -50.0 %"


def test_case_missing_before_is_omitted(
    alternating: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = write_checkout(tmp_path / "before", 2.0, 2.0, "sync_now")
    assert alternating.main([str(before), "--case", "nao"], tmp_path) == 0
    assert " ".join(capsys.readouterr().out.split()) == "nao is not there before"


def test_invalid_checkout_is_reported(alternating: Any, tmp_path: Path) -> None:
    git(tmp_path, "init", "--quiet")
    with pytest.raises(SystemExit, match="^nosuch is neither a folder nor a revision: fatal: "):
        alternating.main(["nosuch"], tmp_path)
    with pytest.raises(SystemExit, match="^there is no .*engine.py$"):
        alternating.main([str(tmp_path)], tmp_path)


@pytest.mark.slow
def test_checkout_is_compared_with_itself(alternating: Any, capsys: pytest.CaptureFixture[str]) -> None:
    """The result of a single run is not asserted, since it is no measurement."""
    assert alternating.main([str(ROOT), "--case", "join_seq_1000", "--runs", "1", "--most", "1000"]) == 0
    assert capsys.readouterr().out.startswith("join_seq_1000 ")
