"""Throttle, burst, debounce and change, compared with their definitions."""

from events.streams.stream_feeder import Came, Fed, entries, item_of, stream
from hypothesis import given
from hypothesis import settings as example_settings
from hypothesis import strategies as st

from retalis.events.streams.rate_operators import Debounce, DistinctUntilChanged, Throttle
from retalis.prolog.terms.term_traversal import term_key

ARRIVALS = stream(st.sampled_from([1, 1.0, 2]))
PUNCTUAL = stream(st.just(1), late=0)
CUTS = st.integers(0, 20)
SPANS = st.integers(1, 8)
some = example_settings(max_examples=30)


def as_they_came(found):
    return [((one.at,), one.start, one.end) for one in found]


@some
@given(ARRIVALS, CUTS, SPANS)
def test_throttle(arrivals, cut, span):
    """None of the key that was let through ends less than the span before the newest end."""
    through = []
    for number, one in enumerate(arrivals):
        newest = max(other.end for other in arrivals[: number + 1])
        if not any(other.key == one.key and other.end > newest - span for other in through):
            through.append(one)
    assert Fed(lambda: Throttle(span, False), cut).feed(arrivals) == as_they_came(through)


@some
@given(ARRIVALS, CUTS, SPANS)
def test_burst(arrivals, cut, span):
    """None at all of the key ends less than the span before the newest end."""
    through = []
    for number, one in enumerate(arrivals):
        newest = max(other.end for other in arrivals[: number + 1])
        if not any(other.key == one.key and other.end > newest - span for other in arrivals[:number]):
            through.append(one)
    assert Fed(lambda: Throttle(span, True), cut).feed(arrivals) == as_they_came(through)


@some
@given(ARRIVALS, CUTS)
def test_change(arrivals, cut):
    """Another term than in the last one of the key that came, or the first."""
    through = []
    for number, one in enumerate(arrivals):
        before = [other for other in arrivals[:number] if other.key == one.key]
        if not before or term_key(before[-1].value) != term_key(one.value):
            through.append(one)
    assert Fed(DistinctUntilChanged, cut).feed(arrivals) == as_they_came(through)


def overtakes(other, one, span):
    """Tell whether another came in the span after one and ends no earlier."""
    return other.at > one.at and other.key == one.key and other.end >= one.end and other.now < one.end + span


@some
@given(stream(st.just(1), late=3), CUTS, st.integers(7, 12))
def test_debounce(arrivals, cut, span):
    """Given on a span after its end, if none with an end at least as large came meanwhile: none comes later here."""
    settled = []
    for one in arrivals:
        newer = any(overtakes(other, one, span) for other in arrivals)
        older = any(other.at < one.at and other.key == one.key and other.end > one.end for other in arrivals)
        if not newer and not older:
            settled.append(((one.at,), one.start, one.end + span))
    assert sorted(Fed(lambda: Debounce(span), cut).feed(arrivals)) == sorted(settled)


@some
@given(PUNCTUAL, SPANS)
def test_debounce_of_what_comes_in_time(arrivals, span):
    settled = [
        ((one.at,), one.start, one.end + span)
        for one in arrivals
        if not any(overtakes(other, one, span) for other in arrivals)
    ]
    said = Fed(lambda: Debounce(span)).feed(arrivals)
    assert sorted(said) == sorted(settled)
    assert [end for _, _, end in said] == sorted(end for _, _, end in said)


AHEAD = st.lists(st.tuples(st.sampled_from("ab"), st.integers(0, 3), st.integers(-6, 12)), max_size=20)


@some
@given(AHEAD, CUTS, SPANS)
def test_debounce_of_ends_ahead_of_the_clock(rows, cut, span):
    """One waits a span from its end; another of the key with an end within that, as late or later, rules it out."""
    now, arrivals, waiting, settled = 20, [], [], []
    for at, (key, step, ahead) in enumerate(rows):
        now += step
        arrivals.append(Came(at, key, now + ahead, now + ahead, 1, 0, now))
    for one in arrivals:
        settled += [other for other in waiting if other.end + span <= one.now]
        waiting = [other for other in waiting if other.end + span > one.now]
        same = [other for other in waiting if other.key == one.key]
        gone = [other for other in same if other.end <= one.end < other.end + span]
        waiting = [other for other in waiting if other not in gone]
        if one.end + span > one.now and not any(one.end < other.end < one.end + span for other in same):
            waiting.append(one)
    expected = [((one.at,), one.start, one.end + span) for one in settled + waiting]
    assert sorted(Fed(lambda: Debounce(span), cut).feed(arrivals)) == sorted(expected)


def test_what_is_forgotten_is_the_oldest():
    for shape in (Throttle(100, False), Throttle(100, True), DistinctUntilChanged(), Debounce(100)):
        for at in range(5):
            shape.process(item_of(Came(at, f"k{at}", at, at, 1, 0, at)), at, 0)
        for left in (4, 3, 2):
            shape.drop_oldest()
            assert len(shape) == left
        assert [item.key_values for item in shape.snapshot()[-1]] == [("k3",), ("k4",)]


def test_the_oldest_goes_of_what_was_overtaken_too():
    """Of a key that came again and again: what it was before is in no heap's way."""
    for shape in (Throttle(1000, True), Debounce(1000)):
        for at in range(20):
            shape.process(item_of(Came(at, "ab"[at % 2], at, at, 1, 0, at)), at, 0)
        shape.drop_oldest()
        assert [item.key_values for item in shape.snapshot()[-1]] == [("b",)]
        shape.drop_oldest()
        assert len(shape) == 0
        assert shape.next_deadline is None


def test_nothing_grows_with_what_came():
    """A thousand keys one after the other, or one key a thousand times."""
    for span in (3, 10_000):
        for shape in (Throttle(span, False), Throttle(span, True), Debounce(span)):
            for at in range(1000):
                key = f"k{at}" if span == 3 else "k"
                shape.advance_to(at)
                shape.process(item_of(Came(at, key, at, at, 1, 0, at)), at, 0)
            assert len(shape) <= 3
            assert entries(shape) <= 80


def test_a_stamp_of_a_wrong_clock_forgets_nobody():
    shape = Throttle(5, False)
    shape.compute_max_timestamp = lambda: 100
    assert shape.process(item_of(Came(0, "a", 50, 50, 1, 0, 50)), 50, 0)
    assert shape.process(item_of(Came(1, "b", 9000, 9000, 1, 0, 51)), 51, 0)
    assert not shape.process(item_of(Came(2, "a", 52, 52, 1, 0, 52)), 52, 0)
