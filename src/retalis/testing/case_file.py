"""Reading of test files.

The tables of keys define the format: the reader accepts their keys, `make_json_schema` describes them for editors,
and the reference page lists them.
"""

from pathlib import Path
from typing import Any, Dict, Iterable, Iterator, List, Mapping, NamedTuple, Optional, Set, Tuple

from ..events.program.topic_configuration import PROGRAM_FILES, find_program_folder
from ..foundation.displayed_text import format_number, quote_shortened
from ..foundation.errors import UsageError
from ..foundation.ros_name_checks import topic_fault
from ..foundation.similar_names import did_you_mean
from ..node.parameters import PARAMETER_DESCRIPTIONS
from ..prolog.terms import timestamps
from .case_definition import (
    DEFAULT_WITHIN,
    Case,
    CaseEvent,
    CaseMessage,
    CaseProgram,
    CountRange,
    Expectations,
    ExpectedAnswer,
    ExpectedItem,
    ExpectedSequence,
    InputBag,
    ServiceAnswer,
    SourceText,
    TermText,
    Tolerance,
)
from .yaml_documents import CaseFileError, YamlValue, parse_yaml

MAX_FILE_BYTES = 20_000_000
"""Maximum size of a test file."""

MAX_REPETITIONS = 1_000_000
"""Maximum number of repetitions of an input."""

DEFAULT_TIMEOUT = 60.0
"""Limit in seconds for the execution of a case."""

MAX_TIMEOUT = 1e6
"""Largest value of ``timeout`` in seconds."""

MAX_SECONDS = 1e9
"""Largest time in seconds since the start of a case, some 30 years."""

MAX_START_SECONDS = 2.0**32 - MAX_SECONDS
"""Largest start of a case in seconds since the epoch, so that all its times are times of ROS 1."""

GOLDEN_SUFFIX = ".jsonl"
"""Suffix of golden files."""

SUFFIXES = (".yaml", ".yml")
"""Suffixes of test files."""

NAME_END = "_test"
"""End of the names of test files outside of folders ``tests``."""

_CASES_KEY = b"cases"
"""Key that all test files have."""

_BEFORE_KEY = b" \t\r{\"'\xef\xbb\xbf"
"""Bytes before the first key of a line; the last three are a byte order mark."""

JsonSchema = Mapping[str, Any]


class MappingKey(NamedTuple):
    """A key of a mapping: its description, and the JSON Schema of its values."""

    description: str
    schema: JsonSchema


_TEXT: JsonSchema = {"type": "string"}
_TEXTS: JsonSchema = {"type": "array", "items": _TEXT}
_TEXTS_OR_NONE: JsonSchema = {"oneOf": [_TEXTS, {"const": "none"}]}
_TERM: JsonSchema = {"type": ["string", "number"]}
_SECONDS: JsonSchema = {"type": "number", "minimum": 0}
_COUNT: JsonSchema = {"type": "integer", "minimum": 0}
_POSITIVE_COUNT: JsonSchema = {"type": "integer", "minimum": 1}
_MESSAGE: JsonSchema = {"type": "object"}


def _reference(name: str) -> JsonSchema:
    return {"$ref": f"#/definitions/{name}"}


def _list_of(schema: JsonSchema) -> JsonSchema:
    return {"type": "array", "items": schema}


COUNT_KEYS = {
    "min": MappingKey("least allowed number", _COUNT),
    "max": MappingKey("largest allowed number", _COUNT),
}

TOLERANCE_KEYS = {
    "absolute": MappingKey("allowed difference", _SECONDS),
    "relative": MappingKey("allowed difference as fraction of the expected number", _SECONDS),
}

INPUT_KEYS = {
    "at": MappingKey("time in seconds since the start of the case", _SECONDS),
    "event": MappingKey("term of an event", _TERM),
    "interval": MappingKey(
        "start and end of the event in seconds; by default it has no duration",
        {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2},
    ),
    "topic": MappingKey("topic of a message", _TEXT),
    "type": MappingKey("message type, `package/Type`; by default that of `pub_sub.xml`", _TEXT),
    "message": MappingKey(
        "slots of the message by name, as `rostopic pub` takes them; others are zero", _MESSAGE
    ),
    "every": MappingKey("seconds between repetitions", {"type": "number", "exclusiveMinimum": 0}),
    "count": MappingKey("number of repetitions", _POSITIVE_COUNT),
    "bag": MappingKey("path of a bag, relative to the file", _TEXT),
    "start": MappingKey("seconds of the bag to skip", _SECONDS),
    "duration": MappingKey("seconds of the bag to play", _SECONDS),
    "topics": MappingKey("topics of the bag to play", _TEXTS),
}

ITEM_KEYS = {
    "at": MappingKey("time of an output, or end of an event, in seconds", _SECONDS),
    "start": MappingKey("start of an event in seconds", {"type": "number"}),
    "within": MappingKey("allowed difference of the times in seconds (0.001)", _SECONDS),
    "term": MappingKey("term of an output; `_` stands for any part", _TERM),
    "event": MappingKey("term of an event; `_` stands for any part", _TERM),
    "message": MappingKey("slots of the published message; others are not compared", _MESSAGE),
    "topic": MappingKey("topic of an output", _TEXT),
    "id": MappingKey("id of the subscription of an output", _TERM),
    "tolerance": MappingKey("allowed difference of numbers", _reference("tolerance")),
    "tolerances": MappingKey(
        "tolerances of slots of the message, by path as `pose.position.x`",
        {"type": "object", "additionalProperties": _reference("tolerance")},
    ),
    "count": MappingKey("allowed number of occurrences, with `contains`", _reference("count")),
}

SERVICE_KEYS = {
    "name": MappingKey("name of a service", _TEXT),
    "request": MappingKey("slots of the requests that this item answers; others are not compared", _MESSAGE),
    "reply": MappingKey("slots of the reply; others are zero", _MESSAGE),
    "error": MappingKey("reason of a failure, in place of a reply", _TEXT),
    "delay": MappingKey("seconds until the answer (0)", _SECONDS),
    "count": MappingKey("number of calls that this item answers; by default all", _POSITIVE_COUNT),
}

RELATION_KEYS = {
    "exactly": MappingKey("all of them, in order", _list_of(_reference("item"))),
    "contains": MappingKey("some of them, in any order", _list_of(_reference("item"))),
    "in_order": MappingKey("some of them, in this order", _list_of(_reference("item"))),
    "none": MappingKey("patterns of what must not occur", _list_of(_reference("item"))),
    "count": MappingKey("allowed number of all", _reference("count")),
}

ANSWER_KEYS = {
    "at": MappingKey("time of the query in seconds; by default the end", _SECONDS),
    "query": MappingKey("a goal", _TEXT),
    "expect": MappingKey(
        "values by variable of the only solution; a list of such mappings, one for each solution; true or false: "
        "whether there is a solution",
        {"type": ["object", "array", "boolean"]},
    ),
    "tolerance": MappingKey("allowed difference of numbers", _reference("tolerance")),
}

EXPECTATION_KEYS = {
    "outputs": MappingKey("published outputs", _reference("relations")),
    "events": MappingKey(
        "events; lists concern the events that have the names in the list", _reference("relations")
    ),
    "golden": MappingKey("file with all expected outputs, written by `--update`", _TEXT),
    "state": MappingKey("answers of queries", _list_of(_reference("answer"))),
    "errors": MappingKey("parts of the expected errors; by default no error is allowed", _TEXTS_OR_NONE),
    "warnings": MappingKey("parts of the expected warnings; by default all are allowed", _TEXTS_OR_NONE),
    "tolerance": MappingKey("default of the items' `tolerance`", _reference("tolerance")),
    "within": MappingKey("default of the items' `within`", _SECONDS),
}

SHARED_KEYS = {
    "program": MappingKey("folder of the program, relative to the file; by default the folder above", _TEXT),
    "rules": MappingKey("rules, in place of a folder", _TEXT),
    "goals": MappingKey("goals, which are called when the rules are loaded", _TEXT),
    "topics": MappingKey(
        "types by topic, in addition to those of `pub_sub.xml`",
        {"type": "object", "additionalProperties": _TEXT},
    ),
    "facts": MappingKey("facts that are added when the program is loaded", _TEXTS),
    "parameters": MappingKey(
        "parameters of the node by name; names with `/` or `~` are ROS parameters for `ros_param`",
        {"type": "object"},
    ),
    "services": MappingKey(
        "answers of ROS services; the first that fits is used", _list_of(_reference("service"))
    ),
    "start": MappingKey(
        "start in seconds since the epoch; by default that of the bags, or 1000000000", {"type": "number"}
    ),
    "timeout": MappingKey(
        "limit in seconds for the execution (60)", {"type": "number", "exclusiveMinimum": 0}
    ),
}

CASE_KEYS = {
    "name": MappingKey("name of the case", _TEXT),
    "input": MappingKey("events, messages and bags", _list_of(_reference("input"))),
    "until": MappingKey(
        "end in seconds, to which clock and alarms advance; by default the last input", _SECONDS
    ),
    "expect": MappingKey(
        "the expectations, or the path of a golden file",
        {"oneOf": [_TEXT, _reference("expectations")]},
    ),
    **SHARED_KEYS,
}

FILE_KEYS = {
    "cases": MappingKey("the cases", {"type": "array", "items": _reference("case"), "minItems": 1}),
    **SHARED_KEYS,
}
"""Keys of a file: values other than the cases are defaults of the cases."""

ANSWERS_KEYS = {name: SHARED_KEYS[name] for name in ("services", "parameters")}
"""Keys of a file with answers for commands."""

_INPUT_KINDS = ("event", "topic", "bag")
_INPUT_KEYS_OF_KIND = {
    "event": ("at", "event", "interval", "every", "count"),
    "topic": ("at", "topic", "type", "message", "every", "count"),
    "bag": ("bag", "start", "duration", "topics"),
}


def make_json_schema() -> Dict[str, Any]:
    """Return the JSON Schema of test files, for editors."""
    items = _object_schema(ITEM_KEYS)
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "Test cases of a retalis program",
        **_object_schema(FILE_KEYS, ("cases",)),
        "definitions": {
            "case": _object_schema(CASE_KEYS, ("name",)),
            "input": {
                **_object_schema(INPUT_KEYS),
                "oneOf": [{"required": [kind]} for kind in _INPUT_KINDS],
            },
            "expectations": _object_schema(EXPECTATION_KEYS),
            "relations": {
                "oneOf": [_list_of(_reference("item")), _object_schema(RELATION_KEYS), {"const": "none"}]
            },
            "item": {"oneOf": [_TERM, items]},
            "service": _object_schema(SERVICE_KEYS, ("name",)),
            "answer": _object_schema(ANSWER_KEYS, ("query",)),
            "count": {"oneOf": [_COUNT, _object_schema(COUNT_KEYS)]},
            "tolerance": {"oneOf": [_SECONDS, _object_schema(TOLERANCE_KEYS)]},
        },
    }


def _object_schema(keys: Mapping[str, MappingKey], required: Tuple[str, ...] = ()) -> Dict[str, Any]:
    schema: Dict[str, Any] = {
        "type": "object",
        "properties": {name: {"description": key.description, **key.schema} for name, key in keys.items()},
        "additionalProperties": False,
    }
    if required:
        schema["required"] = list(required)
    return schema


def read_case_file(path: Path, needs_program: bool = True) -> List[Case]:
    """Read the cases of a file.

    Raises:
        CaseFileError: if the file cannot be read, or its content is wrong, with line and column.
    """
    return parse_case_file(_read_file(path), path, needs_program)


def _read_file(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise CaseFileError(f"{path}: has more than {MAX_FILE_BYTES // 1_000_000} MB")
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise CaseFileError(f"cannot read {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise CaseFileError(f"cannot read {path}: byte {error.start} is not UTF-8 text") from None


def parse_case_file(text: str, path: Path, needs_program: bool = True) -> List[Case]:
    """Return the cases in the text of a file; see `read_case_file`."""
    values = parse_yaml(text, str(path)).mapping(FILE_KEYS)
    if "cases" not in values:
        raise CaseFileError(f"{path}: has no key 'cases'")
    defaults = {name: value for name, value in values.items() if name != "cases"}
    cases: Dict[str, Case] = {}
    golden_files: Set[Path] = set()
    for item in values["cases"].items():
        case = _CaseReader(path, item, defaults, needs_program).read()
        if case.name in cases:
            raise CaseFileError(f"the name {quote_shortened(case.name)} is given twice", case.place)
        cases[case.name] = case
        golden = case.expectations.golden
        if golden is not None:
            if golden in golden_files:
                raise CaseFileError(f"golden file {golden} is that of another case, too", case.place)
            golden_files.add(golden)
    if not cases:
        raise values["cases"].error("cases: expected at least one case")
    return list(cases.values())


class _CaseReader:
    """Reader of a case.

    Args:
        path: the file.
        defaults: values for keys that the case does not have.
        needs_program: whether a case without program is an error.
    """

    def __init__(self, path: Path, case: YamlValue, defaults: Mapping[str, YamlValue], needs_program: bool):
        self._path = path
        self._needs_program = needs_program
        self._case = case
        own_values = case.mapping(CASE_KEYS)
        inherited = dict(defaults)
        # A case names its program in one of two ways, and does not inherit the other one.
        if "rules" in own_values:
            inherited.pop("program", None)
        if "program" in own_values:
            inherited.pop("rules", None)
        self._values = {**inherited, **own_values}

    def read(self) -> Case:
        """Return the case."""
        values = self._values
        if "name" not in values:
            raise self._case.error("a case without name: expected the key 'name'")
        name = values["name"].text()
        events, messages, bags = self._read_input()
        start = values["start"].number(0, MAX_START_SECONDS) if "start" in values else None
        end = _read_time(values, "until")
        expectations = self._read_expectations()
        times = [event.time for event in events] + [message.time for message in messages]
        times += [answer.time for answer in expectations.answers if answer.time is not None]
        self._check_end(end, times)
        return Case(
            name=name,
            program=self._read_program(),
            start=None if start is None else timestamps.from_seconds(start),
            events=tuple(sorted(events, key=lambda event: event.time)),
            messages=tuple(sorted(messages, key=lambda message: message.time)),
            bags=tuple(bags),
            end=end,
            expectations=expectations,
            timeout=self._read_timeout(),
            place=self._case.place,
        )

    def _read_timeout(self) -> float:
        if "timeout" not in self._values:
            return DEFAULT_TIMEOUT
        value = self._values["timeout"]
        timeout = value.number(0)
        if not 0 < timeout <= MAX_TIMEOUT:
            raise value.error(f"timeout: expected more than 0 and at most {MAX_TIMEOUT:g} seconds")
        return timeout

    def _read_program(self) -> CaseProgram:
        values = self._values
        if "rules" in values and "program" in values:
            raise values["rules"].error("rules: expected either 'rules' or 'program'")
        folder = None
        if "program" in values:
            folder = self._path.parent / values["program"].text()
            if not folder.is_dir():
                raise values["program"].error(f"program: there is no folder '{folder}'")
        elif "rules" not in values:
            folder = find_program_folder(self._path)
            if folder is None and self._needs_program:
                raise self._case.error(
                    f"no program: expected {' or '.join(PROGRAM_FILES)} in a folder above, "
                    "or the key 'program' or 'rules'"
                )
        topics = values["topics"].mapping() if "topics" in values else {}
        parameters = values["parameters"].mapping() if "parameters" in values else {}
        return CaseProgram(
            folder=folder,
            rules=_read_source_text(values, "rules"),
            goals=_read_source_text(values, "goals"),
            topics=tuple((topic, value.text()) for topic, value in topics.items()),
            facts=tuple(map(_read_term, values["facts"].items())) if "facts" in values else (),
            parameters=tuple(_read_node_parameters(parameters)),
            path=self._path,
            services=tuple(_read_services(values)),
            ros_parameters=tuple(
                (name, value.plain()) for name, value in parameters.items() if _is_ros_name(name)
            ),
            has_parameters="parameters" in values,
        )

    def _read_input(self) -> Tuple[List[CaseEvent], List[CaseMessage], List[InputBag]]:
        events: List[CaseEvent] = []
        messages: List[CaseMessage] = []
        bags: List[InputBag] = []
        for item in self._values["input"].items() if "input" in self._values else ():
            values = item.mapping(INPUT_KEYS)
            kinds = [kind for kind in _INPUT_KINDS if kind in values]
            if len(kinds) != 1:
                raise item.error(f"{item.name}: expected one of the keys 'event', 'topic' and 'bag'")
            (kind,) = kinds
            for name, value in values.items():
                if name not in _INPUT_KEYS_OF_KIND[kind]:
                    raise value.error(f"{item.name}: key '{name}' does not belong to '{kind}'")
            if kind == "bag":
                bags.append(self._read_bag(item, values))
            elif kind == "event":
                events += self._read_events(item, values)
            else:
                messages += self._read_messages(item, values)
        return events, messages, bags

    def _read_bag(self, item: YamlValue, values: Mapping[str, YamlValue]) -> InputBag:
        path = self._path.parent / values["bag"].text()
        if not path.exists():
            raise values["bag"].error(f"bag: there is no file '{path}'")
        return InputBag(
            path,
            values["start"].number(0) if "start" in values else 0.0,
            values["duration"].number(0) if "duration" in values else None,
            tuple(topic.text() for topic in values["topics"].items()) if "topics" in values else (),
            item.place,
        )

    def _read_events(self, item: YamlValue, values: Mapping[str, YamlValue]) -> Iterator[CaseEvent]:
        start = end = None
        if "interval" in values:
            bounds = values["interval"].items()
            if len(bounds) != 2:
                raise values["interval"].error("interval: expected two times, [start, end]")
            start, end = (
                timestamps.from_seconds(bound.number(-MAX_SECONDS, MAX_SECONDS)) for bound in bounds
            )
            if end < start:
                raise values["interval"].error("interval: the end is before the start")
            if "every" in values:
                raise values["interval"].error("interval: cannot be repeated: write the events one by one")
        event = _read_term(values["event"])
        for time in _read_times(item, values, end):
            yield CaseEvent(time, start, end, event)

    def _read_messages(self, item: YamlValue, values: Mapping[str, YamlValue]) -> Iterator[CaseMessage]:
        type_name = values["type"].text() if "type" in values else None
        value = values.get("message")
        if value is not None:
            value.mapping()
        for time in _read_times(item, values, None):
            yield CaseMessage(time, values["topic"].text(), type_name, value, item.place)

    def _read_golden_path(self, value: YamlValue) -> Path:
        path = self._path.parent / value.text()
        # --update writes this file, so that a misspelt word must not be taken for its name.
        if path.suffix != GOLDEN_SUFFIX:
            raise value.error(
                f"{value.name}: expected expectations, or the path of a golden file that ends with {GOLDEN_SUFFIX}"
            )
        return path

    def _check_end(self, end: Optional[int], times: Iterable[int]) -> None:
        """Reject input and queries after the end of the case."""
        latest = max(times, default=0)
        if end is not None and latest > end:
            raise self._values["until"].error(
                f"until: {format_number(end / timestamps.SECOND)} s is before the last input or query, "
                f"at {format_number(latest / timestamps.SECOND)} s"
            )

    def _read_expectations(self) -> Expectations:
        value = self._values.get("expect")
        if value is None:
            raise self._case.error("a case without expectations: expected the key 'expect'")
        if not value.is_mapping:
            return Expectations(golden=self._read_golden_path(value), place=value.place)
        values = value.mapping(EXPECTATION_KEYS)
        default_tolerance = _read_tolerance(values.get("tolerance"), Tolerance())
        within = _read_time(values, "within")
        items = _ItemReader(default_tolerance, DEFAULT_WITHIN if within is None else within)
        sequences: List[ExpectedSequence] = []
        for subject in ("outputs", "events"):
            if subject in values:
                sequences += items.read_sequences(subject, values[subject])
        answers = values["state"].items() if "state" in values else []
        return Expectations(
            tuple(sequences),
            self._read_golden_path(values["golden"]) if "golden" in values else None,
            tuple(_read_answer(answer, default_tolerance) for answer in answers),
            _read_texts(values, "errors") or (),
            _read_texts(values, "warnings"),
            value.place,
        )


class _ItemReader:
    """Reader of expected outputs and events.

    Args:
        tolerance: default tolerance of numbers.
        within: default tolerance of times.
    """

    def __init__(self, tolerance: Tolerance, within: int):
        self._tolerance = tolerance
        self._within = within

    def read_sequences(self, subject: str, value: YamlValue) -> Iterator[ExpectedSequence]:
        """Yield the expectations of a subject, ``outputs`` or ``events``."""
        if value.is_text and value.text() == "none":
            if subject == "events":
                raise value.error("events: expected a list of the events that must not occur: none: [TERM]")
            yield ExpectedSequence(subject, "exactly", (), None, value.place)
            return
        if value.is_list:
            if subject == "events" and not value.items():
                raise value.error("events: an empty list expects nothing: write none: [TERM]")
            yield ExpectedSequence(subject, "exactly", self._read_items(subject, value), None, value.place)
            return
        for relation, content in value.mapping(RELATION_KEYS).items():
            if relation == "count":
                yield ExpectedSequence(subject, relation, (), _read_count(content), content.place)
            else:
                items = self._read_items(subject, content, has_counts=relation == "contains")
                if not items and (subject, relation) != ("outputs", "exactly"):
                    raise content.error(
                        f"{relation}: an empty list expects nothing: expected at least one item"
                    )
                yield ExpectedSequence(subject, relation, items, None, content.place)

    def _read_items(
        self, subject: str, value: YamlValue, has_counts: bool = False
    ) -> Tuple[ExpectedItem, ...]:
        return tuple(self._read_item(subject, item, has_counts) for item in value.items())

    def _read_item(self, subject: str, item: YamlValue, has_counts: bool) -> ExpectedItem:
        term_key, other_key = ("term", "event") if subject == "outputs" else ("event", "term")
        values = item.mapping(ITEM_KEYS) if item.is_mapping else {term_key: item}
        forbidden = [other_key]
        forbidden += ["start"] if subject == "outputs" else ["topic", "id", "message", "tolerances"]
        forbidden += [] if has_counts else ["count"]
        for name in forbidden:
            if name in values:
                reason = "only 'contains' has counts" if name == "count" else f"not a key of {subject}"
                raise values[name].error(f"{item.name}: key '{name}': {reason}")
        if term_key not in values and (subject == "events" or not {"message", "topic"} & set(values)):
            raise item.error(f"{item.name}: expected the key '{term_key}'")
        within = _read_time(values, "within")
        tolerance = _read_tolerance(values.get("tolerance"), self._tolerance)
        slots = values["tolerances"].mapping() if "tolerances" in values else {}
        if "message" in values:
            values["message"].mapping()
        return ExpectedItem(
            term=_read_term(values[term_key]) if term_key in values else None,
            message=values.get("message"),
            topic=values["topic"].text() if "topic" in values else None,
            id=_read_term(values["id"]) if "id" in values else None,
            time=_read_time(values, "at"),
            start=timestamps.from_seconds(values["start"].number()) if "start" in values else None,
            within=self._within if within is None else within,
            tolerance=tolerance,
            slot_tolerances={name: _read_tolerance(value, tolerance) for name, value in slots.items()},
            occurrences=_read_count(values["count"]) if "count" in values else None,
            place=item.place,
        )


def _read_times(item: YamlValue, values: Mapping[str, YamlValue], default: Optional[int]) -> Iterable[int]:
    """Return the times of an input in nanoseconds.

    Raises:
        CaseFileError: if there is no time, or a repetition without interval.
    """
    time = _read_time(values, "at")
    if time is None:
        time = default
    if time is None:
        raise item.error(f"{item.name}: expected the key 'at'")
    if time < 0:
        raise values["interval"].error(
            "interval: the end is before the start of the case: expected the key 'at'"
        )
    if "every" not in values:
        if "count" in values:
            raise values["count"].error("count: expected the key 'every', too")
        return (time,)
    if "count" not in values:
        raise values["every"].error("every: expected the key 'count', too")
    count = values["count"].integer(1)
    if count > MAX_REPETITIONS:
        raise values["count"].error(f"count: expected at most {MAX_REPETITIONS}")
    period = values["every"].number(0, MAX_SECONDS)
    if not period:
        raise values["every"].error("every: expected more than 0 seconds")
    # Each time is rounded by itself, so that errors do not add up.
    return (time + round(number * period * timestamps.SECOND) for number in range(count))


def _read_time(values: Mapping[str, YamlValue], name: str) -> Optional[int]:
    return timestamps.from_seconds(values[name].number(0, MAX_SECONDS)) if name in values else None


def _read_term(value: YamlValue) -> TermText:
    return TermText(value.text(), value.place)


def _read_texts(values: Mapping[str, YamlValue], name: str) -> Optional[Tuple[str, ...]]:
    if name not in values:
        return None
    value = values[name]
    if value.is_text and value.text() == "none":
        return ()
    return tuple(item.text() for item in value.items())


def _is_ros_name(name: str) -> bool:
    """Return whether a parameter is one that goals read, and not one of the node."""
    return name.startswith(("/", "~"))


def _read_node_parameters(parameters: Mapping[str, YamlValue]) -> Iterator[Tuple[str, Any]]:
    """Yield the parameters of the node with their values.

    Raises:
        CaseFileError: if the node has no such parameter, or a case cannot set it.
    """
    for name, value in parameters.items():
        if _is_ros_name(name):
            continue
        if name not in PARAMETER_DESCRIPTIONS or name == "program":
            hint = did_you_mean(name, PARAMETER_DESCRIPTIONS) or f"; a ROS parameter is written '/{name}'"
            raise value.error(
                f"parameters: the node has no parameter {quote_shortened(name)} for cases{hint}"
            )
        yield name, value.plain()


def _read_services(values: Mapping[str, YamlValue]) -> Iterator[ServiceAnswer]:
    for item in values["services"].items() if "services" in values else ():
        keys = item.mapping(SERVICE_KEYS)
        if "name" not in keys:
            raise item.error(f"{item.name}: expected the key 'name'")
        if ("reply" in keys) == ("error" in keys):
            raise item.error(f"{item.name}: expected either the key 'reply' or the key 'error'")
        name = keys["name"].text()
        fault = topic_fault(name)
        if fault is not None:
            raise keys["name"].error(f"name: {fault}")
        yield ServiceAnswer(
            name,
            keys.get("request"),
            keys.get("reply"),
            keys["error"].text() if "error" in keys else "",
            _read_time(keys, "delay") or 0,
            keys["count"].integer(1) if "count" in keys else None,
            item.place,
        )


class RosAnswers(NamedTuple):
    """Answers of ROS services, and values of ROS parameters.

    Attributes:
        services: the answers of services; None if the file has no such key.
        parameters: the parameters by name; None if the file has no such key.
    """

    services: Optional[Tuple[ServiceAnswer, ...]]
    parameters: Optional[Tuple[Tuple[str, Any], ...]]


def read_answers_file(path: Path) -> RosAnswers:
    """Read a file with the keys ``services`` and ``parameters`` of test files.

    Raises:
        CaseFileError: if the file cannot be read, or its content is wrong.
    """
    values = parse_yaml(_read_file(path), str(path)).mapping(ANSWERS_KEYS)
    parameters = values["parameters"].mapping() if "parameters" in values else None
    return RosAnswers(
        tuple(_read_services(values)) if "services" in values else None,
        None if parameters is None else tuple((name, value.plain()) for name, value in parameters.items()),
    )


def _read_source_text(values: Mapping[str, YamlValue], name: str) -> Optional[SourceText]:
    if name not in values:
        return None
    value = values[name]
    if value.is_folded:
        raise value.error(f"{name}: a folded text (>) loses the lines of the program: write | in place of >")
    return SourceText(value.text(), value.first_text_line)


def _read_tolerance(value: Optional[YamlValue], default: Tolerance) -> Tolerance:
    if value is None:
        return default
    if not value.is_mapping:
        return Tolerance(value.number(0), 0.0)
    values = value.mapping(TOLERANCE_KEYS)
    return Tolerance(
        values["absolute"].number(0) if "absolute" in values else 0.0,
        values["relative"].number(0) if "relative" in values else 0.0,
    )


def _read_count(value: YamlValue) -> CountRange:
    if not value.is_mapping:
        number = value.integer()
        return CountRange(number, number)
    values = value.mapping(COUNT_KEYS)
    count = CountRange(
        values["min"].integer() if "min" in values else 0,
        values["max"].integer() if "max" in values else None,
    )
    if count.maximum is not None and count.maximum < count.minimum:
        raise value.error(f"{value.name}: max is less than min")
    return count


def _read_answer(answer: YamlValue, default_tolerance: Tolerance) -> ExpectedAnswer:
    values = answer.mapping(ANSWER_KEYS)
    if "query" not in values:
        raise answer.error(f"{answer.name}: expected the key 'query'")
    expected = values.get("expect")
    solutions: Optional[Tuple[Dict[str, TermText], ...]] = None
    has_solution = True
    if expected is None or not (expected.is_mapping or expected.is_list):
        has_solution = expected is None or expected.boolean()
    else:
        mappings = [expected] if expected.is_mapping else expected.items()
        solutions = tuple(
            {name: _read_term(value) for name, value in mapping.mapping().items()} for mapping in mappings
        )
        has_solution = bool(solutions)
    return ExpectedAnswer(
        _read_time(values, "at"),
        _read_term(values["query"]),
        solutions,
        has_solution,
        _read_tolerance(values.get("tolerance"), default_tolerance),
        answer.place,
    )


def list_case_files(paths: Iterable[Path]) -> Tuple[List[Path], List[Path]]:
    """Return the test files at the given paths, and the files that are skipped.

    Test files are files as given, and below folders ``tests/*.yaml`` and ``*_test.yaml``, also with suffix ``.yml``.
    Hidden folders are skipped without mention, and files in folders ``tests`` are skipped if they have no key
    ``cases``, because they are for something else.

    Raises:
        UsageError: if a path does not exist.
    """
    files: Dict[Path, None] = {}
    skipped: Dict[Path, None] = {}
    for path in paths:
        if path.is_file():
            files[path] = None
        elif path.is_dir():
            for file in sorted(_find_below(path)):
                (skipped if is_foreign_file(file) else files)[file] = None
        else:
            raise UsageError(f"{path} does not exist: expected a test file, or a folder with such files")
    return list(files), list(skipped)


def _find_below(folder: Path) -> Iterator[Path]:
    for path in folder.rglob("*.y*ml"):
        names = path.relative_to(folder).parts
        if is_case_file(path.absolute()) and not any(name.startswith(".") for name in names):
            yield path


def is_case_file(path: Path) -> bool:
    """Return whether an absolute path is named as a test file."""
    return path.suffix in SUFFIXES and (path.parent.name == "tests" or path.stem.endswith(NAME_END))


def is_foreign_file(path: Path) -> bool:
    """Return whether a file in a folder ``tests`` is for something else: its text has no key ``cases``.

    A file that cannot be read is not foreign: the reader reports the reason.
    """
    if path.stem.endswith(NAME_END):
        return False
    try:
        with path.open("rb") as file:
            lines = file.read(MAX_FILE_BYTES).splitlines()
    except OSError:
        return False
    return not any(line.lstrip(_BEFORE_KEY).startswith(_CASES_KEY) for line in lines)
