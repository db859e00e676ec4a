"""Lineage of events: their justifications, and forgotten events."""

import gc
from typing import Any, List

import pytest
from events.program_runner import ProgramRunner, format_events, outputs_of

from retalis.events.matches import match_limit
from retalis.events.matches.match_types import RepetitionChain
from retalis.events.network import lineage_tracker
from retalis.events.network.lineage_graph import Occurrence


@pytest.mark.parametrize("policy", ["recent", "chronological", "unrestricted"])
@pytest.mark.parametrize("flag", ["revision_flag", "etalis_justification"])
def test_lineage_keeps_outputs(policy: str, flag: str) -> None:
    rules = (
        "c(X) <- (a(X) and b) seq d. n(N) <- c(_) seq aggregate(count, a(_), N). x <- (a(1) seq d) cnot b."
    )
    stream = "a(1)@1 b@2 a(2)@3 d@4 b@5 a(1)@6 d@7 d@8"
    assert outputs_of(rules, stream, policy, [flag]) == outputs_of(rules, stream, policy)


def explanations_of(program: Any, event: str) -> List[Any]:
    answers = program.engine.query(f"justify_event({event},_,J)")
    return [program.engine.show(answer["J"]) for answer in answers]


def test_event_has_explanation() -> None:
    program = ProgramRunner("m <- a seq b. r : c <- m.", ["etalis_justification"])
    program.feed("a@1 b@2")
    (explanation,) = explanations_of(program, "c")
    assert explanation == (
        "justification(r,head(c,[1,2]),justification(unlabeled,head(m,[1,2]),seqf("
        "justification(unlabeled,head(a,[1,1]),default),justification(unlabeled,head(b,[2,2]),default))))"
    )


def test_missing_event_has_explanation() -> None:
    program = ProgramRunner("c <- a seq b where (1 < 2).", ["etalis_justification"])
    program.feed("a@1")
    (explanation,) = explanations_of(program, "c")
    assert "wheref" in explanation
    assert "head(a,[1,1]),default" in explanation
    assert "head(b," in explanation
    assert explanation.count("),failed)") == 1


def test_event_without_rule_has_explanation() -> None:
    program = ProgramRunner("c <- c seq c.", ["etalis_justification"])
    (explanation,) = explanations_of(program, "zzz")
    assert explanation.startswith("[justification(unlabeled,head(zzz,")
    assert explanation.endswith("),failed)]")
    assert len(explanations_of(program, "c")) == 1


def test_justification_may_be_enabled_later() -> None:
    program = ProgramRunner("c <- a seq b.")
    program.feed("a@1")
    program.set("etalis_justification", "on")
    assert program.feed("b@2 a@3 b@4") == "c@1-2 c@3-4"
    assert len(program.engine.query("justification_edge(_,_)")) == 2


def test_forgotten_event_collects_no_derived_events(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lineage_tracker, "MAX_REMEMBERED_EVENTS", 20)
    program = ProgramRunner("c <- a seq b.", ["revision_flag"], "unrestricted")
    program.feed("a@1")
    (oldest,) = program.engine.rules.network.tracker.remembered_events()
    program.feed("b@2")
    assert len(oldest.derived) == 1
    assert program.feed(" ".join(f"b@{instant}" for instant in range(3, 40))).count("c@") == 37
    assert oldest.derived == []
    assert program.feed("rev(a)@50") == ""


def test_forgotten_events_keep_no_sources(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lineage_tracker, "MAX_REMEMBERED_EVENTS", 20)
    program = ProgramRunner("n(M) <- n(N) seq tick where M is N + 1.", ["etalis_justification"], "recent")
    program.feed("n(0)@0 tick@1")
    derived = program.engine.rules.network.tracker.remembered_events()[-1]
    assert [format_events([(source.term, 0, 0)]) for source in derived.sources()] == ["n(0)@0-0", "tick@0-0"]
    program.feed(" ".join(f"tick@{instant}" for instant in range(2, 30)))
    assert derived.forgotten
    assert derived.sources() == []


def count_occurrences() -> int:
    gc.collect()
    return sum(type(item) is Occurrence for item in gc.get_objects())


def test_forgotten_events_of_a_chain_are_freed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lineage_tracker, "MAX_REMEMBERED_EVENTS", 20)
    # Matches that have left their buffers remain in the list of arrivals up to this number, with their events.
    monkeypatch.setattr(match_limit, "STALE_ARRIVALS_TOLERANCE", 0)
    program = ProgramRunner("n(M) <- n(N) seq tick where M is N + 1.", ["etalis_justification"], "recent")
    program.feed("n(0)@0 " + " ".join(f"tick@{instant}" for instant in range(1, 50)))
    occurrence_count = count_occurrences()
    program.feed(" ".join(f"tick@{instant}" for instant in range(50, 300)))
    assert count_occurrences() == occurrence_count


@pytest.mark.parametrize(
    "rule",
    [
        "c <- (a seq b(_)) and d.",
        "c <- e seq (a seq b(_)) star_times.",
        "c(N) <- aggregate(count, a seq b(_), N, last(3, events)).",
        "c <- e fnot (a seq b(_)).",
    ],
)
def test_forgotten_event_has_no_dependents(rule: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lineage_tracker, "MAX_REMEMBERED_EVENTS", 20)
    program = ProgramRunner(rule, ["revision_flag"], "unrestricted")
    program.feed("e@0 a@1")
    event = program.engine.rules.network.tracker.remembered_events()[-1]
    program.feed("b(2)@2 " + " ".join(f"x@{instant}" for instant in range(3, 50)))
    assert event.forgotten
    program.feed(" ".join(f"b({instant})@{instant} e@{instant}.5" for instant in range(50, 60)))
    assert (event.dependents, event.derived, event.suppressed) == ([], [], [])


@pytest.mark.parametrize("pattern", ["s seq aggregate(count, a(_), N)", "(s seq a(_) star_times) and b(N)"])
def test_lineage_of_repetitions_is_linear(pattern: str) -> None:
    program = ProgramRunner(f"c(N) <- {pattern}.", ["etalis_justification"], "unrestricted")
    program.feed("s@0 b(7)@0 " + " ".join(f"a({second})@{second}" for second in range(1, 301)))
    events = program.engine.rules.network.tracker.remembered_events()
    links: List[Any] = [
        *events,
        *(chain for event in events for chain in event.derived if isinstance(chain, RepetitionChain)),
    ]
    assert len(events) > 600
    assert sum(len(link.derived) + len(link.dependents) for link in links) < 4000
