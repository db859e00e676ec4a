"""Limit of the number of partial matches."""

from events.program_runner import ProgramRunner


def test_match_limit_drops_oldest() -> None:
    program = ProgramRunner(policy="chronological")
    program.engine.rules.network.limit_stored(3)
    program.engine.load(rules="c(X) <- a(X) seq b.")
    program.feed(" ".join(f"a({i})@{i}" for i in range(10)))
    assert program.engine.rules.match_count == 3
    assert program.feed("b@20") == "c(7)@7-20"
    assert "partial matches" in str(program.warnings[0])
