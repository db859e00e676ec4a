"""Comparison of what a case produced with its expectations.

Each `ExpectedSequence` is compared with the outputs or the events of a run (`RunItem`). A difference is a listing by
time: lines with ``-`` are expected and missing, lines with ``+`` are unexpected.
"""

from bisect import bisect_left, bisect_right
from copy import copy
from operator import attrgetter
from typing import Callable, Dict, Iterable, List, Mapping, NamedTuple, Optional, Sequence, Set, Tuple

from ..foundation.displayed_text import printable, shorten
from ..foundation.source_places import Place
from ..messages.message_dictionaries import read_message_term
from ..messages.type_definition import Definition
from ..prolog.syntax.operators import Operators
from ..prolog.syntax.term_writer import canonical_text
from ..prolog.terms.timestamps import SECOND
from ..prolog.terms.types import Functor, Term, Var, deref
from .case_definition import ExpectedItem, ExpectedSequence, TermText
from .message_comparison import SlotComparison
from .term_comparison import TermPattern, read_pattern

MAX_COMPARED_PAIRS = 250_000
"""Maximum number of pairs of items that are compared to align two sequences; longer ones are compared by position."""

MAX_LISTED_ITEMS = 40
"""Maximum number of lines of a listing."""

_CONTEXT_LINES = 2
"""Number of equal items before and after a difference in a listing."""


class RunItem(NamedTuple):
    """An output or an event of a run.

    Attributes:
        start: start in nanoseconds since the start of the case; equal to ``time`` for outputs.
        time: time of an output, or end of an event.
        topic: topic of an output, "" for events.
        id: id of the subscription of an output.
        definition: type of the published message, if there is one.
    """

    term: Term
    start: int
    time: int
    topic: str = ""
    id: Optional[Term] = None
    definition: Optional[Definition] = None


class ExplainedItem(NamedTuple):
    """An output or event whose occurrence or absence is to be explained.

    Attributes:
        is_output: whether it is an output.
        topic: topic of an output; None for any.
        term: its term, or a pattern; None for any output of the topic.
        start: start of an event that happened, in nanoseconds since the start of the case; otherwise None.
        time: time of an output or end of an event, if it is known.
    """

    is_output: bool
    topic: Optional[str]
    term: Optional[Term]
    start: Optional[int]
    time: Optional[int]


class Difference(NamedTuple):
    """A line of a listing.

    Attributes:
        mark: ``+`` for an unexpected item, ``-`` for a missing one, and a space for an equal one.
        text: the item.
        explained: the unexpected or missing item, if it can be explained.
        note: further text.
        expectation: name of the expectation that does not hold, as in `Failure`.
    """

    mark: str
    text: str
    explained: Optional[ExplainedItem] = None
    note: str = ""
    expectation: str = ""


class Failure(NamedTuple):
    """An expectation that does not hold.

    Attributes:
        summary: what differs, in one line.
        differences: listing of the items.
        broken: names of the expectations that do not hold, such as ``outputs[2]`` for the third expected output.
    """

    summary: str
    place: Optional[Place]
    differences: Tuple[Difference, ...] = ()
    broken: Tuple[str, ...] = ()


class ItemMatcher:
    """An expected item, ready for comparisons.

    Args:
        operators: operators of the program.
        start: start of the case in nanoseconds since the epoch.
        is_output: whether this is an output.
        name: name of the expectation.

    Attributes:
        item: see above.
        name: see above.

    Raises:
        CaseFileError: if a term of the item cannot be read.
    """

    def __init__(self, item: ExpectedItem, operators: Operators, start: int, is_output: bool, name: str = ""):
        self.item = item
        self.name = name
        self._is_output = is_output
        self._term = _read(item.term, item, operators, start)
        self._id = _read(item.id, item, operators, start)
        self._slots = SlotComparison(item.tolerance, item.slot_tolerances, start)

    @property
    def functor(self) -> Optional[Functor]:
        """Functor of the pattern; None if any term matches."""
        return None if self._term is None else functor_of(self._term.term)

    @property
    def pattern(self) -> Optional[Term]:
        """Pattern of the term."""
        return None if self._term is None else self._term.term

    @property
    def explained(self) -> Optional[ExplainedItem]:
        """The item for an explanation of its absence; None for any event."""
        if self.pattern is None and not self._is_output:
            return None
        return ExplainedItem(self._is_output, self.item.topic, self.pattern, None, self.item.time)

    def matches(self, actual: RunItem) -> bool:
        """Return whether an output or event is the expected one."""
        # The time is compared first, because this is faster.
        return self._matches_time(actual) and self.matches_content(actual)

    def matches_content(self, actual: RunItem) -> bool:
        """Return whether an output or event is the expected one, except for its time."""
        item = self.item
        if item.topic is not None and item.topic.strip("/") != actual.topic.strip("/"):
            return False
        if self._term is not None and not self._term.matches(actual.term):
            return False
        if self._id is not None and (actual.id is None or not self._id.matches(actual.id)):
            return False
        return item.message is None or self.message_difference(actual) is None

    def message_difference(self, actual: RunItem) -> Optional[str]:
        """Return how the message of an output differs from the expected one, or None."""
        if self.item.message is None:
            return None
        if actual.definition is None:
            return "it is not published as a message"
        slots = read_message_term(actual.definition, actual.term)
        return self._slots.find_difference(actual.definition, self.item.message, slots)

    def without_times(self) -> "ItemMatcher":
        """Return a matcher that accepts the expected item at any time."""
        matcher = copy(self)
        matcher.item = self.item._replace(time=None, start=None)
        return matcher

    def find_range(self, times: Sequence[int]) -> Tuple[int, int]:
        """Return the first and last position of the sorted times that match, as bounds of a slice."""
        item = self.item
        if item.time is None:
            return 0, len(times)
        return bisect_left(times, item.time - item.within), bisect_right(times, item.time + item.within)

    def _matches_time(self, actual: RunItem) -> bool:
        item = self.item
        return _is_within(item.time, actual.time, item.within) and _is_within(
            item.start, actual.start, item.within
        )

    def describe(self) -> str:
        """Return the item as a line."""
        item = self.item
        content = item.term.text if item.term is not None else ""
        if item.message is not None:
            content = f"{content} {item.message.plain()}".strip()
        time = "" if item.time is None else _format_time(item.time)
        return _format_line(time, item.topic or "", content)


def functor_of(term: Term) -> Optional[Functor]:
    """Return the functor of a compound term, or the atom of an atom; None for variables."""
    term = deref(term)
    if term.__class__ is Var:
        return None
    return term[0] if term.__class__ is tuple else term  # type: ignore[return-value]


def _read(
    text: Optional[TermText], item: ExpectedItem, operators: Operators, start: int
) -> Optional[TermPattern]:
    return None if text is None else read_pattern(text, operators, item.tolerance, start)


def _is_within(expected: Optional[int], actual: int, within: int) -> bool:
    return expected is None or abs(expected - actual) <= within


def describe_item(item: RunItem) -> str:
    """Return an output or event as a line: time in seconds, topic and term."""
    return _format_line(_format_time(item.time), item.topic, shorten(canonical_text(item.term), 500))


def _format_line(time: str, topic: str, content: str) -> str:
    return printable("  ".join(part for part in (f"{time:>10}", topic, content) if part))


def _format_time(time: int) -> str:
    return f"{time / SECOND:.3f} s"


def _format_exact_time(time: int) -> str:
    """Return a time with at least three and at most nine decimals, so that different times look different."""
    seconds, nanoseconds = divmod(time, SECOND)
    decimals = f"{nanoseconds:09d}".rstrip("0")
    return f"{seconds}.{decimals:0<3} s"


class SequenceCheck:
    """Check of one expectation.

    Args:
        operators: operators of the program.
        start: start of the case in nanoseconds since the epoch.
        name: name of the expectation; by default its subject and relation.
    """

    def __init__(
        self, expected: ExpectedSequence, operators: Operators, start: int, name: Optional[str] = None
    ):
        self._expected = expected
        is_output = expected.subject == "outputs"
        self._is_exact = expected.relation == "exactly"
        subject = expected.subject
        self._name = name or (subject if self._is_exact else f"{subject}.{expected.relation}")
        self._matchers = [
            ItemMatcher(item, operators, start, is_output, f"{self._name}[{number}]")
            for number, item in enumerate(expected.items)
        ]

    @property
    def names(self) -> List[str]:
        """Names of the expectations: one for each item, and one for their number or for the absence of others."""
        names = [matcher.name for matcher in self._matchers]
        if self._is_exact:
            names.append(self._name_of_others)
        return names or [self._name]

    @property
    def _name_of_others(self) -> str:
        return f"{self._name} (no others)"

    @property
    def functors(self) -> List[Optional[Functor]]:
        """Functors of the expected items, in their order."""
        return [matcher.functor for matcher in self._matchers]

    @property
    def concerns_all(self) -> bool:
        """True if the expectation concerns items of any functor."""
        return self._expected.relation == "count" or None in self.functors

    def find_failure(self, items: Sequence[RunItem]) -> Optional[Failure]:
        """Return the failure of the expectation for the outputs or events of a run, or None if it holds."""
        checks: Mapping[str, Callable[[Sequence[RunItem]], Optional[Failure]]] = {
            "exactly": self._check_all,
            "contains": self._check_contained,
            "in_order": self._check_order,
            "none": self._check_absent,
            "count": self._check_count,
        }
        return checks[self._expected.relation](items)

    def _fail(self, text: str, differences: Sequence[Difference] = (), broken: Iterable[str] = ()) -> Failure:
        names = broken or [difference.expectation for difference in differences]
        return Failure(
            f"{self._expected.subject}: {text}",
            self._expected.place,
            tuple(differences),
            tuple(dict.fromkeys(names)),
        )

    def _check_all(self, items: Sequence[RunItem]) -> Optional[Failure]:
        compared = self._select(items)
        differences = _align(self._matchers, compared)
        if all(difference.mark == " " for difference in differences):
            return None
        text = f"{len(self._matchers)} expected, {len(compared)} found"
        if len(self._matchers) == len(compared):
            difference_text = self._find_wrong_times(self._matchers, compared)
            if difference_text:
                text = f"all found, but {difference_text}"
                differences = [difference._replace(explained=None) for difference in differences]
        return self._fail(
            text,
            _shorten_listing(differences),
            [
                difference.expectation or self._name_of_others
                for difference in differences
                if difference.mark != " "
            ],
        )

    def _find_wrong_times(self, matchers: Sequence[ItemMatcher], items: Sequence[RunItem]) -> str:
        """Return what is wrong if all expected items were found, in other order or at other times; "" otherwise."""
        if len(matchers) * len(items) > MAX_COMPARED_PAIRS:
            return ""
        if not _assign(matchers, items):
            return "in another order"
        if _assign([matcher.without_times() for matcher in matchers], items):
            return ""
        is_ordered = all(matcher.matches_content(item) for matcher, item in zip(matchers, items))
        return "at other times" if is_ordered or not self._is_exact else "in another order and at other times"

    def _select(self, items: Sequence[RunItem]) -> Sequence[RunItem]:
        """Return the items that an exact list concerns: all outputs, or the events with the names of the list."""
        if self._expected.subject == "outputs":
            return items
        functors = set(self.functors)
        return [item for item in items if None in functors or functor_of(item.term) in functors]

    def _check_contained(self, items: Sequence[RunItem]) -> Optional[Failure]:
        counted = [matcher for matcher in self._matchers if matcher.item.occurrences is not None]
        single = [matcher for matcher in self._matchers if matcher.item.occurrences is None]
        differences = [
            _describe_count(matcher, items) for matcher in counted if not _has_allowed_count(matcher, items)
        ]
        missing = _assign(single, items)
        # The search for the most similar item takes time for each item of the run.
        differences += [_describe_missing(matcher, items) for matcher in missing[:MAX_LISTED_ITEMS]]
        if not differences:
            return None
        count = len(differences) + max(0, len(missing) - MAX_LISTED_ITEMS)
        text = f"{count} not found as expected"
        if missing and len(differences) == len(missing) and self._find_wrong_times(single, items):
            text = f"all found, but {count} at other times"
            differences = [difference._replace(explained=None) for difference in differences]
        return self._fail(text, differences)

    def _check_order(self, items: Sequence[RunItem]) -> Optional[Failure]:
        position = 0
        for number, matcher in enumerate(self._matchers):
            # The earliest match leaves the most items to the following ones.
            while position < len(items) and not matcher.matches(items[position]):
                position += 1
            if position == len(items):
                missing = _describe_missing(matcher, items)
                text = f"number {number + 1} of the list not found after those before it"
                difference_text = self._find_wrong_times(self._matchers, items)
                if difference_text:
                    text = f"all found, but {difference_text}: {text}"
                    missing = missing._replace(explained=None)
                return self._fail(text, [missing])
            position += 1
        return None

    def _check_absent(self, items: Sequence[RunItem]) -> Optional[Failure]:
        unexpected = [item for item in items if any(matcher.matches(item) for matcher in self._matchers)]
        if not unexpected:
            return None
        return self._fail(
            f"{len(unexpected)} found that must not occur",
            list(map(_unexpected, unexpected[:MAX_LISTED_ITEMS])),
            [matcher.name for matcher in self._matchers if any(map(matcher.matches, unexpected))],
        )

    def _check_count(self, items: Sequence[RunItem]) -> Optional[Failure]:
        count = self._expected.occurrences
        if count is None or count.accepts(len(items)):
            return None
        return self._fail(f"{count} expected, {len(items)} found", broken=[self._name])


def _has_allowed_count(matcher: ItemMatcher, items: Sequence[RunItem]) -> bool:
    count = matcher.item.occurrences
    return count is None or count.accepts(sum(map(matcher.matches, items)))


def _describe_count(matcher: ItemMatcher, items: Sequence[RunItem]) -> Difference:
    number = sum(map(matcher.matches, items))
    return Difference(
        "-",
        matcher.describe(),
        matcher.explained,
        f"{matcher.item.occurrences} expected, {number} found",
        matcher.name,
    )


def _unexpected(item: RunItem) -> Difference:
    is_output = bool(item.topic)
    start = None if is_output else item.start
    explained = ExplainedItem(is_output, item.topic if is_output else None, item.term, start, item.time)
    return Difference("+", describe_item(item), explained)


def _describe_missing(matcher: ItemMatcher, items: Sequence[RunItem]) -> Difference:
    """Return the line of a missing item, with the actual item that differs least as note."""
    note, explained = "", matcher.explained
    expected_time = matcher.item.time
    same_content = [item for item in items if matcher.matches_content(item)]
    if same_content:
        nearest = min(same_content, key=lambda item: abs(item.time - (expected_time or 0)))
        note = f"found at {_format_exact_time(nearest.time)}"
        explained = None if explained is None else explained._replace(term=nearest.term)
    for item in items if not same_content else ():
        if matcher.item.topic is not None and matcher.item.topic.strip("/") == item.topic.strip("/"):
            difference = matcher.message_difference(item)
            note = f"the message at {_format_exact_time(item.time)}: {difference}" if difference else note
    return Difference("-", matcher.describe(), explained, note, matcher.name)


def _assign(matchers: Sequence[ItemMatcher], items: Sequence[RunItem]) -> List[ItemMatcher]:
    """Assign each expected item an item of its own, and return those that get none.

    This is a maximum matching of a bipartite graph by augmenting paths (Kuhn's algorithm), because a pattern with
    variables must not take the only item of a more specific one.
    """
    by_functor: Dict[Optional[Functor], List[RunItem]] = {}
    for item in sorted(items, key=attrgetter("time")):
        for key in (functor_of(item.term), None):
            by_functor.setdefault(key, []).append(item)
    times = {key: list(map(attrgetter("time"), group)) for key, group in by_functor.items()}
    candidates = []
    for matcher in matchers:
        group = by_functor.get(matcher.functor, [])
        first, last = matcher.find_range(times.get(matcher.functor, []))
        candidates.append([id(item) for item in group[first:last] if matcher.matches(item)])
    owner_of: Dict[int, int] = {}
    item_of: Dict[int, int] = {}
    return [
        matcher
        for number, matcher in enumerate(matchers)
        if not _find_augmenting_path(number, candidates, owner_of, item_of)
    ]


def _find_augmenting_path(
    number: int, candidates: Sequence[Sequence[int]], owner_of: Dict[int, int], item_of: Dict[int, int]
) -> bool:
    """Search an item for an expected one, by breadth-first search; reassign the items of others on the way.

    Args:
        number: number of the expected item.
        candidates: identities of the items that match each expected one.
        owner_of: the number of the expected item that has an item.
        item_of: the inverse of ``owner_of``.
    """
    reached_from: Dict[int, int] = {}
    queue = [number]
    for expected in queue:
        for item in candidates[expected]:
            if item in reached_from:
                continue
            reached_from[item] = expected
            if item in owner_of:
                queue.append(owner_of[item])
                continue
            # Each item on the path is given to the expected one from which it was reached.
            path_item: Optional[int] = item
            while path_item is not None:
                owner = reached_from[path_item]
                owner_of[path_item] = owner
                # The first expected item of the path has no item yet.
                item_of[owner], path_item = path_item, item_of.get(owner)
            return True
    return False


def _align(matchers: Sequence[ItemMatcher], items: Sequence[RunItem]) -> List[Difference]:
    """Return the listing of two sequences: their longest common subsequence, and what differs."""
    start = 0
    while start < min(len(matchers), len(items)) and matchers[start].matches(items[start]):
        start += 1
    end = 0
    while end < min(len(matchers), len(items)) - start and matchers[-1 - end].matches(items[-1 - end]):
        end += 1
    listing = [_equal(item) for item in items[:start]]
    rest = matchers[start : len(matchers) - end], items[start : len(items) - end]
    if len(rest[0]) * len(rest[1]) <= MAX_COMPARED_PAIRS:
        listing += _align_by_common_subsequence(*rest)
    else:
        listing += _align_by_position(*rest)
    return listing + [_equal(item) for item in items[len(items) - end :]]


def _equal(item: RunItem) -> Difference:
    return Difference(" ", describe_item(item))


def _align_by_position(matchers: Sequence[ItemMatcher], items: Sequence[RunItem]) -> List[Difference]:
    listing: List[Difference] = []
    for position in range(max(len(matchers), len(items))):
        matcher = matchers[position] if position < len(matchers) else None
        item = items[position] if position < len(items) else None
        if matcher is not None and item is not None and matcher.matches(item):
            listing.append(_equal(item))
            continue
        if matcher is not None:
            listing.append(Difference("-", matcher.describe(), matcher.explained, expectation=matcher.name))
        if item is not None:
            listing.append(_unexpected(item))
    return listing


def _align_by_common_subsequence(
    matchers: Sequence[ItemMatcher], items: Sequence[RunItem]
) -> List[Difference]:
    """Align two sequences by dynamic programming over the lengths of the common subsequences of their ends."""
    lengths = [[0] * (len(items) + 1) for _ in range(len(matchers) + 1)]
    equal = [[matcher.matches(item) for item in items] for matcher in matchers]
    for row in range(len(matchers) - 1, -1, -1):
        for column in range(len(items) - 1, -1, -1):
            if equal[row][column]:
                lengths[row][column] = lengths[row + 1][column + 1] + 1
            else:
                lengths[row][column] = max(lengths[row + 1][column], lengths[row][column + 1])
    listing: List[Difference] = []
    row = column = 0
    while row < len(matchers) or column < len(items):
        if row < len(matchers) and column < len(items) and equal[row][column]:
            listing.append(_equal(items[column]))
            row, column = row + 1, column + 1
        elif column == len(items) or (
            row < len(matchers) and lengths[row + 1][column] >= lengths[row][column + 1]
        ):
            listing.append(_describe_missing(matchers[row], items))
            row += 1
        else:
            listing.append(_unexpected(items[column]))
            column += 1
    return listing


def _shorten_listing(listing: Sequence[Difference]) -> List[Difference]:
    """Return the differences of a listing with the equal items around them, up to `MAX_LISTED_ITEMS` lines."""
    shown: Set[int] = set()
    for position, difference in enumerate(listing):
        if difference.mark != " ":
            shown.update(range(position - _CONTEXT_LINES, position + _CONTEXT_LINES + 1))
    lines: List[Difference] = []
    previous = -1
    for position in sorted(shown & set(range(len(listing)))):
        if len(lines) == MAX_LISTED_ITEMS:
            lines.append(Difference(" ", f"... and {len(listing) - position} more"))
            return lines
        if position > previous + 1:
            lines.append(Difference(" ", "..."))
        lines.append(listing[position])
        previous = position
    return lines
