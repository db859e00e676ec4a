"""What the nodes say on /diagnostics that they have dropped, and during which part of the stream."""

from typing import Dict, NamedTuple, Tuple

COUNTERS = ("dropped", "refused", "missing", "dropped events")
"""The values of a status that count messages or events."""

APART = "input /camera", "input /input_"
"""The beginnings of statuses of topics that no pose needs."""


class Drop(NamedTuple):
    """A counter that has grown.

    Attributes:
        what: the node and the status.
        number: by how many.
        first: the stream's stamp, in seconds, before which nothing of what was dropped was sent.
        last: the one after which nothing of it was.
    """

    what: str
    number: int
    first: float
    last: float


class Drops:
    """Follows the counters of the nodes, over all their lives.

    What is dropped between two looks had not come through at the first of them: there is where a `Drop` begins.

    Attributes:
        found: each growth of a counter.
        looks: how often each node has told.
    """

    def __init__(self) -> None:
        self.found = []
        self.looks: Dict[str, int] = {}
        self._counts: Dict[Tuple[str, str], int] = {}
        self._through: Dict[str, float] = {}

    @property
    def total(self) -> int:
        return sum(one.number for one in self.found)

    def take(self, stamp: float, through: float, statuses) -> None:
        """Take the statuses of a message.

        Args:
            stamp: what is sent now.
            through: up to where poses have come.
            statuses: of each, its name and pairs of keys and values.
        """
        nodes = set()
        for name, values in statuses:
            node = name.partition(": ")[0]
            nodes.add(node)
            for key, value in values:
                if key in COUNTERS:
                    self._count(stamp, node, name, key, int(value))
        for node in nodes:
            self.looks[node] = self.looks.get(node, 0) + 1
            self._through[node] = through

    def _count(self, stamp: float, node: str, name: str, key: str, value: int) -> None:
        if name[len(node) + 2 :].startswith(APART):
            return
        before = self._counts.get((name, key), 0)
        self._counts[name, key] = value
        grown = value - before if value >= before else value  # smaller: the node or the topic is a new one
        if grown:
            self.found.append(Drop(name, grown, self._through.get(node, 0.0), stamp))
