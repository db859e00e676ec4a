"""Driver of an engine in tests."""

from pathlib import Path

from retalis.testing.engine_driver import EngineDriver


def test_alarms_fire_at_their_own_times() -> None:
    driver = EngineDriver()
    driver.load("silent <- hello seq absent(hello, 5).")
    driver.event("hello", 1)
    driver.event("hello", 20)
    driver.advance(30)
    assert driver.events == ["hello", "silent", "hello", "silent"]


def test_outputs_have_their_topics() -> None:
    driver = EngineDriver()
    driver.load("a(X) <- b(X).", "subscribe(a(X), [], X, t, s)\nmemorize(b(_), [], _, m, 3)")
    driver.event("b(1)", 1)
    driver.event("b(2)", at=3, start=2)
    assert driver.outputs == ["t: 1", "t: 2"]
    assert driver.events == ["b(1)", "a(1)", "b(2)", "a(2)"]
    driver.clear()
    assert (driver.events, driver.outputs) == ([], [])


def test_errors_of_a_program_are_collected(tmp_path: Path) -> None:
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe/>")
    (tmp_path / "goalPredicates.txt").write_text("memorise(b)\n")
    driver = EngineDriver(tmp_path)
    (error,) = driver.problems.errors
    assert f"{tmp_path}/goalPredicates.txt:1:1: " in error
