"""Output of goals to ``user_output`` and ``user_error``: escapes for control characters, and the limit of output."""

from pathlib import Path
from typing import List, Optional

import pytest

from retalis import Engine, Limits, PrologError, Settings


class PrintingEngine(Engine):
    """An engine that records what goals write.

    Attributes:
        output: Texts written to ``user_output``.
        error_output: Texts written to ``user_error``.
    """

    def __init__(self, output_megabytes: Optional[float] = Limits().output_megabytes) -> None:
        super().__init__(settings=Settings(limits=Limits(output_megabytes=output_megabytes)))
        self.output: List[str] = []
        self.error_output: List[str] = []
        self.logic.print_to(self.output.append, self.error_output.append)

    @property
    def written_bytes(self) -> int:
        """Number of bytes written to both streams."""
        return sum(len(text.encode()) for text in (*self.output, *self.error_output))


@pytest.fixture
def engine() -> PrintingEngine:
    return PrintingEngine()


@pytest.mark.parametrize(
    "goal",
    [
        "write('\\e[2J')",
        "print_message_lines(user_output, '', ['\\e[2J'-[]])",
        "format(\"~a~s\", ['\\e', [91, 50, 74]])",
        "format(user_output, \"~w\", ['\\e[2J'])",
        "put_char('\\e'), write('[2J')",
        "write_term('\\e[2J', [])",
        "write_canonical('\\e[2J')",
        "tell(user), write('\\e[2J'), told",
    ],
)
def test_escape_characters_are_replaced_in_output(engine: PrintingEngine, goal: str) -> None:
    engine.query(goal)
    text = "".join(engine.output)
    assert "\x1b" not in text
    assert "\\x1b[2J" in text or "\\x1B\\[2J" in text


@pytest.mark.parametrize(
    "goal",
    [
        "write(user_error, '\\e[2J')",
        "print_message(error, format(\"~w\", ['\\e[2J']))",
        "debug(t), debug(t, \"~w\", ['\\e[2J'])",
        "format(user_error, \"~w\", ['\\e[2J'])",
    ],
)
def test_escape_characters_are_replaced_in_user_error(engine: PrintingEngine, goal: str) -> None:
    engine.query(goal)
    assert "\\x1b[2J" in "".join(engine.error_output)
    assert "\x1b" not in "".join(engine.error_output)


def test_rule_output_has_no_escape_characters(engine: PrintingEngine) -> None:
    engine.load(rules="null_event do (write(X), nl) <- in(X).")
    engine.event("in('\\e[31m\\x202e\\')", 1)
    assert "".join(engine.output) == "\\x1b[31m\\u202e\n"


def test_printable_text_is_written_unchanged(engine: PrintingEngine) -> None:
    engine.query("write('a\\tb é 日本'), nl, write([1,'x y'])")
    assert "".join(engine.output) == "a\tb é 日本\n[1,x y]"


def test_captured_output_and_files_keep_escapes(tmp_path: Path) -> None:
    engine = Engine(settings=Settings(write_folders=(str(tmp_path),)))
    answer = engine.query("with_output_to(codes(C), write('\\e[2J'))")
    assert engine.show(answer[0]["C"]) == "[27,91,50,74]"
    path = tmp_path / "out.txt"
    engine.query(f"open('{path}', write, S), write(S, '\\e[2J'), close(S)")
    assert path.read_bytes() == b"\x1b[2J"


@pytest.mark.slow
@pytest.mark.parametrize(
    "goal", ["repeat, format('~*c~n', [1000, 0'x]), fail", "repeat, write(user_error, 'é\\e'), fail"]
)
def test_endless_output_ends_at_one_megabyte(goal: str) -> None:
    engine = PrintingEngine()
    with pytest.raises(PrologError, match="Not enough resources: output"):
        engine.query(goal)
    assert 990_000 < engine.written_bytes <= 1_000_000
    assert engine.call("write(x)")


def test_text_beyond_limit_is_not_written() -> None:
    engine = PrintingEngine(0.001)
    with pytest.raises(PrologError, match="output"):
        engine.query("format('~*c', [1001, 0'x])")
    assert engine.written_bytes == 0


def test_handler_may_write_a_tenth_more() -> None:
    engine = PrintingEngine(0.1)
    writes = "repeat, write(aaaaaaaaaa), fail"
    goal = f"catch(({writes}), error(resource_error(output), _), ({writes}))"
    with pytest.raises(PrologError, match="output"):
        engine.query(goal)
    assert 100_000 < engine.written_bytes <= 110_000


def test_output_limit_holds_per_event(caplog: pytest.LogCaptureFixture) -> None:
    engine = PrintingEngine(0.01)
    engine.load(
        rules="a(X) <- in(X).\nb(X) <- in(X).\nnull_event do format('~*c', [4000, 0'x]) <- a(_).\n"
        "null_event do format('~*c', [4000, 0'x]) <- b(_).\nnull_event do format('~*c', [4000, 0'x]) <- in(2)."
    )
    engine.event("in(1)", 1)
    engine.event("in(1)", 2)
    assert engine.written_bytes == 16_000
    assert not caplog.records
    engine.event("in(2)", 3)
    assert engine.written_bytes == 24_000
    assert caplog.text.count("Not enough resources: output") == 1


def test_cleanup_beyond_output_limit_is_ended() -> None:
    engine = PrintingEngine(0.001)
    with pytest.raises(PrologError, match="output"):
        engine.query(
            "setup_call_cleanup(true, format('~*c', [999, 0'x]), (repeat, write(y), fail)), write(zzzzz)"
        )
    assert 999 < engine.written_bytes <= 1100
    assert engine.call("write(x)")


def test_output_without_limit_is_written() -> None:
    engine = PrintingEngine(None)
    engine.query("between(1, 300, _), format('~*c', [10000, 0'x]), fail ; true")
    assert engine.written_bytes == 3_000_000
