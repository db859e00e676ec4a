"""One robot's engine as a stream engine wants it: events go in, outputs come out, and its state is bytes."""

from pathlib import Path

from retalis import Engine, RetalisError, StreamClock

PROGRAM = Path(__file__).resolve().parent


class Robot:
    """The engine of one robot.

    Args:
        state: what `snapshot` has returned, to go on from there; a robot that is new has none.
    """

    def __init__(self, state=None):
        self._clock = StreamClock()
        if state is None:
            self._engine, self._made = Engine(self._clock), 0
            self._engine.load_program(PROGRAM)
        else:
            self._engine, self._made = Engine.restore(state["engine"], clock=self._clock), state["made"]
        self._outputs = []
        self._engine.on_output(lambda term, topic, name: self._make(topic, self._engine.show(term)))

    def snapshot(self):
        """Return all that it is, for another process to go on from."""
        return {"engine": self._engine.snapshot(), "made": self._made}

    def take(self, time, event=None):
        """Let time pass, and take an event if there is one; return what has come out."""
        self._clock.move_to(round(time * 1e9))
        self._engine.advance()
        if event is not None:
            try:
                self._engine.event(event, time)
            except RetalisError as error:  # raised, it would end the dataflow, and again after each restart
                self._make("errors", str(error))
        outputs, self._outputs = self._outputs, []
        return outputs

    def _make(self, topic, text):
        """Keep an output, with its number: who gets it twice, on a way that repeats, knows it by that."""
        self._made += 1
        self._outputs.append({"number": self._made, "topic": topic, "output": text})
