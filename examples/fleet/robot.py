"""Engine of one robot for a stream processor: events in, outputs out, and a state that can be stored."""

from pathlib import Path

from retalis import Engine, RetalisError, StreamClock

PROGRAM = Path(__file__).resolve().parent


class Robot:
    """The engine of one robot.

    Args:
        state: result of `snapshot`, to resume from; None for a new robot.
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
        """Return the state, from which another process can resume."""
        return {"engine": self._engine.snapshot(), "made": self._made}

    def take(self, time, event=None):
        """Advance the time to `time` seconds, process an event if there is one, and return the outputs."""
        self._clock.move_to(round(time * 1e9))
        self._engine.advance()
        if event is not None:
            try:
                self._engine.event(event, time)
            except RetalisError as error:  # raised, the error would end the dataflow, also after each restart
                self._make("errors", str(error))
        outputs, self._outputs = self._outputs, []
        return outputs

    def _make(self, topic, text):
        """Store an output with its number, by which receivers recognize repetitions."""
        self._made += 1
        self._outputs.append({"number": self._made, "topic": topic, "output": text})
