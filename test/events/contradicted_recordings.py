"""Recorded scenarios that contradict the language reference, with the sentence and the results that it requires.

All other results of such a scenario are those of the recording.
"""

from typing import Dict, List, NamedTuple, Optional


class Contradiction(NamedTuple):
    """A contradiction between a scenario and the reference.

    Attributes:
        line: the sentence of the reference.
        events: the required events, as ``term@start-end`` in seconds of the minute; None: as recorded.
        answers: the required solutions by the number of the query; other queries as recorded.
        outputs: the required outputs; None: as recorded.
        errors: whether there is an error; None: as recorded.
    """

    line: str
    events: Optional[str] = None
    answers: Dict[int, List[str]] = {}
    outputs: Optional[List[str]] = None
    errors: Optional[bool] = None


CHECK = "`P check G` | as where, with `t1(S)` and `t2(E)` true inside G for this event only"
EITHER = "Every two-sided pattern but `seq` takes its sides in either order of arrival"
EXACT = "All comparisons are exact, on integer nanoseconds"
ERROR = (
    "a goal that raises an error stops that firing, is logged with rule, event and goal, "
    "and everything else goes on"
)
KEPT = "`unrestricted` | all that fit, oldest first | nothing is used up, by any operator"
CLOCK = "remove partial matches older than the window by the rule's clock"
STARTS = "`P starts Q` | s1 = s2 and e1 < e2; `P finishes Q` | e1 = e2 and s2 < s1"
DATIME = "Month lengths, leap years, midnight and UTC are right in every datime predicate"
SAME = "forms never matter: addition and subtraction take every form of a stamp, as comparisons do"

TEN = "datime(2001,1,1,0,0,10.0,0)"
TWENTY = "datime(2001,1,1,0,0,20.0,0)"

_OPS = (
    "a@1-1 o@1-1 sg@1-1 ag(0)@1-1 b@2-2 s@1-2 w@1-2 an@1-2 o@2-2 cn@1-2 fn@2-2 ch@2-2 mu(1)@2-2 mu(2)@2-2 "
    "d@2-2 sg@1-2 ag(1)@1-2 fa@1-2 pr@2-2 ia@3-5 ib@3-5 p@3-5 eq@3-5 du@3-5"
)

REFUSED = "nothing is accepted that cannot fire"

CONTRADICTED = {
    "alarm_zero_ignored": Contradiction(REFUSED, errors=True),
    "del_by_rule_default_mode": Contradiction(
        "`del_event_rule/1` (by label, or by rule: exactly that rule)", errors=False
    ),
    "not_operator": Contradiction(REFUSED, errors=True),
    "prolog_with_and": Contradiction(REFUSED, errors=True),
    "star_alone": Contradiction(REFUSED, errors=True),
    "check_filter": Contradiction(
        CHECK,
        "a@1-1 b@9-9 ask@10-10 rep(0)@10-10 a@11-11 b@12-12 out@11-12 ask@13-13 rep(0)@13-13",
    ),
    "del_goals_stay": Contradiction("by rule: exactly that rule and its partial matches", "a@1-1 b@2-2"),
    "do_goal_operator_functor": Contradiction(ERROR, "a@1-1 ok@1-1"),
    "dt_less": Contradiction(
        f"{EXACT}; integer, float and datime stamps compare by the instant they name",
        answers={
            9: ["less_datime(datime(2001,1,1,0,0,1),datime(2001,1,1,0,0,2,0))"],
            10: ["less_datime(1,datime(2001,1,1,0,0,2,0))"],
            11: ["less_datime(datime(2001,1,1,0,0,1,0),datime(2001,1,1,0,0,1.0,5))"],
        },
    ),
    "dt_minus_sec": Contradiction(
        DATIME, answers={4: ["datime_minus_sec(datime(2001,3,1,0,0,0),1,datime(2001,2,28,23,59,59))"]}
    ),
    "dt_minus_datime": Contradiction(
        SAME,
        answers={6: ["datime_minus_datime(datime(2001,1,1,0,0,10),datime(2001,1,1,0,0,4,0),6.0)"]},
    ),
    "dt_plus_sec": Contradiction(
        f"{DATIME}; {SAME}",
        answers={
            9: ["datime_plus_sec(datime(2001,1,1,0,0,10),-15,datime(2000,12,31,23,59,55))"],
            10: ["datime_plus_sec(datime(2001,1,1,0,0,10,0),5,datime(2001,1,1,0,0,15,0))"],
        },
    ),
    "during_numeric": Contradiction(
        "`P during Q` | s2 ≤ s1 and e1 ≤ e2",
        "a(1)@2-3 b(1)@1-4 c(1,1)@1-4 a(2)@1-3 b(2)@1-4 c(2,2)@1-4",
    ),
    "during_reversed": Contradiction(EITHER, "b@1-6 a@3-4 c@1-6"),
    "during_unrestricted": Contradiction(
        KEPT,
        "a(1)@3-4 a(2)@2-5 b(3)@1-6 c(1,3)@1-6 c(2,3)@1-6 b(4)@2-5 c(1,4)@2-5 c(2,4)@2-5 "
        "a(5)@3-4 c(5,3)@1-6 c(5,4)@2-5",
    ),
    "event1_same_second": Contradiction(
        "the later is at least 1 ns after the earlier", "a@0-0 b@1e-09-1e-09 c@0-1e-09"
    ),
    "fnot_seq": Contradiction(
        "`P cnot R`, `P fnot R` | P, and no matching R ended before P started",
        "a@1-1 c@2-2 b@3-3 out@1-3 a@4-4 b@5-5",
    ),
    "forall_seq_recent": Contradiction(
        "`P forall_seq Q` | as seq, for all waiting P at once (identical terms too, oldest first)",
        "a(1)@1-1 a(2)@2-2 b(3)@3-3 out(1,3)@1-3 out(2,3)@2-3 b(4)@4-4 a(5)@5-5 b(6)@6-6 out(5,6)@5-6",
    ),
    "gc_general": Contradiction(CLOCK, "a@1-1 b@2-2 out@1-2 a@3-3 b@4-4 out@3-4"),
    "gc_pattern": Contradiction(CLOCK, "a@1-1 b@2-2 out@1-2 out2@1-2"),
    "meets_recent": Contradiction(
        "The completing event is used up with its partner: having matched, it does not wait for others",
        "a(1)@1-4 a(2)@2-4 b(3)@4-6 c(2,3)@2-6 b(4)@4-7 c(1,4)@1-7 a(5)@3-4 b(6)@5-8",
    ),
    "mem_variable_pattern_inactive": Contradiction(
        "Temporary events of the implementation are visible to nobody",
        answers={0: ["findall(A, access_mem(m, A, B), [out, a])"]},
    ),
    "ops_chronological": Contradiction(STARTS, _OPS),
    "ops_recent": Contradiction(STARTS, _OPS),
    "ops_unrestricted": Contradiction(STARTS, _OPS),
    "persistent_event": Contradiction(
        "its sane_note: persistent.txt contains event(out,[..])",
        answers={0: ["exists_file('persistent.txt') -> written = written ; written = missing"]},
    ),
    "prev_int_float_seconds": Contradiction(
        EXACT,
        answers={
            0: [f"prev(m,v(1),{TEN},{TEN},datime(2001,1,1,0,0,10,0))"],
            3: [f"prev(m,v(2),{TWENTY},{TWENTY},datime(2001,1,1,0,0,20,0))"],
        },
    ),
    "reset_db_unlabelled": Contradiction(
        "`reset_db`, `call_gc`: drop all partial matches, of rules with labels and of runs too",
        "a@1-1 o3(0)@1-1 b@2-2",
    ),
    "same_seq_rule_twice_recent": Contradiction(
        "rules do not take partners from each other; identical rules each fire",
        "a(1)@1-1 b@2-2 c(1)@1-2 c(1)@1-2",
    ),
    "starts_numeric": Contradiction(EITHER, "a@1-3 b@1-5 c@1-5 a@3-5 e@1-5 b@1-5"),
    "starts_reversed": Contradiction(EITHER, "b@1-6 a@1-3 c@1-6"),
    "sub_same_id": Contradiction(
        "interface.md: a taken id is an error term; topic and id together are the key",
        outputs=["output(one(1),t,s)"],
        errors=True,
    ),
    "unknown_policy": Contradiction("unknown names and values are errors", "a@1-1 out@1-1 b@2-2"),
    "where_exception": Contradiction(
        ERROR, "a(2)@1-1 one(2)@1-1 three(2)@1-1 a(3)@2-2 one(3)@2-2 three(3)@2-2"
    ),
    "window_subsecond_ignored": Contradiction("fires if e − s ≤ V seconds, exactly", "a@1-1 b@4-4"),
}
