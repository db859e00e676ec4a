"""When a soak is good: each pose that is missing or wrong needs a reason of its own."""

from collections import Counter
from types import SimpleNamespace

import pytest
from faults.dropped_messages import Drop, Drops
from faults.soak_evaluation import NODES, Restart, verdict

SPEED = 5
STEP = 22
SECOND = 10**9
START = 1000 * SECOND
STAMPS = range(1, 21)
TURNS = 3
EXACT = (1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0)
OTHER = (1.1, *EXACT[1:])


def key(seconds):
    return "m", START + seconds * SECOND


@pytest.fixture
def soak():
    """A soak in which nothing went wrong: a pose each second, of a bag that was sent three times."""
    complete = [SimpleNamespace(marker="m", stamp=key(second)[1]) for second in STAMPS]
    keys = [key(turn * STEP + second) for turn in range(TURNS) for second in STAMPS]
    stream = SimpleNamespace(
        step=STEP,
        truth=SimpleNamespace(complete=complete, start=START),
        turns=TURNS,
        poses=dict.fromkeys(keys, EXACT),
        times=Counter(keys),
        sent=1000,
        images=10,
        late=0.0,
    )
    drops = Drops()
    for node in NODES:
        drops.take(1.0, 0.0, [(f"{node}: queue", [("dropped events", "0")])])
    rows = [{"seconds": second, "behind": 0.1, **dict.fromkeys(NODES, 70.0)} for second in range(60)]
    return SimpleNamespace(
        options=SimpleNamespace(minutes=1.0, speed=SPEED),
        stream=stream,
        drops=drops,
        expected={("m", one.stamp): EXACT for one in complete},
        restarts=[],
        rows=rows,
        caller=SimpleNamespace(calls=5, failures=[]),
    )


def lose(soak, seconds):
    del soak.stream.poses[key(seconds)]
    del soak.stream.times[key(seconds)]


def spoil(soak, seconds):
    soak.stream.poses[key(seconds)] = OTHER


def bad(soak):
    """Return the lines of the checks that failed; the verdict has to agree with them."""
    good, lines = verdict(soak)
    found = [line for line in lines if line.startswith("BAD")]
    assert good is not bool(found)
    return found


def reasons(soak):
    (line,) = [line for line in verdict(soak)[1] if line.startswith("missing or wrong with a reason")]
    return line.partition(": ")[2]


def test_all_is_well(soak):
    assert bad(soak) == []
    assert reasons(soak) == "0 poses near a restart of a node, 0 where a drop was counted"


def test_a_lost_pose_needs_a_reason(soak):
    lose(soak, 30)
    assert bad(soak) == ["BAD  1 poses are lost without a reason: m at 30.0"]


def test_a_wrong_pose_needs_a_reason(soak):
    spoil(soak, 30)
    assert bad(soak) == ["BAD  1 poses are not what the engine gives offline, without a reason: m at 30.0"]


@pytest.mark.parametrize("what", [lose, spoil])
def test_a_drop_excuses_what_needs_messages_of_its_time(soak, what):
    soak.drops.found.append(Drop("retalis: queue", 1, 28.0, 32.0))
    what(soak, 30)
    assert bad(soak) == []
    assert reasons(soak) == "0 poses near a restart of a node, 1 where a drop was counted"


@pytest.mark.parametrize("what", [lose, spoil])
@pytest.mark.parametrize("span", [(25.0, 29.4), (30.6, 35.0)])
def test_drops_elsewhere_excuse_nothing_however_many(soak, what, span):
    soak.drops.found.append(Drop("retalis: queue", 1000, *span))
    what(soak, 30)
    assert len(bad(soak)) == 1


@pytest.mark.parametrize("what", [lose, spoil])
def test_a_node_that_is_down_excuses_what_is_near(soak, what):
    soak.restarts.append(Restart(6.0, "retalis", "SIGKILL", 29.0, 33.0))
    for seconds in (29, 30, 38):
        what(soak, seconds)
    assert bad(soak) == []
    assert reasons(soak) == "3 poses near a restart of a node, 0 where a drop was counted"
    what(soak, 39)
    assert len(bad(soak)) == 1


def test_the_restart_of_the_master_excuses_nothing(soak):
    soak.restarts.append(Restart(6.0, "master", "SIGKILL", 29.0, 33.0))
    lose(soak, 30)
    assert len(bad(soak)) == 1


def test_no_pose_comes_twice_even_near_a_restart(soak):
    soak.restarts.append(Restart(6.0, "retalis", "SIGKILL", 29.0, 33.0))
    soak.stream.times[key(30)] = 2
    assert bad(soak) == ["BAD  1 poses came twice: m at 30.0"]


def test_without_poses_nothing_is_shown(soak):
    soak.stream.turns = 0
    assert bad(soak) == ["BAD  0 poses came"]


def test_a_node_that_does_not_tell_its_drops_is_bad(soak):
    del soak.drops.looks["retalis"]
    assert bad(soak) == ["BAD  both nodes counted what they dropped: not retalis"]


def test_a_service_that_fails_is_bad(soak):
    soak.caller.failures.append("AddMemory: no answer")
    assert len(bad(soak)) == 1


def test_a_node_that_grows_is_bad(soak):
    for row in soak.rows:
        row["retalis"] += 2 * row["seconds"]
    assert bad(soak) == ["BAD  node retalis holds at most 148 MB from second 20, 188 MB from 40"]
