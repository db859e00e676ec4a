"""What must not have happened: what is kept of it."""

from events.running import Program, fired

from retalis.events.absence import Absence


def test_keys_under_which_nothing_waits_any_more_are_forgotten():
    program = Program("d(X) <- (a(X) seq b(X)) cnot c(X) within 5.")
    for number in range(3000):
        program.feed(f"c({number})@{number}")
    (rule,) = program.engine.rules.rules
    (absence,) = (
        absence
        for node, _, _ in rule.nodes
        for absence in getattr(node, "absences", ())
        if isinstance(absence, Absence)
    )
    assert len(absence.place.newest) < 10
    assert len(absence._borders) < 1100
    assert program.feed("a(1)@3000 a(2)@3000 c(1)@3001 b(1)@3002 b(2)@3002") == "d(2)@3000-3002"


def test_an_absence_inside_a_negated_pattern_may_look_at_what_is_outside():
    rule = "s(Y) <- (p(Y) seq b) cnot (x fnot q(Y))."
    assert fired(rule, "p(1)@1 b@5") == "s(1)@1-5"
    assert fired(rule, "p(1)@1 x@3 b@5") == ""
    assert fired(rule, "p(1)@1 q(2)@2 x@3 b@5") == ""
    assert fired(rule, "p(1)@1 q(1)@2 x@3 b@5") == "s(1)@1-5"
    rule = "s(Y) <- b(Y) fnot (x fnot q(Y))."
    assert fired(rule, "b(1)@5") == "s(1)@5-5"
    assert fired(rule, "x@3 b(1)@5") == ""
    assert fired(rule, "q(2)@2 x@3 b(1)@5") == ""
    assert fired(rule, "q(1)@2 x@3 b(1)@5") == "s(1)@5-5"
