"""What is told of a run costs the same for each message, however many queries wait."""

from types import SimpleNamespace

from retalis import Engine, atom
from retalis.playback.run_recorder import MAX_RECORDED_QUERIES, RunRecorder


class Waiting:
    """A hundred thousand queries; it counts how many of them are looked at."""

    def __init__(self):
        self.looked_at = 0

    def __len__(self):
        return 100_000

    def __iter__(self):
        question = SimpleNamespace(event_of=lambda values: atom("found"))
        for order in range(len(self)):
            self.looked_at += 1
            yield order, question, (), None, None, []


def test_of_many_queries_that_wait_the_first_are_looked_at(monkeypatch):
    engine, told, waiting = Engine(), [], Waiting()
    playback = SimpleNamespace(engine=engine, clock=SimpleNamespace(now=lambda: 5))
    recorder = RunRecorder(playback, told.append)
    monkeypatch.setattr(engine.knowledge, "pending_queries", waiting)
    recorder.update_waits()
    assert waiting.looked_at == MAX_RECORDED_QUERIES
