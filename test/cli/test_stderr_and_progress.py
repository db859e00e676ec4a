"""The progress bar: share, number, rate, time left."""

from io import StringIO

from retalis.cli.stderr_and_progress import ProgressBar, show_progress


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


def test_a_bar_tells_rate_and_time_left():
    drawn, clock, share = StringIO(), Clock(), 0.0
    bar = ProgressBar("messages", lambda: share, drawn, clock)
    bar(1)
    assert drawn.getvalue() == ""
    clock.now, share = 110.0, 0.25
    bar(12_000)
    shown = drawn.getvalue().rpartition("\033[K")[2]
    assert shown == " 25% [########......................] 12,000 messages, 1,200/s, 0:30 left"
    clock.now, share = 8000.0, 0.5
    bar(24_000)
    assert drawn.getvalue().endswith(", 2:11:40 left")
    bar.clear()
    assert drawn.getvalue().endswith("\r\033[K")


def test_shares_outside_of_a_whole_are_shown_as_one():
    assert ProgressBar("x", lambda: 1.5, StringIO()).format_line(3, 1.0).startswith("100%")
    assert ProgressBar("x", lambda: -1.0, StringIO()).format_line(3, 1.0).startswith("  0%")


def test_what_takes_long_has_a_rate_too():
    assert (
        ProgressBar("bags", lambda: 0.5, StringIO()).format_line(3, 12.0).endswith("3 bags, 0.2/s, 0:12 left")
    )


def test_nothing_is_drawn_where_nobody_looks(capsys):
    with show_progress("messages", lambda: 0.5) as bar:
        assert bar is None
    assert capsys.readouterr().err == ""
