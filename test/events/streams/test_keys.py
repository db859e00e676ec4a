"""Eviction of key states: idle keys, too many keys, row pattern matches that take too long."""

import pytest

from retalis import Engine

STEPS = "aggregate(list(V), q(K, V), L, steps([up where V == up, down where V == down]))"
LAST = "aggregate(list(V), q(K, V), L, last(3, events))"
EVERY = "aggregate(list(V), q(K, V), L, every(3, events))"
RUNNING = "aggregate(list(V), q(K, V), L, running(every(3, events)))"
CHANGE = "(q(K, L) with change(L, K))"
UNTIMED = {"steps": STEPS, "last": LAST, "every": EVERY, "running": RUNNING, "change": CHANGE}
TIMED = {
    "sliding": "aggregate(list(V), q(K, V), L, last(5))",
    "tumbling": "aggregate(list(V), q(K, V), L, every(5))",
    "first": "aggregate(list(V), q(K, V), L, every(5, first))",
    "hopping": "aggregate(list(V), q(K, V), L, last(10, every(5)))",
    "present": "aggregate(list(V), q(K, V), L, running(every(5)))",
    "throttle": "(q(K, L) with throttle(5, K))",
    "burst": "(q(K, L) with burst(5, K))",
    "debounce": "(q(K, L) with debounce(5, K))",
    "absent": "(q(K, L) seq absent(q(K, _), 5))",
}


class Run:
    """An engine with one rule, and what the rule gave."""

    def __init__(self, pattern, *flags, label="r"):
        self.engine = Engine()
        self.seen, self.warnings = [], []
        self.engine.rules.on_warning = lambda error: self.warnings.append(error.message)
        for name, value in flags:
            assert self.engine.call(f"set_etalis_flag({name}, {value})")
        self.engine.load(rules=f"{label} : found(K, L) <- {pattern}.")
        self._listen()

    def _listen(self):
        def note(term, start, end):
            if self.engine.show(term).startswith("found"):
                self.seen.append(self.engine.show(term)[len("found(") : -1])

        self.engine.on_event(note)

    def feed(self, text):
        """Give events, each as ``key-value@end``; return what was found."""
        del self.seen[:]
        for one in text.split():
            event, end = one.split("@")
            self.engine.event(f"q({event.replace('-', ',')})", float(end), float(end))
        return " ".join(self.seen)

    def go_on(self):
        """Go on with another engine that is restored from a snapshot of this one."""
        self.engine = Engine.restore(self.engine.snapshot())
        self._listen()

    @property
    def rule(self):
        return self.engine.status().rules[0]


def test_within_ends_steps_that_began_too_long_ago():
    run = Run(f"{STEPS} within 5")
    assert run.feed("a-up@1 a-down@2") == "a,[up,down]"
    assert run.feed("a-up@3 b-up@10 a-down@11") == ""
    assert run.feed("b-down@12") == "b,[up,down]"


def test_after_a_start_that_is_too_old_the_next_item_begins_a_match():
    later = STEPS.replace("down where", "later(down) where")
    assert Run(f"{later} within 5").feed("a-up@1 a-up@10 a-down@11") == "a,[up,down]"
    assert Run(later).feed("a-up@1 a-up@10 a-down@11") == "a,[up,down]"


@pytest.mark.parametrize("bound", ["within", "window", "ttl", "flag", "garbage"])
@pytest.mark.parametrize("kind", UNTIMED)
def test_each_bound_ends_the_state_of_idle_keys(kind, bound):
    pattern, flags, label = UNTIMED[kind], [], "r"
    if bound == "within":
        pattern = f"{pattern} within 5"
    elif bound == "flag":
        flags = [("state_ttl", 5)]
    elif bound == "garbage":
        flags = [("garbage_window", 5), ("garbage_control", "general")]
    else:
        label = f"r([property({bound}, 5)])"
    run = Run(pattern, *flags, label=label)
    for at in range(1000):
        run.feed(f"{at}-up@{at}")
    assert 4 <= run.rule.keys <= 6, run.rule


@pytest.mark.parametrize("kind", UNTIMED)
def test_without_a_bound_keys_are_kept(kind):
    run = Run(UNTIMED[kind])
    for at in range(100):
        run.feed(f"{at}-up@{at}")
    assert run.rule.keys == 100


@pytest.mark.parametrize("kind", TIMED)
def test_times_of_windows_and_rates_end_the_state_of_keys(kind):
    run = Run(TIMED[kind], ("max_keys", 50))
    for at in range(300):
        run.feed(f"{at}-up@{at}")
    assert run.rule.keys <= 16
    assert run.rule.dropped == 0


@pytest.mark.parametrize(
    "kind, fed, kept, anew",
    [
        ("steps", "a-up@1 b-x@{0} a-down@{0}", "a,[up,down]", ""),
        ("last", "a-1@1 a-2@{0}", "a,[1] a,[1,2]", "a,[1] a,[2]"),
        ("every", "a-1@1 a-2@2 b-0@{0} a-3@{0}", "a,[1,2,3]", ""),
        ("running", "a-1@1 a-2@{0}", "a,[1] a,[1,2]", "a,[1] a,[2]"),
        ("change", "a-1@1 a-1@{0}", "a,1", "a,1 a,1"),
    ],
)
@pytest.mark.parametrize("restored", [False, True])
def test_a_key_that_was_idle_for_longer_than_its_time_to_live_begins_anew(kind, fed, kept, anew, restored):
    for last, expected in ((6, kept), (8, anew)):
        run = Run(UNTIMED[kind], label="r([property(ttl, 5)])")
        first, rest = fed.format(last).split(" ", 1)
        found = run.feed(first)
        if restored:
            run.go_on()
        assert " ".join(one for one in (found, run.feed(rest)) if one) == expected


@pytest.mark.parametrize("kind", UNTIMED)
def test_a_key_that_is_used_again_and_again_is_kept(kind):
    run = Run(UNTIMED[kind], label="r([property(ttl, 5)])")
    run.feed(" ".join(f"a-up@{4 * at} {at}-up@{4 * at}" for at in range(20)))
    assert 1 <= run.rule.keys <= 4


def test_a_time_to_live_ends_partial_matches_and_runs():
    for pattern in ("(q(K, up) seq q(K, L))", "(q(K, up) seq aggregate(list(V), q(K, V), L))"):
        run = Run(pattern, ("state_ttl", 5))
        run.feed(" ".join(f"{at}-up@{at}" for at in range(100)))
        assert run.rule.keys <= 7
        assert run.rule.waiting <= 14


def test_a_label_has_its_own_time_to_live_beside_the_flag():
    run = Run(LAST, ("state_ttl", 5), label="r([property(ttl, 100)])")
    run.feed(" ".join(f"{at}-up@{at}" for at in range(50)))
    assert run.rule.keys == 50


@pytest.mark.parametrize(
    "kind", [*UNTIMED, "sliding", "tumbling", "first", "hopping", "present", "throttle", "burst"]
)
def test_of_too_many_keys_the_least_recently_used_go(kind):
    run = Run({**UNTIMED, **TIMED}[kind].replace("5", "1000").replace("10,", "1000,"), ("max_keys", 10))
    run.feed(" ".join(f"{at}-up@{at / 100}" for at in range(30)) + " z-up@2000")
    assert run.rule.keys <= 10
    assert run.rule.dropped in (20, 21)
    assert "has more than 10 keys; 1 of the least recently used have been dropped so far" in run.warnings[0]
    assert "max_keys" in run.warnings[0]
    assert len(run.warnings) == 5  # at 1, 2, 4, 8, 16


def test_a_key_in_use_outlives_others_that_are_newer():
    run = Run(LAST, ("max_keys", 3))
    assert run.feed("a-1@1 b-1@1 c-1@1 a-2@1 d-1@1 e-1@1 a-3@1").endswith("a,[1,2,3]")


def test_the_state_of_a_key_goes_with_what_waits_in_it():
    run = Run(STEPS, ("max_keys", 2))
    assert run.feed("a-up@1 b-up@2 c-up@3 a-down@4 c-down@5") == "c,[up,down]"
    assert (run.rule.keys, run.rule.waiting) == (1, 1)


def test_flags_hold_at_once():
    run = Run(CHANGE)
    run.feed(" ".join(f"{at}-up@{at}" for at in range(50)))
    assert run.engine.call("set_etalis_flag(state_ttl, 5)")
    run.feed("a-up@50")
    assert run.rule.keys == 6


@pytest.mark.slow
@pytest.mark.parametrize("value", ["0", "-1", "2.5", "many"])
def test_the_largest_number_of_keys_is_a_whole_number_from_1(value):
    with pytest.raises(Exception, match="max_keys takes a number of keys from 1"):
        Engine().call(f"set_etalis_flag(max_keys, {value})")


def test_a_time_to_live_of_0_is_none_whatever_the_flag_says():
    run = Run(LAST, ("state_ttl", 5), label="r([property(ttl, 0)])")
    run.feed(" ".join(f"{at}-up@{at}" for at in range(50)))
    assert run.rule.keys == 50
    with pytest.raises(Exception, match="property ttl needs a number of seconds"):
        Run(LAST, label="r([property(ttl, -1)])")


def test_what_is_held_is_estimated_in_bytes():
    few, many = Run(LAST), Run(LAST)
    few.feed("a-1@1")
    many.feed(" ".join(f"{at}-up@{at}" for at in range(100)))
    assert many.rule.bytes == 100 * few.rule.bytes > 0


def test_shapes_of_subscriptions_have_the_bounds_of_flags():
    engine = Engine()
    engine.load(goals="set_etalis_flag(state_ttl, 5), subscribe(q(K, V) with change(V, K), [], _, out, s)")
    for at in range(100):
        engine.event(f"q({at}, 1)", at, at)
    (one,) = engine.knowledge.subscriptions.items()
    assert len(one[1].rate_limiter) <= 6
    assert engine.call("set_etalis_flag(state_ttl, -1)")
    assert engine.call("set_etalis_flag(max_keys, 3)")
    for at in range(100):
        engine.event(f"q({at}, 1)", 100, 100)
    assert len(one[1].rate_limiter) == 3
