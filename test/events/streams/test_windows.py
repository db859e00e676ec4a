"""Windows, compared with their definitions over plain lists."""

import pytest
from events.streams.stream_feeder import Came, Fed, entries, item_of, listing, spanning, stream
from hypothesis import given
from hypothesis import settings as example_settings
from hypothesis import strategies as st

from retalis import RuleError
from retalis.events.streams.aggregates import AGGREGATES
from retalis.events.streams.windows import (
    AlignedTumblingWindow,
    AnchoredTumblingWindow,
    HoppingWindow,
    SlidingCountWindow,
    SlidingTimeWindow,
    TumblingCountWindow,
)

ARRIVALS = stream(st.sampled_from([1, 2.5]))
CUTS = st.integers(0, 20)
some = example_settings(max_examples=30)


def newest(arrivals):
    return max(one.end for one in arrivals)


def same_group(arrivals):
    return [one for one in arrivals if one.key == arrivals[-1].key]


def prefixes(arrivals):
    return [arrivals[: number + 1] for number in range(len(arrivals))]


@some
@given(ARRIVALS, CUTS, st.integers(1, 8))
def test_of_the_last_seconds(arrivals, cut, span):
    """Those taken that began less than the span before the newest end; what is late is not taken."""
    expected = []
    for came in prefixes(arrivals):
        before = newest(came) - span
        if came[-1].start > before:
            expected.append(spanning([one for one in same_group(came) if one.start > before]))
    fed = Fed(lambda: SlidingTimeWindow(listing, span), cut)
    assert fed.feed(arrivals) == expected
    if arrivals:
        inside = [one for one in arrivals if one.start > newest(arrivals) - span]
        assert len(fed.stream) == len(inside)


@some
@given(ARRIVALS, CUTS, st.integers(1, 5))
def test_of_the_last_items(arrivals, cut, most):
    fed = Fed(lambda: SlidingCountWindow(listing, most), cut)
    assert fed.feed(arrivals) == [spanning(same_group(came)[-most:]) for came in prefixes(arrivals)]
    assert len(fed.stream) == sum(min(most, sum(one.key == key for one in arrivals)) for key in "ab")


@some
@given(ARRIVALS, CUTS, st.integers(1, 5), st.booleans())
def test_so_many_at_a_time(arrivals, cut, most, running):
    expected = []
    for came in prefixes(arrivals):
        here = same_group(came)
        size = (len(here) - 1) % most + 1
        if running or size == most:
            expected.append(spanning(here[-size:]))
    assert Fed(lambda: TumblingCountWindow(listing, most, running), cut).feed(arrivals) == expected


@some
@given(ARRIVALS, CUTS, st.integers(1, 6), st.integers(1, 6))
def test_at_instants(arrivals, cut, span, every):
    """At each multiple of a step those that had come and ended in the span before it; one group each."""
    expected = []
    last = newest(arrivals) + span + every if arrivals else 0
    for instant in range(0, last + 1, every):
        inside = [one for one in arrivals if one.now < instant and instant - span <= one.end < instant]
        groups = [[one for one in inside if one.key == key] for key in "ab"]
        interval = (instant - span, instant)
        expected.append([({one.at for one in group}, *interval) for group in groups if group])
    fed = Fed(lambda: HoppingWindow(listing, span, every), cut)
    said = [(set(items), start, end) for items, start, end in fed.feed(arrivals)]
    assert sorted(said, key=str) == sorted((one for found in expected for one in found), key=str)
    assert [end for _, _, end in said] == sorted(end for _, _, end in said)
    assert len(fed.stream) == 0
    # What ends between two windows is in none of them, and never late.
    late = [
        one
        for one in arrivals
        if (one.end // every + 1) * every - span <= one.end
        and (one.end + span) // every * every <= one.now // every * every
    ]
    assert cut < len(arrivals) or fed.stream.late_count == len(late)


@some
@given(ARRIVALS, CUTS, st.integers(1, 6), st.booleans())
def test_from_the_first_of_a_group(arrivals, cut, span, running):
    """A window begins with the end of its first, and is over when the clock comes to so much later."""
    expected, opened = [], {}

    def close(now):
        over = sorted((found[0].end, key) for key, found in opened.items() if found[0].end + span <= now)
        for begin, key in over:
            found = opened.pop(key)
            if not running:
                expected.append((tuple([one.at for one in found]), begin, begin + span))

    for one in arrivals:
        close(one.now)
        found = opened.setdefault(one.key, [])
        if found and not found[0].end <= one.end < found[0].end + span:
            continue
        if not found and one.end + span <= one.now:
            del opened[one.key]  # its window is over
            continue
        found.append(one)
        if running:
            expected.append(spanning(found))
    close(1 << 40)
    said = Fed(lambda: AnchoredTumblingWindow(listing, span, running), cut).feed(arrivals)
    assert sorted(said) == sorted(expected) if not running else said == expected


@some
@given(ARRIVALS, CUTS, st.integers(1, 8))
def test_of_the_present_window(arrivals, cut, span):
    """Those that end in the window in which the newest end is; one of an earlier window is late."""
    expected = []
    for came in prefixes(arrivals):
        here = [one for one in same_group(came) if one.end // span == newest(came) // span]
        if came[-1] in here:
            expected.append(spanning(here))
    assert Fed(lambda: AlignedTumblingWindow(listing, span), cut).feed(arrivals) == expected


WINDOWS = {
    "last seconds": lambda: SlidingTimeWindow(listing, 100),
    "last items": lambda: SlidingCountWindow(listing, 100),
    "batches": lambda: TumblingCountWindow(listing, 100, False),
    "from the first": lambda: AnchoredTumblingWindow(listing, 100, False),
    "present": lambda: AlignedTumblingWindow(listing, 1000),
    "instants": lambda: HoppingWindow(listing, 100, 50),
}


@pytest.mark.parametrize("kind", WINDOWS)
def test_the_oldest_can_be_dropped(kind):
    fed = Fed(WINDOWS[kind])
    arrivals = [Came(at, "ab"[at % 2], 10 + at, 10 + at, at, 0, 10 + at) for at in range(10)]
    for number, came in enumerate(arrivals[:6], 1):
        fed.stream.process(item_of(came), came.now, 0)
        assert len(fed.stream) == number
    for left in range(5, -1, -1):
        fed.stream.drop_oldest()
        assert len(fed.stream) == left
    said = fed.feed(arrivals[6:])
    assert all(set(items) <= {6, 7, 8, 9} for items, _, _ in said)


@pytest.mark.parametrize("kind", WINDOWS)
def test_what_was_dropped_is_held_nowhere(kind):
    """Where a window takes more than may be held, for as long as it takes."""
    window = WINDOWS[kind]()
    for at in range(1500):
        window.process(item_of(Came(at, f"k{at // 3}", 10, 10, at, 0, 10)), 10, 0)
        if len(window) > 5:
            window.drop_oldest()
    assert len(window) == 5
    assert entries(window) <= 90


@pytest.mark.parametrize("kind", WINDOWS)
def test_ends_that_are_too_far_ahead_do_not_move_the_time_on(kind):
    """One stamp of a wrong clock neither empties a window nor makes what comes after it late."""
    window = WINDOWS[kind]()
    window.tracks_elements, window.compute_max_timestamp = True, lambda: 1000
    for at in range(3):
        window.process(item_of(Came(at, "a", 900 + at, 900 + at, at, 0, 900)), 900, 0)
    window.process(item_of(Came(3, "b", 9000, 9000, 3, 0, 903)), 903, 0)
    late = window.late_count
    said = window.process(item_of(Came(4, "a", 904, 904, 4, 0, 904)), 904, 0)
    assert window.late_count == late
    said = said or window.advance_to(1010)
    if kind != "batches":
        assert [tuple([one.match for one in output.elements]) for output in said][-1] == (0, 1, 2, 4)


def test_a_refused_value_leaves_no_group():
    window = SlidingTimeWindow(lambda: [AGGREGATES["sum"].make_accumulator(0, None)], 10)
    with pytest.raises(RuleError, match="finite"):
        window.process(item_of(Came(0, "a", 1, 1, float("inf"), 0, 1)), 1, 0)
    assert (len(window), window.states) == (0, {})


def test_what_cannot_be_measured_is_said_and_the_next_is_measured():
    """Of numbers that are too large together: the window is over all the same."""
    make = [lambda: TumblingCountWindow(of_sum, 2, False), lambda: HoppingWindow(of_sum, 10, 10)]
    numbers = [1e308, 1e308, 1.0, 2.0]

    def of_sum():
        return [AGGREGATES["sum"].make_accumulator(0, None)]

    for one in make:
        window = one()
        outputs = []
        for at, number in enumerate(numbers):
            came = Came(at, "a", 5 * at, 5 * at, number, 0, 5 * at)
            outputs += window.advance_to(came.now) + window.process(item_of(came), came.now, 0)
        outputs += window.advance_to(100)
        assert [output.results for output in outputs] == [(), (3.0,)]
        assert "too large" in outputs[0].error.message
        assert outputs[1].error is None


def test_what_has_left_costs_nothing():
    """However many items have gone through a window, only those that are in it are held, in all of its queues."""
    sliding, hopping = SlidingTimeWindow(listing, 10), HoppingWindow(listing, 10, 5)
    for at in range(2000):
        end = 5 * at - (7 if at % 3 == 0 else 0)
        for window in (sliding, hopping):
            window.advance_to(5 * at)
            window.process(item_of(Came(at, "a", end, end, at, 0, 5 * at)), 5 * at, 0)
    for window in (sliding, hopping):
        assert len(window) <= 5
        assert entries(window) <= 80
        assert all(len(group.elements) <= 80 for group in window.states.values())
