"""Actions of actionlib that a program of the node observes."""

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("actionlib", reason="actionlib is not installed")

PUB_SUB = """\
<publish_subscribe>
  <observe_action name="fetch" action_type="actionlib/Test" event="fetch"/>
  <publish_to name="seen" msg_type="std_msgs/String"/>
</publish_subscribe>
"""
GOALS = """\
compile_event_file('rules.txt')
subscribe(seen(Text), [], std_msgs__0__String(Text), seen, s1)
"""
RULES = """\
seen(T) <- fetch__goal{goal: {goal: N}} where format(atom(T), '"goal ~w"', [N]).
seen(T) <- fetch__feedback{feedback: {feedback: N}} where format(atom(T), '"feedback ~w"', [N]).
seen(T) <- fetch__result{status: S, result: {result: N}}
  where (atom_concat('"', Rest, S), atom_concat(Status, '"', Rest), format(atom(T), '"result ~w ~w"', [Status, N])).
seen('"cancel"') <- fetch__cancel(_).

accepted(G) <- fetch__status(G, '"executing"').
ended(G) <- fetch__status(G, S) where memberchk(S, ['"canceling"', '"canceled"', '"succeeded"']).
progress(G) <- fetch__feedback(G, _).
active(G) <- accepted(G).
active(G) <- progress(G).
seen('"stalled"') <- active(G) seq absent((active(G) or ended(G)), 0.5).
"""


@pytest.mark.parametrize("direct", ["auto", "false"])
def test_stalled_and_canceled_goal_is_seen(devel: Any, tmp_path: Path, direct: str) -> None:
    """With ``direct:=false``, the events pass as text between the two nodes."""
    (tmp_path / "pub_sub.xml").write_text(PUB_SUB)
    (tmp_path / "goalPredicates.txt").write_text(GOALS)
    (tmp_path / "rules.txt").write_text(RULES)
    devel.start_master()
    options = [f"program:={tmp_path}", f"direct:={direct}", "use_sim_time:=false"]
    devel.start("roslaunch", "retalis", "retalis.launch", *options)
    devel.expect(lambda nodes, services: "/retalis/reload" in services)
    printed = devel.run("python3", str(Path(__file__).with_name("action_peer.py")))
    seen = printed.splitlines()
    # Each topic has a connection of its own, so that events of two topics may change places.
    assert sorted(seen[:2]) == ["feedback 5", "goal 4"]
    assert seen[2] == "stalled"
    assert sorted(seen[3:]) == ["cancel", "result canceled 7"]
    assert "ERROR" not in devel.printed()
