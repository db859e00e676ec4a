"""A program over a bag, without ROS: what the nodes give live, from the same messages, in the bag's time."""

from pathlib import Path
from typing import Any, Callable, Dict, Iterable, List, NamedTuple, Optional, Union

from .bags import BagReader, Topic
from .clock import StreamClock
from .engine import Engine, Settings
from .errors import MessageError, ProgramErrors, RetalisError
from .messages import Decoder, Definition, Definitions
from .program import TOPICS, TopicType, read_topics
from .terms import Term

Report = Callable[[RetalisError], None]


class Output(NamedTuple):
    """A message that a program published.

    Attributes:
        topic: the topic as the subscription names it.
        term: the message as a term.
        time: the bag's time at which it was published, in nanoseconds.
        definition: its type; None where ``pub_sub.xml`` gives the topic none.
        data: the message; None where the term does not fit the type.
    """

    topic: str
    term: Term
    time: int
    definition: Optional[Definition]
    data: Optional[bytes]


class Playback:
    """One program that is fed from bags.

    Args:
        program: the program's folder.
        report: takes each error that does not end the run: a wrong goal, a message that does not fit.
        topics: topics that become events besides those in ``pub_sub.xml``.
        settings: of the engine.

    Raises:
        UsageError: where a file of the program cannot be read.
    """

    def __init__(
        self,
        program: Union[str, Path],
        report: Report,
        topics: Iterable[TopicType] = (),
        settings: Optional[Settings] = None,
    ):
        folder = Path(program)
        self.clock = StreamClock()
        self.engine = Engine(self.clock, Settings() if settings is None else settings)
        self.definitions = Definitions()
        self._report = report
        self._decoders: Dict[Topic, Optional[Decoder]] = {}
        self._outputs: List[Output] = []
        named = read_topics(folder / TOPICS)
        self._types = {_plain(topic): kind for topic, kind in (*named.subscribed, *topics)}
        self._published = {_plain(topic): kind for topic, kind in named.published}
        self.engine.on_output(self._collect)
        try:
            self.engine.load_program(folder)
        except ProgramErrors as errors:
            for error in errors.errors:
                report(error)

    def run(self, bag: BagReader, progress: Callable[[int], Any] = lambda done: None) -> Iterable[Output]:
        """Feed a bag and yield what the program publishes, as it does.

        Args:
            bag: the messages, in the order of their receipt.
            progress: called with the number of messages read so far, after each.
        """
        clock, outputs = self.clock, self._outputs
        for topic in bag.topics:
            if _plain(topic.name) in self._types:
                self._learn(topic)
        wanted = {topic.name for topic in bag.topics if _plain(topic.name) in self._types}
        decoders = {id(topic): self._decoders.get(topic) for topic in bag.topics}
        for done, (topic, instant, data) in enumerate(bag.records(wanted), 1):
            clock.move_to(instant, back=True)
            decoder = decoders[id(topic)]
            if decoder is not None:
                self._post(decoder, data)
            progress(done)
            if outputs:
                yield from outputs
                outputs.clear()
        clock.move_to(bag.end)
        self.engine.advance()
        yield from outputs
        outputs.clear()

    def _post(self, decoder: Decoder, data: bytes) -> None:
        try:
            self.engine.post(decoder.decode(data), decoder.stamp(data))
        except MessageError as error:
            self._report(error)

    def _learn(self, topic: Topic) -> None:
        """Note the decoder for a connection, under the type that the program gives the topic."""
        kind = self._types[_plain(topic.name)]
        try:
            definition = self.definitions.received(kind, topic.type, topic.definition, topic.md5sum)
            self._decoders[topic] = self.definitions.decoder(definition)
        except MessageError as error:
            self._decoders[topic] = None
            self._report(MessageError(f"topic {topic.name}: {error.message}", error.place))

    def _collect(self, term: Term, topic: str, name: Term) -> None:
        kind = self._published.get(_plain(topic))
        definition = data = None
        try:
            if kind is None:
                raise MessageError(f"topic {topic} has no type: {TOPICS} has no <publish_to> of that name")
            definition = self.definitions.find(kind)
            data = self.definitions.encoder(definition).encode(term, topic)
        except MessageError as error:
            self._report(error)
        self._outputs.append(Output(topic, term, self.clock.now(), definition, data))


def _plain(topic: str) -> str:
    return topic.lstrip("/")
