"""Several programs over one bag, which is read in one pass.

The messages of the bag are read in portions. Each playback processes the messages of its topics in the present
portion and pauses; when all have paused, the next portion is read. A portion is large enough that pauses cost little,
and small enough to be held in memory with its terms.

`SharedTerms` decodes a message once for all playbacks that read it as the same type.
"""

from typing import (
    Any,
    Callable,
    ContextManager,
    Dict,
    Iterator,
    List,
    NamedTuple,
    Sequence,
    Set,
    Tuple,
    Union,
)

from ..foundation.ros_name_checks import strip_slashes
from ..messages.decoder import Decoder
from ..node.subscribed_topics import MessageHandler
from ..node.transport import MessageSource
from ..prolog.terms.types import Term
from .bag_locations import Bag
from .playback import Output, Pause, Playback, ReadRecords
from .rosbag1 import Record

PORTION_MESSAGES = 200

PORTION_BYTES = 1 << 20
"""Number of bytes of messages after which a portion ends."""


class SharedTerms:
    """Terms of the messages of a portion, by the function that decodes them.

    Stamps that jump are not reported: observing them takes several times as long as decoding small messages.
    """

    def __init__(self) -> None:
        self._terms: Dict[Callable[[bytes], Term], Dict[int, Tuple[bytes, Term]]] = {}

    def make_handler(self, decoder: Decoder, topic: str, source: MessageSource) -> MessageHandler:
        """Return a function from a message to its event and the event's instant; see `HandlerFactory`."""
        unobserved = decoder.plain or decoder
        decode, stamp = unobserved.decode, unobserved.stamp
        terms = self._terms.setdefault(decode, {})
        find_term = terms.get

        def handle(data: bytes) -> Tuple[Term, Any]:
            # Hashing the bytes may take longer than decoding them. The entry keeps them, so that no other bytes get
            # the same identity.
            key = id(data)
            entry = find_term(key)
            if entry is None:
                entry = terms[key] = (data, decode(data))
            return entry[1], stamp(data)

        return handle

    def clear(self) -> None:
        """Forget the terms, because another portion begins."""
        for terms in self._terms.values():
            terms.clear()


class _Portions:
    """Messages of a bag in portions, which several playbacks read."""

    def __init__(self, bag: Bag):
        self._bag = bag
        self._topics: Set[str] = set()
        self._stream: Iterator[Record] = iter(())
        self._is_open = self._is_last = False
        self._records: List[Record] = []
        self._time = bag.start

    def read(self, topics: Set[str]) -> Iterator[Union[Record, Pause]]:
        """Yield the messages of topics, with a pause before each portion; see `ReadRecords`."""
        self._topics |= topics
        names = set(map(strip_slashes, topics))
        identities = {id(topic) for topic in self._bag.topics if strip_slashes(topic.name) in names}
        while not self._is_last:
            yield Pause(self._time)
            for record in self._records:
                if id(record.topic) in identities:
                    yield record

    def advance(self) -> None:
        """Read the next portion."""
        if not self._is_open:
            # Now the topics of all playbacks are known.
            self._is_open = True
            self._stream = iter(self._bag.records(self._topics))
        self._records = []
        size = 0
        for record in self._stream:
            self._records.append(record)
            size += len(record.data)
            self._time = record.time
            if len(self._records) == PORTION_MESSAGES or size >= PORTION_BYTES:
                return
        self._is_last = True


class SharedRun(NamedTuple):
    """A playback, and the context in which it runs, such as the receiver of its log."""

    playback: Playback
    enter: Callable[[], ContextManager[object]]


def run_together(runs: Sequence[SharedRun], bag: Bag, terms: SharedTerms) -> Iterator[Tuple[int, Output]]:
    """Run several playbacks over a bag in one pass; yield each output with the number of its playback.

    The outputs and reports of each playback are those of `Playback.run`, except warnings about the program itself and
    about stamps that jump.

    Args:
        runs: the playbacks; `SharedTerms.make_handler` may be their handler.
        bag: the bag.
        terms: terms that the playbacks share.

    Raises:
        Exception: that of the first of the playbacks that fail, when those before it have ended.
    """
    portions = _Portions(bag)
    read: ReadRecords = portions.read
    running = {number: run.playback.run_in_steps(bag, read) for number, run in enumerate(runs)}
    errors: Dict[int, Exception] = {}
    while running and min(running) < min(errors, default=len(runs)):
        for number, steps in list(running.items()):
            outputs: List[Output] = []
            with runs[number].enter():
                try:
                    # None is a pause; a run that has ended is no longer an iterator with a value.
                    for output in steps:
                        if output is None:
                            break
                        outputs.append(output)
                    else:
                        del running[number]
                except Exception as error:
                    errors[number] = error
                    del running[number]
            yield from ((number, output) for output in outputs)
        terms.clear()
        portions.advance()
    if errors:
        raise errors[min(errors)]
