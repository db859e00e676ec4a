"""Absence with a deadline, compared with its definition."""

from events.streams.stream_feeder import Came, Fed, entries, item_of, stream
from hypothesis import example, given
from hypothesis import settings as example_settings
from hypothesis import strategies as st

from retalis.events.streams.absence_timeout import AbsenceTimeout, Correlation

ARRIVALS = stream(st.just(1), channels=(0, 0, 1))
CUTS = st.integers(0, 20)
SPANS = st.integers(1, 12)
some = example_settings(max_examples=40)


def agreement_of(arrivals, alike, open_keys=(), named=False):
    """Return an agreement about items whose matches are the places of arrivals: it looks at their keys."""

    def key(match, channel):
        found = arrivals[match].key
        return None if found in open_keys else found

    def rules_out(match, other):
        one, two = arrivals[match], arrivals[other]
        agree = one.key == two.key or one.key in open_keys or two.key in open_keys
        return agree and (alike or (match + other) % 2 == 0)

    name = (lambda match: arrivals[match].key) if named else None
    return Correlation(key, rules_out, alike, name)


def given_on(arrivals, span, agreement):
    """P, and no Q with eP < sQ and eQ < eP + span, among what came before that time was over."""
    found = []
    for one in arrivals:
        if one.channel or one.end + span <= one.now:
            continue
        absent = [
            other
            for other in arrivals
            if other.channel
            and one.end < other.start
            and other.end < one.end + span
            and other.now < one.end + span
            and agreement.cancels(one.at, other.at)
        ]
        if not absent:
            found.append(((one.at,), one.start, one.end + span))
    return found


@some
@given(ARRIVALS, CUTS, SPANS)
def test_of_one_key(arrivals, cut, span):
    agreement = agreement_of(arrivals, True)
    fed = Fed(lambda: AbsenceTimeout(span, agreement), cut)
    assert sorted(fed.feed(arrivals)) == sorted(given_on(arrivals, span, agreement))
    late = [one for one in arrivals if not one.channel and one.end + span <= one.now]
    assert cut < len(arrivals) or fed.stream.late_count == len(late)


@some
@given(ARRIVALS, CUTS, SPANS)
def test_with_a_condition_on_both(arrivals, cut, span):
    agreement = agreement_of(arrivals, False)
    said = Fed(lambda: AbsenceTimeout(span, agreement), cut).feed(arrivals)
    assert sorted(said) == sorted(given_on(arrivals, span, agreement))


@some
@given(ARRIVALS, CUTS, SPANS, st.booleans())
def test_where_some_have_variables(arrivals, cut, span, alike):
    """What has variables in what is common is compared with all."""
    agreement = agreement_of(arrivals, alike, open_keys=("b",))
    said = Fed(lambda: AbsenceTimeout(span, agreement), cut).feed(arrivals)
    assert sorted(said) == sorted(given_on(arrivals, span, agreement))


def latest_waiting(arrivals, span):
    """Return the outputs if of the waiting elements with one key only the one that ends last is kept."""
    waiting, outputs = {}, []
    for one in [*arrivals, Came(-1, "", 0, 0, 1, 1, 1 << 40)]:
        for key, other in list(waiting.items()):
            if other.end + span <= one.now:
                outputs.append(((other.at,), other.start, other.end + span))
                del waiting[key]
        if one.at < 0:
            break
        other = waiting.get(one.key)
        if one.channel:
            if other is not None and other.end < one.start and one.end < other.end + span:
                del waiting[one.key]
        elif (
            one.end + span > one.now
            and (other is None or other.end <= one.end)
            and not any(
                earlier.channel
                and earlier.key == one.key
                and one.end < earlier.start
                and earlier.end < one.end + span
                for earlier in arrivals[: one.at]
            )
        ):
            waiting[one.key] = one
    return outputs


@some
@given(ARRIVALS, CUTS, SPANS)
@example([Came(0, "a", 20, 20, 1, 0, 20), Came(1, "a", 19, 19, 1, 0, 20)], 0, 2)
def test_a_later_end_replaces_an_earlier_one(arrivals, cut, span):
    """Whichever of the two arrives first, as long as the earlier one still waits."""
    agreement = agreement_of(arrivals, True, named=True)
    outputs = Fed(lambda: AbsenceTimeout(span, agreement), cut).feed(arrivals)
    assert sorted(outputs) == sorted(latest_waiting(arrivals, span))


def taking(span, arrivals):
    """Return an operator that has taken some."""
    operator = AbsenceTimeout(span, agreement_of(arrivals, True))
    for came in arrivals:
        operator.advance_to(came.now)
        operator.process(item_of(came), came.now, came.channel)
    return operator


def test_what_must_not_happen_is_held_no_longer_than_it_may_rule_out():
    """As far as it is not superfluous: of one key two border ones are enough in each span of time."""
    arrivals = [Came(at, "a", at, at, 1, 1, at) for at in range(2000)]
    operator = taking(100, arrivals)
    assert len(operator) <= 5
    assert entries(operator) <= 110
    operator.process(item_of(arrivals[0]), 10_000, 0)
    assert len(operator) == 0


def test_many_that_are_not_superfluous_are_held_no_longer_either():
    """Where it depends on a condition which of them rules something out, all are held, and few more."""
    arrivals = [Came(at, "a", at, at, 1, 1, at) for at in range(2000)]
    operator = AbsenceTimeout(300, agreement_of(arrivals, False))
    for came in arrivals:
        operator.process(item_of(came), came.now, came.channel)
        assert len(operator) == min(came.at + 1, 300)
    (border,) = operator._forbidden.values()  # noqa: SLF001
    assert border.element_count == 300 and len(border.elements) <= 600
    operator.process(item_of(arrivals[0]), 2270, 0)
    assert len(operator) == len(border.elements) == 29
    operator.process(item_of(arrivals[0]), 9000, 0)
    assert len(operator) == 0 and not operator._forbidden  # noqa: SLF001


def test_what_is_replaced_or_ruled_out_leaves_the_heap():
    arrivals = [Came(at, "a", at, at, 1, at % 2, at) for at in range(2000)]
    operator = taking(1 << 30, arrivals)
    assert entries(operator) <= 160


def test_what_is_superfluous_is_not_counted_as_dropped():
    arrivals = [Came(at, "a", at, at, 1, 1, at) for at in range(10)]
    operator = taking(1000, arrivals)
    for left in range(len(operator) - 1, -1, -1):
        operator.drop_oldest()
        assert len(operator) == left


def test_the_oldest_that_waits_is_dropped_first():
    arrivals = [Came(at, f"k{at}", at, at, 1, int(at > 2), at) for at in range(5)]
    operator = taking(1000, arrivals)
    for left in range(4, -1, -1):
        operator.drop_oldest()
        assert len(operator) == left
    assert operator.next_deadline is None
