"""Execution of a case: its program runs over its input, as over a bag, and the results are compared.

`load_program` loads the program of a case, and `run_case` runs the case on it. A loaded program serves one case; the
processes that run several cases of one program are forked from one that has loaded it (`case_processes`).

A case that fails runs a second time with the recording of lineage, so that missing and unexpected results can be
explained. Cases that succeed do not bear the cost.
"""

import logging
import time
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Callable, Dict, Iterator, List, NamedTuple, Optional, Sequence, Set, Tuple

from ..engine.engine import EVENT_FLAGS, Engine
from ..events.knowledge.knowledge_base import MEMORY_EVENTS
from ..events.program.topic_configuration import GOALS, RULES, TOPICS, TopicType, read_topics, topic_type
from ..explanation.event_and_output_explanations import (
    ExplainedOutput,
    event_request,
    explain_briefly,
    explain_output_briefly,
    record_origins,
)
from ..foundation.displayed_text import printable
from ..foundation.errors import RetalisError, UsageError
from ..foundation.ros_name_checks import strip_slashes
from ..foundation.similar_names import did_you_mean
from ..messages.type_registry import Definitions
from ..node.parameters import read_parameters
from ..playback.playback import Output, Playback, TimedCall
from ..prolog.syntax.operators import Operators
from ..prolog.syntax.term_writer import canonical_text
from ..prolog.terms.term_traversal import copy
from ..prolog.terms.types import Term, functor
from .case_definition import (
    Case,
    CaseEvent,
    CaseProgram,
    ExpectedAnswer,
    ExpectedSequence,
    SourceText,
)
from .case_input import CaseBag, create_case_bag, open_bags, start_of
from .expectation_checks import Difference, ExplainedItem, Failure, RunItem, SequenceCheck, functor_of
from .expected_names import ProgramNames, check_slot_names, find_unknown_name, name_of
from .golden_file import format_golden_lines, read_golden_file
from .input_mutations import InputMessage, MessageMutator, largest_amount, mutate_events
from .offline_ros import OfflineRos
from .rule_coverage import CoverageRecorder, CoveredPart
from .term_comparison import read_pattern, read_term_text
from .yaml_documents import CaseFileError

MAX_EXPLANATIONS = 5
"""Maximum number of explanations of a failure."""

MAX_RECORDED_EVENTS = 1_000_000
"""Maximum number of events of a run that are compared."""

MAX_RECORDED_OUTPUTS = 1_000_000
"""Maximum number of outputs of a run that are compared."""

MAX_PROBLEMS = 100
"""Maximum number of errors, and of warnings, of a run that are stored."""

_ASSERTZ = functor("assertz", 1)


class TryOutcome(NamedTuple):
    """Outcome of a case that is a try of the fuzzer.

    Attributes:
        expectations: names of all expectations.
        broken: names of those that do not hold; a name may not be one of the others, if an error is unexpected.
        messages: messages of the input, if there are no mutations.
    """

    expectations: Tuple[str, ...]
    broken: Tuple[str, ...]
    messages: Tuple[InputMessage, ...]


class CaseResult(NamedTuple):
    """Result of a case.

    Attributes:
        failures: texts about the expectations that do not hold; empty if the case has succeeded.
        warnings: warnings of the program.
        seconds: duration of the execution.
        golden_lines: actual lines of the golden file; None if the case has no golden file.
        coverage: parts of the program with their uses.
        only_golden_differs: whether all other expectations hold, so that the golden file may be replaced.
        outcome: outcome of a try of the fuzzer; None for other cases, and if the execution fails.
        incomplete_files: descriptions of what is missing in the bags of the case, which are warnings, too.
    """

    failures: Tuple[str, ...]
    warnings: Tuple[str, ...]
    seconds: float
    golden_lines: Optional[Tuple[str, ...]] = None
    coverage: Tuple[CoveredPart, ...] = ()
    only_golden_differs: bool = False
    outcome: Optional[TryOutcome] = None
    incomplete_files: Tuple[str, ...] = ()


class ProgramUnderTest(NamedTuple):
    """A program that was loaded for a case."""

    playback: Playback
    problems: "ProblemLog"


class ProblemLog(logging.Handler):
    """Errors and warnings of a run, from the log and from the loading of the program.

    Args:
        rename: replaces names of files in a text.

    Attributes:
        rename: see above.
        errors: texts of the errors.
        warnings: texts of the warnings.
    """

    def __init__(self, rename: Callable[[str], str]):
        super().__init__(logging.WARNING)
        self.rename = rename
        self.errors: List[str] = []
        self.warnings: List[str] = []

    def add_error(self, error: RetalisError) -> None:
        """Add an error of the program."""
        self._append(self.errors, str(error))

    def emit(self, record: logging.LogRecord) -> None:
        """Add a record of the log."""
        self._append(self.errors if record.levelno >= logging.ERROR else self.warnings, self.format(record))

    def _append(self, texts: List[str], text: str) -> None:
        if len(texts) < MAX_PROBLEMS:
            texts.append(self.rename(printable(text)))

    @contextmanager
    def attached(self) -> Iterator[None]:
        """Receive the log of the package, which is not passed to other handlers meanwhile."""
        logger = logging.getLogger("retalis")
        propagates = logger.propagate
        logger.addHandler(self)
        logger.propagate = False
        try:
            yield
        finally:
            logger.removeHandler(self)
            logger.propagate = propagates


def load_program(
    case: Case,
    definitions: Definitions,
    bag: Optional[CaseBag] = None,
    records_origins: bool = False,
    records_coverage: bool = False,
) -> ProgramUnderTest:
    """Load the program of a case.

    Args:
        case: the case.
        definitions: known message types.
        bag: input with further types that the program may use.
        records_origins: whether the engine records the lineage of events.
        records_coverage: whether the parts of the program count their uses.

    Raises:
        RetalisError: if the program cannot be started: a file is missing, or a parameter or fact is wrong.
    """
    program = case.program
    with ExitStack() as stack:
        folder = program.folder or _write_program(program, stack)
        problems = ProblemLog(lambda text: _rename_files(text, folder, program))
        stack.enter_context(problems.attached())
        parameters = read_parameters(dict(program.parameters), lambda: folder)
        playback = Playback(
            folder,
            problems.add_error,
            _read_topic_types(program),
            # A case has a time limit of its own.
            parameters.settings._replace(watchdog=None, counts_uses=records_coverage),
            max_skew=parameters.max_skew,
            bag=bag,  # type: ignore[arg-type]
            direct=parameters.direct,
            definitions=definitions,
            prepare=partial(_connect_ros, program, definitions),
        )
        if records_origins:
            record_origins(playback.engine)
        for fact in program.facts:
            playback.engine.call((_ASSERTZ, read_term_text(fact, playback.engine.operators)))
        # The checks of a whole program take longer than most cases.
        playback.log_mistakes()
    return ProgramUnderTest(playback, problems)


def _connect_ros(program: CaseProgram, definitions: Definitions, engine: Engine) -> None:
    """Connect an engine with the services and parameters of a case."""
    parameters = program.ros_parameters if program.has_parameters else None
    OfflineRos(program.services or None, parameters, definitions).connect(engine)


def _write_program(program: CaseProgram, stack: ExitStack) -> Path:
    """Write the program of a test file to a temporary folder."""
    folder = Path(stack.enter_context(TemporaryDirectory(prefix="retalis-")))
    # The rules are loaded by the line before the goals.
    goals = f"compile_event_file('{RULES}')\n{_pad_to_line(program.goals, 2)}"
    (folder / GOALS).write_text(goals, encoding="utf-8")
    (folder / TOPICS).write_text("<publish_subscribe/>\n", encoding="utf-8")
    (folder / RULES).write_text(_pad_to_line(program.rules, 1), encoding="utf-8")
    return folder


def _pad_to_line(source: Optional[SourceText], line: int) -> str:
    """Return a text with empty lines before it, so that its lines have the numbers of the test file."""
    return "" if source is None else "\n" * (source.first_line - line) + source.text


def _rename_files(text: str, folder: Path, program: CaseProgram) -> str:
    """Replace the names of the files of `_write_program` by that of the test file."""
    if program.folder is not None:
        return text
    for name in (RULES, GOALS):
        text = text.replace(str(folder / name), str(program.path))
    return text.replace(f"{folder}/", "")


def _read_topic_types(program: CaseProgram) -> List[TopicType]:
    try:
        return [topic_type(topic, message_type) for topic, message_type in program.topics]
    except UsageError as error:
        raise CaseFileError(f"{program.path}: topics: {error.message}") from error


def run_case(
    case: Case,
    definitions: Definitions,
    program: Optional[ProgramUnderTest] = None,
    records_coverage: bool = False,
) -> CaseResult:
    """Run a case.

    Args:
        case: the case.
        definitions: known message types.
        program: the program of the case, loaded by `load_program` with the same ``records_coverage``, and not used
            yet; None to load it.
        records_coverage: whether the result contains the coverage, which costs time for each event.
    """
    started = time.monotonic()
    try:
        run = _CaseRun(case, definitions, program, records_coverage=records_coverage)
        failures = [format_failure(failure) for failure in run.failures]
        has_differences = any(
            difference.explained is not None for failure in run.failures for difference in failure.differences
        )
        if has_differences and case.mutations is None:
            failures = _explain_failures(case, definitions, run.failures, failures)
        result = CaseResult(
            failures=(),
            warnings=tuple(run.problems.warnings),
            seconds=0.0,
            golden_lines=run.golden_lines,
            coverage=tuple(run.coverage()),
            only_golden_differs=len(run.failures) == run.golden_failure_count,
            outcome=None if case.mutations is None else run.outcome(),
            incomplete_files=run.incomplete_files,
        )
    except RetalisError as error:
        failures, result = [str(error)], CaseResult((), (), 0.0)
    return result._replace(failures=tuple(failures), seconds=time.monotonic() - started)


class _CaseRun:
    """A run of a case, and its comparison with the expectations.

    Attributes:
        playback: the program in its final state.
        problems: errors and warnings.
        failures: expectations that do not hold.
        golden_lines: actual lines of the golden file; None if the case has none.
        golden_failure_count: number of the failures that concern the golden file.
        incomplete_files: descriptions of what is missing in the bags, which are among the warnings.
        start: start of the case in nanoseconds since the epoch.
    """

    def __init__(
        self,
        case: Case,
        definitions: Definitions,
        program: Optional[ProgramUnderTest],
        records_origins: bool = False,
        records_coverage: bool = False,
    ):
        self._case = case
        self.failures: List[Failure] = []
        self.golden_failure_count = 0
        self._golden_sequence: Optional[ExpectedSequence] = None
        self._outputs: List[RunItem] = []
        self._events: List[RunItem] = []
        with ExitStack() as stack:
            opening = ProblemLog(str)
            with opening.attached():
                bags = open_bags(case, stack)
            self.incomplete_files = tuple(
                printable(str(file)) for bag in bags for file in bag.bag.incomplete_files
            )
            self.start = start_of(case, bags)
            mutator = self._mutator = MessageMutator(case.mutations or (), definitions, self.start)
            bag = create_case_bag(
                case,
                bags,
                list_input_types(case.program),
                definitions,
                None if case.mutations is None else mutator,
            )
            if program is None:
                program = load_program(case, definitions, bag, records_origins, records_coverage)
            self.playback, self.problems = program
            # Warnings as others: a case with expected warnings fails if these are not among them.
            self.problems.warnings += opening.warnings
            self._checks = self._create_checks()
            self._coverage = CoverageRecorder(self.playback.engine) if records_coverage else None
            with self.problems.attached():
                self._play(bag)
        self._compare()

    def coverage(self) -> Iterator[CoveredPart]:
        """Yield the parts of the program with their uses, with the places of the file for a program in it."""
        for part in self._coverage.parts() if self._coverage is not None else ():
            # A place ends with the number of a line, as places of errors do.
            yield part._replace(place=self.problems.rename(part.place))

    def outcome(self) -> TryOutcome:
        """Return the outcome of a try of the fuzzer."""
        expectations = self._case.expectations
        names = [name for _, check in self._checks for name in check.names]
        names += [_name_of("state", number) for number in range(len(expectations.answers))]
        names += [_name_of("errors", number) for number in range(len(expectations.errors))]
        names += [_name_of("warnings", number) for number in range(len(expectations.warnings or ()))]
        broken = [name for failure in self.failures for name in failure.broken]
        messages = () if self._case.mutations else tuple(self._mutator.inputs)
        return TryOutcome(tuple(names), tuple(dict.fromkeys(broken)), messages)

    def _create_checks(self) -> List[Tuple[ExpectedSequence, SequenceCheck]]:
        sequences = self._case.expectations.sequences
        checks = [(sequence, self._create_check(sequence)) for sequence in sequences]
        golden = self._case.expectations.golden
        if golden is not None and golden.exists():
            checks += self._create_golden_check(golden)
        return checks

    def _create_golden_check(self, golden: Path) -> List[Tuple[ExpectedSequence, SequenceCheck]]:
        try:
            items = tuple(read_golden_file(golden))
            place = self._case.expectations.place or self._case.place
            sequence = ExpectedSequence("outputs", "exactly", items, None, place)
            check = self._create_check(sequence, "golden")
        except CaseFileError as error:
            # A failure as others, so that --update replaces the file.
            self._add_golden_failure(Failure(str(error), None, broken=("golden",)))
            return []
        self._golden_sequence = sequence
        return [(sequence, check)]

    def _create_check(self, sequence: ExpectedSequence, name: Optional[str] = None) -> SequenceCheck:
        # A late input moves its results: the fuzzer searches for results that are missing or differ.
        slack = largest_amount(self._case.mutations or ())
        items = tuple(item._replace(within=item.within + slack) for item in sequence.items)
        operators = self.playback.engine.operators
        return SequenceCheck(sequence._replace(items=items), operators, self.start, name)

    def _add_golden_failure(self, failure: Failure) -> None:
        self.failures.append(failure)
        self.golden_failure_count += 1

    def _play(self, bag: CaseBag) -> None:
        self._record_events()
        calls = [
            TimedCall(self.start, lambda: None),
            *map(self._schedule_event, mutate_events(self._case.events, self._case.mutations or ())),
            *(
                self._schedule_query(answer, number, answer.time)
                for number, answer in enumerate(self._case.expectations.answers)
                if answer.time is not None
            ),
        ]
        # Sorting is stable: at the same time, events precede queries.
        calls.sort(key=lambda call: call.time)
        # Cases write messages for the topics that they are about; a bag should have all of them.
        requires_topics = bool(self._case.bags)
        for output in self.playback.run(bag, calls=calls, requires_topics=requires_topics):  # type: ignore[arg-type]
            self._add_output(output)
        for number, answer in enumerate(self._case.expectations.answers):
            if answer.time is None:
                self._check_answer(answer, number)

    def _record_events(self) -> None:
        """Record the events that the expectations concern."""
        checks = [check for sequence, check in self._checks if sequence.subject == "events"]
        if not checks:
            return
        functors: Set[object] = set()
        records_all = False
        for check in checks:
            functors.update(check.functors)
            records_all = records_all or check.concerns_all

        def record(term: Term, start: int, end: int) -> None:
            event_functor = functor_of(term)
            if event_functor in MEMORY_EVENTS or not (records_all or event_functor in functors):
                return
            if len(self._events) < MAX_RECORDED_EVENTS:
                # Copied, because the variables of a rule are bound to other values later.
                self._events.append(RunItem(copy(term), int(start) - self.start, int(end) - self.start))

        self.playback.engine.on_event(record)

    def _schedule_event(self, event: CaseEvent) -> TimedCall:
        engine = self.playback.engine
        term = read_term_text(event.event, engine.operators, EVENT_FLAGS)
        start = self.start + (event.time if event.start is None else event.start)
        end = self.start + (event.time if event.end is None else event.end)

        def process() -> None:
            try:
                engine.event_at(term, start, end)
            except RetalisError as error:
                self.problems.add_error(RetalisError(error.message, event.event.place))

        return TimedCall(self.start + event.time, process)

    def _schedule_query(self, answer: ExpectedAnswer, number: int, instant: int) -> TimedCall:
        return TimedCall(self.start + instant, lambda: self._check_answer(answer, number))

    def _add_output(self, output: Output) -> None:
        if len(self._outputs) < MAX_RECORDED_OUTPUTS:
            instant = output.time - self.start
            self._outputs.append(
                RunItem(copy(output.term), instant, instant, output.topic, output.id, output.definition)
            )

    def _check_answer(self, answer: ExpectedAnswer, number: int) -> None:
        text, place = answer.query
        names = (_name_of("state", number),)
        try:
            # A goal may have solutions without end: one more than expected shows the difference.
            most = 1 if answer.solutions is None else len(answer.solutions) + 1
            solutions = self.playback.engine.query(text, most)
        except RetalisError as error:
            self.failures.append(Failure(f"{answer.title}: {error.message}", place, broken=names))
            return
        problem = compare_solutions(answer, solutions, self.playback.engine.operators, self.start)
        if problem:
            self.failures.append(Failure(f"{answer.title}: {problem}", place, broken=names))

    def _compare(self) -> None:
        names = ProgramNames(self.playback, self._case.program, self._outputs, self._events)
        for sequence, check in self._checks:
            items = self._outputs if sequence.subject == "outputs" else self._events
            failure = check.find_failure(items)
            if sequence is not self._golden_sequence:
                check_slot_names(sequence, self.start, names)
                failure = failure or find_unknown_name(sequence, map(name_of, check.functors), names)
            if failure is not None:
                self.failures.append(failure)
                self.golden_failure_count += sequence is self._golden_sequence
        self.golden_lines = self._compare_golden_file()
        expectations = self._case.expectations
        self._compare_problems("error", self.problems.errors, expectations.errors)
        if expectations.warnings is not None:
            self._compare_problems("warning", self.problems.warnings, expectations.warnings)

    def _compare_golden_file(self) -> Optional[Tuple[str, ...]]:
        golden = self._case.expectations.golden
        if golden is None:
            return None
        if not golden.exists():
            text = f"there is no golden file {golden}: retalis test --update writes it"
            self._add_golden_failure(Failure(text, self._case.expectations.place, broken=("golden",)))
        return tuple(format_golden_lines(self._outputs))

    def _compare_problems(self, kind: str, texts: Sequence[str], expected: Sequence[str]) -> None:
        place = self._case.expectations.place
        for text in texts:
            if not any(part in text for part in expected):
                names = (f"{kind}s (no others)",)
                self.failures.append(Failure(f"unexpected {kind}: {text}", None, broken=names))
        for number, part in enumerate(expected):
            if not any(part in text for text in texts):
                names = (_name_of(f"{kind}s", number),)
                self.failures.append(Failure(f"expected {kind} missing: {part}", place, broken=names))


def _name_of(key: str, number: int) -> str:
    """Return the name of an item of an expectation."""
    return f"{key}[{number}]"


def list_input_types(program: CaseProgram) -> Dict[str, str]:
    """Return the message types of a program's subscribed topics, by name without slashes at the ends."""
    types = {strip_slashes(topic): message_type for topic, message_type in program.topics}
    if program.folder is not None:
        for topic, message_type in read_topics(program.folder / TOPICS).subscribed:
            types.setdefault(strip_slashes(topic), message_type)
    return types


def compare_solutions(
    answer: ExpectedAnswer, solutions: Sequence[Dict[str, Term]], operators: Operators, start: int
) -> str:
    """Return how the solutions of a query differ from the expected ones, or "".

    Args:
        answer: the expected solutions.
        solutions: the solutions.
        operators: operators for the expected terms.
        start: start of the case in nanoseconds since the epoch.

    Raises:
        CaseFileError: if a variable is not one of the query, or a term cannot be read.
    """
    actual = _format_solutions(solutions)
    if answer.solutions is None:
        if bool(solutions) == answer.has_solution:
            return ""
        return "has no solution" if answer.has_solution else f"expected no solution, found {actual}"
    expected = answer.solutions
    is_equal = len(expected) == len(solutions)
    for expected_values, values in zip(expected, solutions):
        for name, text in expected_values.items():
            if name not in values:
                raise CaseFileError(
                    f"the query has no variable {name}{did_you_mean(name, values)}", text.place
                )
            pattern = read_pattern(text, operators, answer.tolerance, start)
            is_equal = is_equal and pattern.matches(values[name])
    if is_equal:
        return ""
    wanted = [", ".join(f"{name}={text.text}" for name, text in values.items()) for values in expected]
    return f"expected {'; '.join(wanted) or 'no solution'}, found {actual}"


def _format_solutions(solutions: Sequence[Dict[str, Term]]) -> str:
    texts = [
        ", ".join(f"{name}={canonical_text(value)}" for name, value in values.items()) or "true"
        for values in solutions
    ]
    return printable("; ".join(texts)) or "no solution"


def _explain_failures(
    case: Case, definitions: Definitions, failures: Sequence[Failure], texts_without_reasons: List[str]
) -> List[str]:
    """Run a case again with the recording of lineage; return its failures with explanations.

    If the second run fails in another way, the texts of the first one are returned.
    """
    run = _CaseRun(case, definitions, None, records_origins=True)
    summaries = [failure.summary for failure in failures]
    if [failure.summary for failure in run.failures] != summaries:
        repeated = _CaseRun(case, definitions, None)
        if [failure.summary for failure in repeated.failures] != summaries:
            reason = "a second run had other results: the program is not deterministic"
        else:
            reason = (
                "no explanation: the run that records the origin of events had other results, and one without it "
                "had the same: the program depends on the recording, or is not deterministic"
            )
        return [*texts_without_reasons, reason]
    remaining = MAX_EXPLANATIONS
    texts = []
    for failure in run.failures:
        lines: List[str] = []
        for difference in failure.differences:
            lines.append(_format_difference(difference))
            if difference.explained is not None and remaining > 0:
                remaining -= 1
                lines += _explain_item(difference.explained, run)
        texts.append(
            format_failure(failure._replace(differences=())) + "".join(f"\n{line}" for line in lines)
        )
    return texts


def _explain_item(item: ExplainedItem, run: _CaseRun) -> List[str]:
    """Return the reason why an output or event happened or not, in indented lines."""
    engine = run.playback.engine
    time = None if item.time is None else run.start + item.time
    if item.is_output:
        lines = explain_output_briefly(engine, ExplainedOutput(item.topic, item.term, time), run.start)
    else:
        assert item.term is not None
        event = item.term
        if item.start is not None and time is not None:
            event = event_request(event, run.start + item.start, time)
        lines = explain_briefly(engine, event, run.start)
    return [f"        {run.problems.rename(line)}" for line in lines]


def format_failure(failure: Failure) -> str:
    """Return the text of a failure, with its place and its listing."""
    place = "" if failure.place is None else f"{failure.place.source}:{failure.place.line}: "
    lines = [f"{place}{failure.summary}", *map(_format_difference, failure.differences)]
    return printable("\n".join(lines))


def _format_difference(difference: Difference) -> str:
    note = f"    ({difference.note})" if difference.note else ""
    return f"  {difference.mark} {difference.text}{note}"
