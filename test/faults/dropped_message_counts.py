"""Numbers of dropped messages on /diagnostics, with the parts of the stream in which they are dropped."""

from typing import Any, Dict, List, NamedTuple, Set, Tuple

COUNTERS = ("dropped", "refused", "missing", "dropped events")
"""The values of a status that count messages or events."""

IGNORED_STATUSES = "input /camera", "input /input_"
"""Beginnings of statuses of topics that no pose needs."""


class Drop(NamedTuple):
    """A growth of a counter.

    Attributes:
        status: the node and the status.
        number: the growth.
        first: earliest stamp of a dropped message in the stream, in seconds.
        last: latest stamp of a dropped message.
    """

    status: str
    number: int
    first: float
    last: float


class Drops:
    """The counters of the nodes, including their restarts.

    A message that is dropped between two messages of /diagnostics has no pose at the first of them, so that a `Drop`
    begins there.

    Attributes:
        growths: each growth of a counter.
        report_counts: the number of messages of each node.
    """

    def __init__(self) -> None:
        self.growths: List[Drop] = []
        self.report_counts: Dict[str, int] = {}
        self._counts: Dict[Tuple[str, str], int] = {}
        self._through: Dict[str, float] = {}

    @property
    def total(self) -> int:
        return sum(drop.number for drop in self.growths)

    def add(self, stamp: float, through: float, statuses: Any) -> None:
        """Add the statuses of a message.

        Args:
            stamp: the stamp that is sent now.
            through: the newest stamp of a received pose.
            statuses: the name of each status, and its pairs of keys and values.
        """
        nodes: Set[Any] = set()
        for name, values in statuses:
            node = name.partition(": ")[0]
            nodes.add(node)
            for key, value in values:
                if key in COUNTERS:
                    self._count(stamp, node, name, key, int(value))
        for node in nodes:
            self.report_counts[node] = self.report_counts.get(node, 0) + 1
            self._through[node] = through

    def _count(self, stamp: float, node: str, name: str, key: str, value: int) -> None:
        if name[len(node) + 2 :].startswith(IGNORED_STATUSES):
            return
        before = self._counts.get((name, key), 0)
        self._counts[name, key] = value
        growth = value - before if value >= before else value  # smaller: the node or the topic is restarted
        if growth:
            self.growths.append(Drop(name, growth, self._through.get(node, 0.0), stamp))
