"""Progress bar: share, count, rate and remaining time, on terminals and in logs."""

from io import StringIO

import pytest

from retalis.cli.progress_bar import ProgressBar, show_progress


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def test_bar_shows_rate_and_remaining_time() -> None:
    output, clock, share = StringIO(), Clock(), 0.0
    bar = ProgressBar("messages", lambda: share, output, clock)
    bar(1)
    assert output.getvalue() == ""
    clock.now, share = 110.0, 0.25
    bar(12_000)
    line = output.getvalue().rpartition("\033[K")[2]
    assert line == " 25% [########......................] 12,000 messages, 1,200/s, 0:30 left"
    clock.now, share = 8000.0, 0.5
    bar(24_000)
    assert output.getvalue().endswith(", 2:11:40 left")
    bar.clear()
    assert output.getvalue().endswith("\r\033[K")


def test_share_is_clamped_to_range() -> None:
    assert ProgressBar("x", lambda: 1.5, StringIO()).format_line(3, 1.0).startswith("100%")
    assert ProgressBar("x", lambda: -1.0, StringIO()).format_line(3, 1.0).startswith("  0%")


def test_rate_below_one_is_shown() -> None:
    assert (
        ProgressBar("bags", lambda: 0.5, StringIO()).format_line(3, 12.0).endswith("3 bags, 0.2/s, 0:12 left")
    )


def test_log_has_line_each_minute() -> None:
    output, clock, share = StringIO(), Clock(), 0.0
    bar = ProgressBar("bags", lambda: share, output, clock, is_log=True)
    bar.state = "2 workers"
    for clock.now, share in ((130.0, 0.01), (160.0, 0.02), (170.0, 0.03), (220.0, 0.04)):
        bar(round(share * 100))
        bar.clear()
    assert output.getvalue().splitlines() == [
        "2% 2 bags in 1:00, 2.0/min, 49:00 left; 2 workers",
        "4% 4 bags in 2:00, 2.0/min, 48:00 left; 2 workers",
    ]


def test_no_bar_is_drawn_without_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    with show_progress("messages", lambda: 0.5) as bar:
        assert bar is None
    assert capsys.readouterr().err == ""
