"""An engine that remembers what happened, as text."""

from retalis.engine import Engine, Settings


class Watched(Engine):
    """An engine whose outputs and events are kept as text."""

    def __init__(self, rules="", goals="", clock=None, **settings):
        super().__init__(clock, Settings(**settings))
        self.outputs, self.events = [], []
        self.on_output(
            lambda term, topic, name: self.outputs.append((self.show(term), topic, self.show(name)))
        )
        self.on_event(lambda term, start, end: self.events.append((self.show(term), int(start), int(end))))
        self.load(rules=rules, goals=goals)
