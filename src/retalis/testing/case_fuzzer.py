"""Fuzzer of cases: random mutations of the input, and the smallest ones that break an expectation.

Each try runs the case with one to three mutations. A try that breaks an expectation is reduced by delta debugging:
mutations are removed one at a time while the expectation remains broken, then delays and shifts of stamps are halved.
The choice depends on the seed and the case only, so that equal seeds give equal reports. The reductions of all tries
proceed together, in rounds of one run each, so that the runs of a round share the processes and the loaded program.
"""

from random import Random
from typing import (
    Dict,
    FrozenSet,
    Generator,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

from ..foundation.displayed_text import format_count, printable, shorten
from ..messages.type_registry import Definitions
from ..prolog.terms.timestamps import SECOND
from .case_definition import Case, InputId, Mutation, MutationType
from .case_processes import run_cases
from .case_run import CaseResult, TryOutcome
from .input_mutations import InputMessage, describe_mutation, identify_events

MIN_AMOUNT = 10**7
"""Smallest delay or shift of a stamp in nanoseconds; others are this one, doubled several times."""

MAX_STAMP_SHIFT = 128 * MIN_AMOUNT
"""Largest shift of a stamp in nanoseconds."""

MAX_REDUCED_TRIES = 20
"""Maximum number of tries that are reduced for each expectation."""

MAX_LISTED_FINDINGS = 10
"""Maximum number of listed findings for each expectation."""

MAX_LISTED_NAMES = 3
"""Maximum number of expectations that a line about mutations names."""

MAX_TEXT_CHARACTERS = 60
"""Maximum length of the term of an event in a report."""

_EXECUTION = "execution"
"""Name of the expectation that a case ends, within its time limit."""

_MUTATION_COUNTS = (1, 1, 2, 3)
"""Numbers of mutations of a try, each as probable as the others."""

_ORDER_OF_TYPES = tuple(MutationType)

Mutations = Tuple[Mutation, ...]
"""Mutations of a try."""

_Reduction = Generator[Mutations, Optional[bool], Mutations]
"""Yields mutations, receives whether these break the expectation, and returns the smallest ones that do."""


class BrokenExpectation(NamedTuple):
    """Smallest mutations that break an expectation."""

    expectation: str
    mutations: Mutations


class FuzzReport(NamedTuple):
    """Report about a case.

    Attributes:
        tries: number of tries.
        survived: number of tries in which an expectation holds, by its name.
        findings: the findings, by type.
        problem: reason why there are no tries, or "".
    """

    case: Case
    tries: int
    survived: Dict[str, int]
    findings: Tuple[BrokenExpectation, ...]
    problem: str = ""

    def format_lines(self) -> Iterator[str]:
        """Yield the lines of the report."""
        case = self.case
        yield printable(
            f"fuzz {case.path}:{case.place.line}: {case.name}: {self.problem or format_tries(self.tries)}"
        )
        describe_input = _InputTexts(case).describe
        broken_names = [name for name, count in self.survived.items() if count < self.tries]
        for name in broken_names:
            yield f"  robustness {self.survived[name]} of {self.tries}: {name}"
        robust_count = len(self.survived) - len(broken_names)
        if robust_count:
            yield f"  robustness {self.tries} of {self.tries}: {format_count(robust_count, 'expectation')}"
        listed_counts: Dict[str, int] = {}
        names_by_mutations: Dict[Mutations, List[str]] = {}
        for name, mutations in self.findings:
            listed_counts[name] = listed_counts.get(name, 0) + 1
            if listed_counts[name] <= MAX_LISTED_FINDINGS:
                names_by_mutations.setdefault(mutations, []).append(name)
        for mutations, names in names_by_mutations.items():
            clauses = [describe_mutation(mutation, describe_input) for mutation in mutations]
            verb = "fails" if len(names) == 1 else "fail"
            yield printable(
                f"  {_join_names(sorted(names, key=broken_names.index))} {verb} if {' and '.join(clauses)}"
            )
        for name, count in listed_counts.items():
            if count > MAX_LISTED_FINDINGS:
                yield f"  {name} has {count - MAX_LISTED_FINDINGS} more findings"


def format_tries(count: int) -> str:
    """Return a number of tries with its noun."""
    return format_count(count, "try", "tries")


def _join_names(names: Sequence[str]) -> str:
    """Return names of expectations as a list that is cut after a few."""
    if len(names) == 1:
        return names[0]
    if len(names) > MAX_LISTED_NAMES:
        names = [*names[: MAX_LISTED_NAMES - 1], f"{len(names) - MAX_LISTED_NAMES + 1} others"]
    return f"{', '.join(names[:-1])} and {names[-1]}"


class _InputTexts:
    """Texts of the events and messages of a case."""

    def __init__(self, case: Case):
        self._terms = {input_id: event.event.text for input_id, event in identify_events(case.events)}

    def describe(self, input_id: InputId) -> str:
        """Return an event or message in words, with its time."""
        time = f"{input_id.time / SECOND:.6f}".rstrip("0").rstrip(".")
        if not input_id.topic:
            term = shorten(" ".join(self._terms[input_id].split()), MAX_TEXT_CHARACTERS)
            return f"the event at {time} s ({term})"
        number = f" number {input_id.number + 1}" if input_id.number else ""
        return f"the message{number} at {time} s on {input_id.topic}"


def fuzz_cases(
    cases: Sequence[Case], definitions: Definitions, jobs: int, tries: int, seed: int
) -> Iterator[FuzzReport]:
    """Yield a report for each case, whose expectations hold without mutations.

    Args:
        cases: the cases.
        definitions: known message types.
        jobs: maximum number of processes that run cases at a time.
        tries: number of tries of each case.
        seed: seed of the random choices.
    """
    for case in cases:
        runner = _TryRunner(case, definitions, jobs)
        (outcome,) = runner.run_tries([()])
        if outcome is None or outcome.broken:
            yield FuzzReport(case, 0, {}, (), "no tries: without changes, a second run has other results")
            continue
        maker = _MutationMaker(case, outcome.messages, Random(f"{seed} {case.name}"))
        if not maker.has_inputs:
            yield FuzzReport(case, 0, {}, (), "no tries: it has no input that can be changed")
            continue
        yield _fuzz_case(runner, [maker.make() for _ in range(tries)], outcome.expectations)


def _fuzz_case(runner: "_TryRunner", tries: Sequence[Mutations], expectations: Iterable[str]) -> FuzzReport:
    runner.run(tries)
    broken_counts: Dict[str, int] = dict.fromkeys(expectations, 0)
    broken_tries: Dict[str, List[Mutations]] = {}
    for mutations in tries:
        for name in sorted(runner.broken(mutations)):
            broken_counts[name] = broken_counts.get(name, 0) + 1
            broken_tries.setdefault(name, []).append(mutations)
    reductions = [
        (name, _reduce(mutations))
        for name, name_tries in broken_tries.items()
        # The shortest ones first: they need the fewest runs, and are the likeliest to be different.
        for mutations in sorted(set(name_tries), key=lambda each: (len(each), _mutations_key(each)))[
            :MAX_REDUCED_TRIES
        ]
    ]
    findings = _select_smallest(_run_reductions(runner, reductions))
    survived = {name: len(tries) - count for name, count in broken_counts.items()}
    return FuzzReport(runner.case, len(tries), survived, tuple(findings))


class _MutationMaker:
    """Maker of random mutations.

    Args:
        random: source of random numbers.

    Attributes:
        has_inputs: whether there is an event or message.
    """

    def __init__(self, case: Case, messages: Sequence[InputMessage], random: Random):
        self._random = random
        self._end = case.end
        events = [InputMessage(input_id, True) for input_id, _ in identify_events(case.events)]
        # At the same time, messages precede events.
        self._inputs = sorted([*messages, *events], key=lambda each: (each.id.time, not each.id.topic))
        self.has_inputs = bool(self._inputs)
        last_time = max([each.id.time for each in self._inputs], default=0)
        self._max_delay = max(MAX_STAMP_SHIFT, (last_time if case.end is None else case.end) // 2)

    def make(self) -> Mutations:
        """Return the mutations of a try, at most one for each input."""
        count = min(self._random.choice(_MUTATION_COUNTS), len(self._inputs))
        positions = self._random.sample(range(len(self._inputs)), count)
        return tuple(sorted((self._make_mutation(position) for position in positions), key=_mutation_key))

    def _make_mutation(self, position: int) -> Mutation:
        changed = self._inputs[position]
        mutations = [Mutation(MutationType.LOST, changed.id), Mutation(MutationType.REPEATED, changed.id)]
        longest_delay = self._max_delay if self._end is None else self._end - changed.id.time
        delay = self._choose_amount(min(longest_delay, self._max_delay))
        if delay:
            mutations.append(Mutation(MutationType.DELAYED, changed.id, delay))
        if position + 1 < len(self._inputs):
            next_id = self._inputs[position + 1].id
            # One nanosecond later, it is received after the next one, whether this is an event or a message.
            amount = next_id.time - changed.id.time + 1
            if amount <= longest_delay or self._end is None:
                mutations.append(Mutation(MutationType.OVERTAKEN, changed.id, amount, next_id))
        if changed.has_stamp:
            shift = self._choose_amount(MAX_STAMP_SHIFT) * self._random.choice((-1, 1))
            mutations.append(Mutation(MutationType.RESTAMPED, changed.id, shift))
        return self._random.choice(mutations)

    def _choose_amount(self, limit: int) -> int:
        """Return a random amount of the geometric sequence from `MIN_AMOUNT` up to a limit; 0 if there is none."""
        return (
            MIN_AMOUNT << self._random.randrange((limit // MIN_AMOUNT).bit_length())
            if limit >= MIN_AMOUNT
            else 0
        )


def _mutation_key(mutation: Mutation) -> Tuple[int, str, int]:
    return mutation.input.time, mutation.input.topic, mutation.input.number


class _TryRunner:
    """Runner of tries, which runs equal ones once.

    Args:
        definitions: known message types.
        jobs: maximum number of processes.
    """

    def __init__(self, case: Case, definitions: Definitions, jobs: int):
        self.case = case
        self._definitions = definitions
        self._jobs = jobs
        self._broken: Dict[Mutations, FrozenSet[str]] = {}

    def run_tries(self, tries: Sequence[Mutations]) -> List[Optional[TryOutcome]]:
        """Run tries; return their outcomes."""
        cases = [self.case._replace(mutations=mutations) for mutations in tries]
        results: Dict[int, CaseResult] = dict(run_cases(cases, self._definitions, self._jobs))
        return [results[number].outcome for number in range(len(cases))]

    def run(self, tries: Iterable[Mutations]) -> None:
        """Run the tries that have not been run."""
        new_tries = [mutations for mutations in dict.fromkeys(tries) if mutations not in self._broken]
        for mutations, outcome in zip(new_tries, self.run_tries(new_tries)):
            broken = (_EXECUTION,) if outcome is None else outcome.broken
            self._broken[mutations] = frozenset(broken)

    def broken(self, mutations: Mutations) -> FrozenSet[str]:
        """Return the names of the expectations that a try breaks, which has been run."""
        return self._broken[mutations]


def _reduce(mutations: Mutations) -> _Reduction:
    """Reduce mutations that break an expectation; see `_Reduction`."""
    position = 0
    while position < len(mutations) and len(mutations) > 1:
        candidate = mutations[:position] + mutations[position + 1 :]
        if (yield candidate):
            # One that was needed before may be superfluous without this one.
            mutations, position = candidate, 0
        else:
            position += 1
    for position, mutation in enumerate(mutations):
        while mutation.next_input is None and abs(mutation.amount) > MIN_AMOUNT:
            mutation = mutation._replace(amount=int(mutation.amount / 2))
            candidate = (*mutations[:position], mutation, *mutations[position + 1 :])
            if not (yield candidate):
                break
            mutations = candidate
    return mutations


def _run_reductions(
    runner: _TryRunner, reductions: Iterable[Tuple[str, _Reduction]]
) -> Iterator[BrokenExpectation]:
    """Run reductions together; yield their results."""
    # The first value that a generator receives is None.
    pending: List[Tuple[str, _Reduction, Optional[bool]]] = [(*each, None) for each in reductions]
    while pending:
        candidates: List[Tuple[str, _Reduction, Mutations]] = []
        for name, reduction, is_broken in pending:
            try:
                candidates.append((name, reduction, reduction.send(is_broken)))
            except StopIteration as stop:
                yield BrokenExpectation(name, stop.value)
        runner.run(candidate for _, _, candidate in candidates)
        pending = [
            (name, reduction, name in runner.broken(candidate)) for name, reduction, candidate in candidates
        ]


def _select_smallest(findings: Iterable[BrokenExpectation]) -> List[BrokenExpectation]:
    """Return the findings with different types and inputs, by type; of equal ones, that with the least amounts."""
    smallest: Dict[object, BrokenExpectation] = {}
    for finding in sorted(findings, key=_finding_key):
        changed = tuple((mutation.type, mutation.input) for mutation in finding.mutations)
        smallest.setdefault((finding.expectation, changed), finding)
    return list(smallest.values())


def _finding_key(finding: BrokenExpectation) -> Tuple[object, ...]:
    return len(finding.mutations), _mutations_key(finding.mutations), finding.expectation


def _mutations_key(mutations: Mutations) -> Tuple[object, ...]:
    """Return the key by which mutations are sorted: enumerations cannot be compared."""
    return tuple(
        (_ORDER_OF_TYPES.index(mutation.type), mutation.input, abs(mutation.amount), mutation.amount)
        for mutation in mutations
    )
