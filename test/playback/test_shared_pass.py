"""Several playbacks over a bag in one pass: their outputs and reports, and shared decoding."""

import logging
from contextlib import contextmanager
from copy import copy
from pathlib import Path
from shutil import copytree
from typing import Any, Iterator, List, Sequence, Tuple

import pytest
from node.equivalence_bags import BAGS, BagSpecification, write_bag

from retalis import BagReader, BagWriter, Definitions, Playback
from retalis.node.transport import MessageSource
from retalis.playback import shared_pass
from retalis.playback.shared_pass import SharedRun, SharedTerms, run_together

PROGRAM = Path(__file__).resolve().parents[1] / "node" / "equivalence_program"
DEFINITIONS = Definitions()
NUMBER = DEFINITIONS.add("test_msgs/Number", "int64 x")
TEXTS = DEFINITIONS.add("test_msgs/Texts", "string[] texts\nint64 x")

RULES = {
    "old": "hot(X) <- number(X) where X > 3.\nlate(X) <- absent(hot(X), number(_), 2).",
    "new": "hot(X) <- number(X) where X > 5.\nsaid(T) <- texts(T, _).\nmore(X) <- texts(_, X) seq other(X).",
}
TOPICS = {
    "old": [("number", NUMBER.name, "number")],
    "new": [("number", NUMBER.name, "number"), ("texts", TEXTS.name, "texts")],
}
GOALS = {
    "old": ["subscribe(hot(_), [], _, alarms, a)", "subscribe(late(_), [], _, alarms, b)"],
    "new": [
        "subscribe(hot(_), [], _, alarms, a)",
        "subscribe(speech(_), [], _, alarms, b)",
        "subscribe(more(_), [], _, alarms, c)",
    ],
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with two programs and a bag of numbers, texts, other numbers, and a malformed message."""
    for version, rules in RULES.items():
        folder = tmp_path / version
        folder.mkdir()
        topics = "".join(
            f'<subscribe_to name="{name}" msg_type="{message_type}" event="{event}"/>'
            for name, message_type, event in TOPICS[version]
        )
        # The outputs do not fit this type, which is reported.
        topics += f'<publish_to name="alarms" msg_type="{NUMBER.name}"/>'
        (folder / "pub_sub.xml").write_text(f"<publish_subscribe>{topics}</publish_subscribe>")
        goals = "\n".join(["compile_event_file('eventRules.txt')", *GOALS[version], ""])
        (folder / "goalPredicates.txt").write_text(goals)
        (folder / "eventRules.txt").write_text(rules + "\n")
    # A topic that a goal requests during the bag.
    with (tmp_path / "new" / "eventRules.txt").open("a") as file:
        file.write("joined <- number(4) do subscribe_to(other, 'test_msgs/Number', other).\n")
    with BagWriter(tmp_path / "some.bag") as bag:
        numbers, texts, others = (
            bag.add(name, definition)
            for name, definition in (("/number", NUMBER), ("/texts", TEXTS), ("/other", NUMBER))
        )
        for second in range(1, 30):
            data = (second % 8).to_bytes(8, "little")
            bag.write(numbers, second * 10**9, data if second != 20 else b"")
            if second % 3:
                text = f"text {second}".encode()
                size = len(text).to_bytes(4, "little")
                bag.write(texts, second * 10**9, b"\1\0\0\0" + size + text + data)
                bag.write(others, second * 10**9 + 5, data)
    return tmp_path


class Version:
    """A version of the program, with the log of its run."""

    def __init__(self, folder: Path, bag: BagReader, *arguments: Any):
        self.log: List[str] = []
        with self.enter():
            self.playback = Playback(
                folder,
                lambda error: self.log.append(str(error)),
                (),
                None,
                None,
                bag,
                None,
                "auto",
                DEFINITIONS,
                *arguments,
            )

    @contextmanager
    def enter(self) -> Iterator[None]:
        handler = logging.Handler(logging.INFO)
        handler.emit = lambda record: self.log.append(record.getMessage())  # type: ignore[method-assign]
        logger = logging.getLogger("retalis")
        logger.addHandler(handler)
        try:
            yield
        finally:
            logger.removeHandler(handler)


Result = Tuple[List[Any], List[str]]


def run_separately(folder: Path, versions: Sequence[str]) -> List[Result]:
    results = []
    for name in versions:
        with BagReader(folder / "some.bag") as bag:
            version = Version(folder / name, bag)
            # Warnings about the programs are not repeated.
            version.playback.log_mistakes()
            with version.enter():
                outputs = list(version.playback.run(bag))
            results.append((outputs, version.log))
    return results


def run_shared(folder: Path, names: Sequence[str]) -> List[Result]:
    terms = SharedTerms()
    with BagReader(folder / "some.bag") as bag:
        versions = [Version(folder / name, bag, lambda engine: None, terms.make_handler) for name in names]
        outputs: List[List[Any]] = [[] for _ in versions]
        runs = [SharedRun(version.playback, version.enter) for version in versions]
        for number, output in run_together(runs, bag, terms):
            outputs[number].append(output)
    return [(list(outputs[number]), version.log) for number, version in enumerate(versions)]


@pytest.mark.parametrize("portion", [1, 2, 7, 1000])
@pytest.mark.parametrize("versions", [("old", "new"), ("new", "old"), ("new", "new")])
def test_results_are_those_of_separate_runs(
    folder: Path, versions: Sequence[str], portion: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shared_pass, "PORTION_MESSAGES", portion)
    expected = run_separately(folder, versions)
    assert run_shared(folder, versions) == expected
    assert all(len(outputs) > 10 and any("dropped" in line for line in log) for outputs, log in expected)


@pytest.mark.parametrize("specification", [BAGS[5], BAGS[6], BAGS[7]], ids=lambda bag: bag.name)
def test_outputs_for_stamped_messages_are_equal(specification: BagSpecification, tmp_path: Path) -> None:
    for version in ("old", "new"):
        copytree(PROGRAM, tmp_path / version)
    write_bag(tmp_path / "some.bag", 0, specification)
    separate, shared = (run(tmp_path, ("old", "new")) for run in (run_separately, run_shared))
    assert [outputs for outputs, _ in separate] == [outputs for outputs, _ in shared]
    assert separate[0][0]


def test_message_is_decoded_once_in_a_portion() -> None:
    decoded: List[bytes] = []
    decoder = copy(DEFINITIONS.decoder(TEXTS))
    decode = decoder.decode

    def decode_and_count(data: bytes) -> Any:
        decoded.append(data)
        return decode(data)

    decoder.decode = decode_and_count
    terms = SharedTerms()
    handlers = [terms.make_handler(decoder, "/texts", MessageSource("", TEXTS.name)) for _ in range(2)]
    data = bytes(12)
    first, second = (handler(data)[0] for handler in handlers)
    assert first is second
    assert len(decoded) == 1
    terms.clear()
    handlers[0](data)
    assert len(decoded) == 2
