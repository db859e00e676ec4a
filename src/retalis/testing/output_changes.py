"""Comparison of the outputs of two versions of a program over a bag, which is read in one pass.

Rules that cannot differ are not run (`change_impact_analysis`). If outputs differ, both whole versions run again
with the recording of lineage, for the reasons.

Equal outputs are removed first. Of the others, an output with the same topic and term at a time nearby has moved, and
one with the same topic and time, and a term of the same name, has changed. The rest is lost or gained.
"""

from collections import defaultdict, deque
from enum import Enum
from heapq import heapify, heappop, heappush
from pathlib import Path
from typing import (
    Callable,
    ContextManager,
    Deque,
    Dict,
    Hashable,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

from ..explanation.event_and_output_explanations import (
    ExplainedOutput,
    explain_output_briefly,
    record_origins,
)
from ..foundation.errors import SyntaxFault
from ..node.subscribed_topics import HandlerFactory
from ..playback.bag_locations import Bag
from ..playback.playback import Playback
from ..playback.shared_pass import SharedRun, SharedTerms, run_together
from ..prolog.syntax.term_reader import read_term
from ..prolog.syntax.term_writer import canonical_text
from ..prolog.terms.timestamps import SECOND
from .change_impact_analysis import (
    Extent,
    ProgramVersion,
    find_difference,
    have_equal_files,
    reduce_to_part,
)

MOVED_WITHIN_SECONDS = 10.0
"""Greatest difference in seconds between the times of an output that has moved, unless chosen otherwise."""

MAX_EXPLAINED_CHANGES = 10
"""Maximum number of different changes of a bag that are explained."""


class ChangeType(Enum):
    """Types of changes."""

    LOST = "lost"
    GAINED = "gained"
    MOVED = "moved"
    CHANGED = "changed"


class PlainOutput(NamedTuple):
    """An output as text.

    Attributes:
        time: time of the bag in nanoseconds since the epoch.
        topic: name of the topic.
    """

    time: int
    topic: str
    term: str

    @property
    def name(self) -> str:
        """Name of the term."""
        return self.term.partition("(")[0]


class OutputChange(NamedTuple):
    """A difference between the outputs of two versions.

    Attributes:
        old: output of the old version; None if it is gained.
        new: output of the new version; None if it is lost.
        reasons: lines of the explanation.
    """

    type: ChangeType
    old: Optional[PlainOutput]
    new: Optional[PlainOutput]
    reasons: Tuple[str, ...] = ()

    @property
    def time(self) -> int:
        """Time of the change: of the first of its outputs."""
        return min(output.time for output in (self.old, self.new) if output is not None)


class Comparison(NamedTuple):
    """Result of the comparison over a bag.

    Attributes:
        changes: the differences by time.
        equal_count: number of equal outputs of the parts that were run.
        start: start of the bag in nanoseconds since the epoch.
        extent: what was run.
        problems: errors of the programs.
    """

    changes: Tuple[OutputChange, ...]
    equal_count: int
    start: int
    extent: Extent
    problems: Tuple[str, ...] = ()


class Version(NamedTuple):
    """A version of a program.

    Attributes:
        load: loads it, with a given conversion of messages to events.
        enter: returns a context in which it runs, which may receive its log.
    """

    folder: Path
    load: Callable[[HandlerFactory], Playback]
    enter: Callable[[], ContextManager[object]]

    def start(
        self, terms: SharedTerms, prepare: Callable[[Playback], object] = lambda playback: None
    ) -> SharedRun:
        """Load the version, prepare it, and return its run."""
        with self.enter():
            playback = self.load(terms.make_handler)
            prepare(playback)
        return SharedRun(playback, self.enter)


def compare_versions(
    old: Version,
    new: Version,
    bag: Bag,
    moved_within: float = MOVED_WITHIN_SECONDS,
    can_reduce: Callable[[], bool] = lambda: True,
) -> Comparison:
    """Run two versions of a program over a bag, and return what differs, with reasons.

    Args:
        old: the old version.
        new: the new version.
        bag: the bag.
        moved_within: see `find_changes`.
        can_reduce: returns whether equal parts of the loaded versions need not be run.
    """
    terms = SharedTerms()
    runs = [version.start(terms) for version in (old, new)]
    extent = Extent.WHOLE
    if can_reduce():
        extent = _reduce((old, new), runs, bag)
    outputs: Tuple[List[PlainOutput], List[PlainOutput]] = ([], [])
    if extent in (Extent.PART, Extent.WHOLE):
        for number, output in run_together(runs, bag, terms):
            outputs[number].append(PlainOutput(int(output.time), output.topic, canonical_text(output.term)))
    changes = find_changes(*outputs, moved_within)
    if changes:
        changes = _explain_changes(changes, (old, new), bag)
    equal_count = len(outputs[0]) - sum(1 for change in changes if change.old is not None)
    return Comparison(tuple(changes), equal_count, bag.start, extent)


def have_equal_programs(versions: Iterable[Version]) -> bool:
    """Load two versions, and return whether their files are equal, so that no bag has to be read."""
    loaded = []
    for version in versions:
        playback = version.start(SharedTerms()).playback
        loaded.append(ProgramVersion(version.folder, playback.engine, playback.definitions))
    return have_equal_files(loaded[0], loaded[1])


def _reduce(versions: Iterable[Version], runs: Sequence[SharedRun], bag: Bag) -> Extent:
    """Reduce two loaded versions to the parts that can differ."""
    old, new = (
        ProgramVersion(version.folder, run.playback.engine, run.playback.definitions)
        for version, run in zip(versions, runs)
    )
    difference = find_difference(old, new, bag)
    if difference.extent is Extent.PART:
        for run, part in zip(runs, difference.parts):
            reduce_to_part(run.playback.engine, part)
            run.playback.limit_events(difference.event_names)
    return difference.extent


def find_changes(
    old: Iterable[PlainOutput], new: Iterable[PlainOutput], moved_within: float = MOVED_WITHIN_SECONDS
) -> List[OutputChange]:
    """Return the differences between two lists of outputs, ordered by time.

    Args:
        old: outputs of the old version.
        new: outputs of the new version.
        moved_within: greatest difference in seconds between the times of an output that has moved.
    """
    old_rest, new_rest, _ = _match(old, new, lambda output: output)
    old_rest, new_rest, moved = _match_nearby(old_rest, new_rest, int(moved_within * SECOND))
    old_rest, new_rest, changed = _match(
        old_rest, new_rest, lambda output: (output.topic, output.time, output.name)
    )
    changes = [OutputChange(ChangeType.MOVED, *pair) for pair in moved]
    changes += [OutputChange(ChangeType.CHANGED, *pair) for pair in changed]
    changes += [OutputChange(ChangeType.LOST, output, None) for output in old_rest]
    changes += [OutputChange(ChangeType.GAINED, None, output) for output in new_rest]
    return sorted(changes, key=lambda change: change.time)


_Matches = Tuple[List[PlainOutput], List[PlainOutput], List[Tuple[PlainOutput, PlainOutput]]]
"""Old and new outputs without partner, and pairs of an old and a new output."""


def _match(
    old: Iterable[PlainOutput], new: Iterable[PlainOutput], key_of: Callable[[PlainOutput], Hashable]
) -> _Matches:
    """Pair outputs with equal keys in their order; return those without partner, and the pairs."""
    unmatched: Dict[Hashable, Deque[PlainOutput]] = defaultdict(deque)
    for output in new:
        unmatched[key_of(output)].append(output)
    pairs = []
    old_rest = []
    for output in old:
        partners = unmatched.get(key_of(output))
        if partners:
            pairs.append((output, partners.popleft()))
        else:
            old_rest.append(output)
    return old_rest, [output for partners in unmatched.values() for output in partners], pairs


def _match_nearby(old: Iterable[PlainOutput], new: Iterable[PlainOutput], limit: int) -> _Matches:
    """Pair outputs with the same topic and term whose times differ by at most the limit, nearest ones first."""
    groups: Dict[Hashable, Tuple[List[PlainOutput], List[PlainOutput]]] = defaultdict(lambda: ([], []))
    for side, outputs in enumerate((old, new)):
        for output in outputs:
            groups[output.topic, output.term][side].append(output)
    old_rest: List[PlainOutput] = []
    new_rest: List[PlainOutput] = []
    pairs: List[Tuple[PlainOutput, PlainOutput]] = []
    for old_outputs, new_outputs in groups.values():
        matched: Tuple[List[PlainOutput], List[PlainOutput]] = ([], [])
        rest = (old_rest, new_rest)
        for output, side, is_matched in _select_nearest(old_outputs, new_outputs, limit):
            (matched if is_matched else rest)[side].append(output)
        # In the order of their times, which increases no greatest difference.
        pairs += zip(*matched)
    return old_rest, new_rest, pairs


def _select_nearest(
    old: Iterable[PlainOutput], new: Iterable[PlainOutput], limit: int
) -> Iterator[Tuple[PlainOutput, int, bool]]:
    """Yield equal outputs by time, with their side (0 for old), and whether they have a partner on the other one.

    The nearest two of both sides are neighbours in the order of times, and are partners. Without them, the next two
    are neighbours, and so on.
    """
    merged = [(output, 0) for output in old] + [(output, 1) for output in new]
    merged.sort(key=lambda entry: entry[0].time)
    count = len(merged)
    before, after = list(range(-1, count - 1)), list(range(1, count + 1))
    matched = [False] * count

    def distance(left: int, right: int) -> int:
        return merged[right][0].time - merged[left][0].time

    def are_candidates(left: int, right: int) -> bool:
        if left < 0 or right >= count or merged[left][1] == merged[right][1]:
            return False
        return distance(left, right) <= limit

    neighbors = [(left, left + 1) for left in range(count - 1) if are_candidates(left, left + 1)]
    heap = [(distance(left, right), left, right) for left, right in neighbors]
    heapify(heap)
    while heap:
        _, left, right = heappop(heap)
        if matched[left] or matched[right]:
            continue
        matched[left] = matched[right] = True
        outer_left, outer_right = before[left], after[right]
        if outer_left >= 0:
            after[outer_left] = outer_right
        if outer_right < count:
            before[outer_right] = outer_left
        if are_candidates(outer_left, outer_right):
            heappush(heap, (distance(outer_left, outer_right), outer_left, outer_right))
    for (output, side), is_matched in zip(merged, matched):
        yield output, side, is_matched


def _explain_changes(
    changes: List[OutputChange], versions: Iterable[Version], bag: Bag
) -> List[OutputChange]:
    """Run both versions again with the recording of lineage, and add the reasons to the first changes."""
    terms = SharedTerms()
    runs = [version.start(terms, lambda playback: record_origins(playback.engine)) for version in versions]
    for _ in run_together(runs, bag, terms):
        pass
    explainers = [run.playback for run in runs]
    # Repeated outputs are explained once.
    first_times: Dict[Tuple[ChangeType, str], int] = {}
    explained = []
    for change in changes:
        output = change.old or change.new
        assert output is not None
        key = (change.type, output.term)
        if key in first_times:
            reasons: Iterable[str] = [f"as at {(first_times[key] - bag.start) / SECOND:.3f} s"]
        elif len(first_times) < MAX_EXPLAINED_CHANGES:
            first_times[key] = output.time
            reasons = _explain_change(change, explainers, bag.start)
        else:
            reasons = [f"not explained: it comes after the first {MAX_EXPLAINED_CHANGES} different changes"]
        explained.append(change._replace(reasons=tuple(reasons)))
    return explained


def _explain_change(change: OutputChange, versions: List[Playback], start: int) -> Iterable[str]:
    """Yield the reason in each version why an output occurred there or not."""
    old, new = versions
    # A version without the output is asked why it lacks that of the other one.
    for name, playback, output in (
        ("old", old, change.old or change.new),
        ("new", new, change.new or change.old),
    ):
        assert output is not None
        lines = _explain_output(playback, output, start)
        if lines:
            yield f"{name}:"
            yield from (f"  {line}" for line in lines)


def _explain_output(playback: Playback, output: PlainOutput, start: int) -> List[str]:
    try:
        term = read_term(output.term, playback.engine.operators).term
    except SyntaxFault as error:
        return [error.message]
    explained = ExplainedOutput(output.topic, term, output.time)
    return explain_output_briefly(playback.engine, explained, start)
