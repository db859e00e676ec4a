"""Evaluation of a long run: each missing or wrong pose needs a reason."""

from collections import Counter
from types import SimpleNamespace
from typing import Any, Tuple

import pytest
from faults.dropped_message_counts import Drop, Drops
from faults.soak_evaluation import NODES, Restart, verdict

SPEED = 5
STEP = 22
SECOND = 10**9
START = 1000 * SECOND
STAMPS = range(1, 21)
TURNS = 3
EXACT = (1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0)
OTHER = (1.1, *EXACT[1:])


def key(seconds: int) -> Tuple[Any, ...]:
    return "m", START + seconds * SECOND


@pytest.fixture
def soak() -> Any:
    """Return a run without faults: a pose per second, of a bag that is sent three times."""
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
        drops.add(1.0, 0.0, [(f"{node}: queue", [("dropped events", "0")])])
    rows = [{"seconds": second, "behind": 0.1, **dict.fromkeys(NODES, 70.0)} for second in range(60)]
    return SimpleNamespace(
        options=SimpleNamespace(minutes=1.0, speed=SPEED),
        stream=stream,
        drops=drops,
        expected={("m", view.stamp): EXACT for view in complete},
        restarts=[],
        rows=rows,
        caller=SimpleNamespace(calls=5, failures=[]),
    )


def lose(soak: Any, seconds: int) -> None:
    del soak.stream.poses[key(seconds)]
    del soak.stream.times[key(seconds)]


def spoil(soak: Any, seconds: int) -> None:
    soak.stream.poses[key(seconds)] = OTHER


def failed_checks(soak: Any) -> Any:
    """Return the lines of the failed checks, and compare them with the verdict."""
    is_good, lines = verdict(soak)
    failures = [line for line in lines if line.startswith("BAD")]
    assert is_good is not bool(failures)
    return failures


def reasons(soak: Any) -> Any:
    (line,) = [line for line in verdict(soak)[1] if line.startswith("missing or wrong with a reason")]
    return line.partition(": ")[2]


def test_run_without_faults_is_good(soak: Any) -> None:
    assert failed_checks(soak) == []
    assert reasons(soak) == "0 poses near a restart of a node, 0 where a drop was counted"


def test_lost_pose_without_reason_is_bad(soak: Any) -> None:
    lose(soak, 30)
    assert failed_checks(soak) == ["BAD  1 poses are lost without a reason: m at 30.0"]


def test_wrong_pose_without_reason_is_bad(soak: Any) -> None:
    spoil(soak, 30)
    assert failed_checks(soak) == [
        "BAD  1 poses differ from those of the playback without a reason: m at 30.0"
    ]


@pytest.mark.parametrize("fault", [lose, spoil])
def test_drop_is_reason_for_faults_of_its_time(soak: Any, fault: Any) -> None:
    soak.drops.growths.append(Drop("retalis: queue", 1, 28.0, 32.0))
    fault(soak, 30)
    assert failed_checks(soak) == []
    assert reasons(soak) == "0 poses near a restart of a node, 1 where a drop was counted"


@pytest.mark.parametrize("fault", [lose, spoil])
@pytest.mark.parametrize("span", [(25.0, 29.4), (30.6, 35.0)])
def test_drop_at_other_time_is_no_reason(soak: Any, fault: Any, span: Tuple[Any, ...]) -> None:
    soak.drops.growths.append(Drop("retalis: queue", 1000, *span))
    fault(soak, 30)
    assert len(failed_checks(soak)) == 1


@pytest.mark.parametrize("fault", [lose, spoil])
def test_restart_of_node_is_reason_for_near_faults(soak: Any, fault: Any) -> None:
    soak.restarts.append(Restart(6.0, "retalis", "SIGKILL", 29.0, 33.0))
    for seconds in (29, 30, 38):
        fault(soak, seconds)
    assert failed_checks(soak) == []
    assert reasons(soak) == "3 poses near a restart of a node, 0 where a drop was counted"
    fault(soak, 39)
    assert len(failed_checks(soak)) == 1


def test_restart_of_master_is_no_reason(soak: Any) -> None:
    soak.restarts.append(Restart(6.0, "master", "SIGKILL", 29.0, 33.0))
    lose(soak, 30)
    assert len(failed_checks(soak)) == 1


def test_repeated_pose_near_restart_is_bad(soak: Any) -> None:
    soak.restarts.append(Restart(6.0, "retalis", "SIGKILL", 29.0, 33.0))
    soak.stream.times[key(30)] = 2
    assert failed_checks(soak) == ["BAD  1 poses received twice: m at 30.0"]


def test_run_without_poses_is_bad(soak: Any) -> None:
    soak.stream.turns = 0
    assert failed_checks(soak) == ["BAD  0 poses received"]


def test_node_without_reports_is_bad(soak: Any) -> None:
    del soak.drops.report_counts["retalis"]
    assert failed_checks(soak) == ["BAD  both nodes counted dropped messages: not retalis"]


def test_failed_service_call_is_bad(soak: Any) -> None:
    soak.caller.failures.append("AddMemory: no answer")
    assert len(failed_checks(soak)) == 1


def test_growth_of_memory_is_bad(soak: Any) -> None:
    for row in soak.rows:
        row["retalis"] += 2 * row["seconds"]
    assert failed_checks(soak) == ["BAD  node retalis holds at most 148 MB from second 20, 188 MB from 40"]
