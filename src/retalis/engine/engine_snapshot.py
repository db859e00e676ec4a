"""Snapshots of an engine: conversion of its state to data, and restoration into a new engine."""

from operator import gt, itemgetter
from pathlib import Path
from typing import (
    Any,
    Callable,
    Dict,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    TypeVar,
)

from ..events.clock.clock import Clock, StreamClock
from ..events.dispatch.dispatcher import Dispatcher
from ..events.knowledge.knowledge_base import MEMORIZE, SUBSCRIBE
from ..events.knowledge.memory import MemoryInstance
from ..events.knowledge.subscriptions import Subscriptions
from ..events.matches.watermarks import Watermarks
from ..events.network.event_rule import EventRule
from ..foundation.errors import RetalisError, UsageError
from ..messages.message_slots import SlotNames
from ..messages.type_definition import STRING_FORMS
from ..prolog.files.source_files import SourceFiles
from ..prolog.swi.use_swi import SwiFile, use_swi
from ..prolog.system.foreign_functions import define_foreign, load_module
from ..prolog.system.prolog_snapshot import (
    PROGRAM,
    VALUES,
    restore_program,
    restore_values,
    snapshot_program,
    snapshot_values,
)
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms.types import Functor, Term
from ..serialization.codec import from_bytes, to_bytes
from ..serialization.columns import DecodedRecords, MemoryRecords, encode_records
from ..serialization.state_fields import (
    StateFields,
    StateOwner,
    field,
    part,
    read_named_values,
    record_of,
    rows_of,
)
from ..serialization.stored_field_types import (
    BOOLEAN,
    CALLABLE_TERM,
    NO_OBJECTS,
    PATH,
    TERM,
    TEXT,
    FieldChange,
    FieldType,
    PlainType,
    ReadContext,
    Value,
    invalid_value,
    mapping_of,
    one_of,
    sequence_of,
    with_path,
)
from .event_input import EventInput, InputTopics, TopicRequest
from .loaded_items import (
    DEPLOYMENTS,
    Deployment,
    LoadedProgram,
    StoredDeployment,
    restore_deployments,
    save_deployments,
)
from .rule_network_snapshot import (
    NETWORK,
    RULES,
    NetworkState,
    StoredRules,
    restore_matches,
    restore_rules,
    snapshot_matches,
    stored_rules,
)
from .runtime.serial_executor import SerialExecutor
from .service_calls import ServiceCalls

Sections = Dict[str, Any]
"""Sections of a state by name, as data that `to_bytes` accepts."""

Result = TypeVar("Result")

SECTION_NAMES = ("values", "matches", "run", "program", "clauses")
"""Sections of a state, besides the records of memories."""


def _definition_type(expected: Functor) -> PlainType[Term]:
    """Return the type of the defining term of a memory or subscription."""

    def check(value: object) -> Term:
        if not isinstance(value, tuple) or value[0] is not expected:
            raise invalid_value(value, f"a term of {expected}")
        return value

    return PlainType(f"a term of {expected}", check)


class StoredMemory(NamedTuple):
    """Definition of a memory, and whether it is active."""

    definition: Term
    is_active: bool


class StoredProgram(NamedTuple):
    """Program of an engine without clauses.

    Attributes:
        subscriptions: definitions of the subscriptions.
        states: terms of the declared states.
        deployments: the deployments by folder.
        topics: topics that goals have subscribed to.
        event_types: message types of events, by name.
        strings: form of strings in messages.
        awaited_types: message types whose constants the program names before their definitions are known.
        foreign_modules: names of modules with foreign predicates.
        swi_files: files that SWI-Prolog has loaded.
    """

    rules: StoredRules
    memories: List[StoredMemory]
    subscriptions: List[Term]
    states: List[Term]
    deployments: Dict[str, StoredDeployment]
    topics: List[TopicRequest]
    event_types: Dict[str, str]
    strings: str
    awaited_types: List[str]
    foreign_modules: List[str]
    swi_files: List[SwiFile]


_STORED_PROGRAM = record_of(
    StoredProgram,
    rules=RULES,
    memories=rows_of(
        StoredMemory,
        definition=_definition_type(MEMORIZE),
        is_active=BOOLEAN,
    ),
    subscriptions=sequence_of(_definition_type(SUBSCRIBE)),
    states=sequence_of(CALLABLE_TERM),
    deployments=DEPLOYMENTS,
    topics=rows_of(
        TopicRequest,
        topic=TEXT,
        message_type=TEXT,
        event=TEXT,
    ),
    event_types=mapping_of(TEXT, TEXT),
    strings=one_of(*STRING_FORMS),
    awaited_types=sequence_of(TEXT),
    foreign_modules=sequence_of(PATH),
    swi_files=rows_of(
        SwiFile,
        name=PATH,
        source=TERM,
        imports=TERM,
    ),
)


class RunState(StateOwner):
    """Clock and counters of an engine.

    Args:
        watermarks: lags of the topics.
        event_input: counts the events.
        dispatcher: numbers the events.
        executor: counts the dropped requests.
        subscriptions: count their outputs.
    """

    STATE = StateFields(
        field("clock_follows_events", BOOLEAN),
        # The clock is restored late, because adding rules and timers may read it or set alarms.
        part("clock"),
        part("watermarks"),
        part("event_input"),
        part("dispatcher"),
        part("executor"),
        part("subscriptions"),
        part("service_calls"),
    )

    def __init__(
        self,
        clock: Clock,
        watermarks: Watermarks,
        event_input: EventInput,
        dispatcher: Dispatcher,
        executor: SerialExecutor,
        subscriptions: Subscriptions,
        service_calls: ServiceCalls,
    ):
        self.clock = clock
        self.watermarks = watermarks
        self.event_input = event_input
        self.dispatcher = dispatcher
        self.executor = executor
        self.subscriptions = subscriptions
        self.service_calls = service_calls

    @property
    def clock_follows_events(self) -> bool:
        """True if the clock follows the timestamps of events; it decides how an engine is created."""
        return self.event_input.stream_clock is not None

    @clock_follows_events.setter
    def clock_follows_events(self, follows: bool) -> None:
        """Ignore the value: an engine can be restored with another clock."""


class ForeignSources:
    """Python modules and files of SWI-Prolog that a restored program loads again.

    Args:
        logic: receives the predicates.
        executor: runs the foreign predicates.
        allow_foreign: whether Python modules may be loaded.
        allow_swi: whether SWI-Prolog may be used.
        warn: receives warnings.
    """

    def __init__(
        self,
        logic: PrologSystem,
        files: SourceFiles,
        executor: SerialExecutor,
        allow_foreign: bool,
        allow_swi: bool,
        warn: Callable[..., None],
    ):
        self._logic = logic
        self._files = files
        self._executor = executor
        self._allow_foreign = allow_foreign
        self._allow_swi = allow_swi
        self._warn = warn

    def load_modules(self, modules: Sequence[str], folder: Optional[Path]) -> None:
        """Load the Python modules of the program again; they must be in its folder."""
        for name in modules:
            # The state is data from outside: it must not make the engine execute a module that the settings or the
            # location would not allow.
            if not self._allow_foreign:
                raise UsageError(
                    f"the program has loaded Python from {name}: the setting allow_foreign is off"
                )
            if folder is None or not _is_inside(folder / name, folder):
                raise UsageError(
                    f"the program has loaded Python from {name}, which is outside of the program's folder"
                )
            files = self._files
            with files.loading(folder):
                define_foreign(self._logic, self._executor, load_module(name, files))
            self._logic.foreign_modules[name] = None

    def load_swi_files(self, files: Sequence[SwiFile], folder: Optional[Path]) -> None:
        """Make SWI-Prolog load the files of the program again; they must be in its folder."""
        for file in files:
            if not self._allow_swi:
                raise UsageError(f"the program has SWI-Prolog load {file.name}: the setting allow_swi is off")
            if file.is_path and (folder is None or not _is_inside(Path(file.name), folder)):
                raise UsageError(
                    f"the program has SWI-Prolog load {file.name}, which is outside of the program's folder"
                )
            with self._files.loading(folder):
                use_swi(self._logic, file, self._warn)
            text = f"SWI-Prolog has loaded {file.name} again: facts that its clauses had asserted are not restored"
            self._warn(text, ("swi", file.name))


def _is_inside(path: Path, folder: Path) -> bool:
    """Return whether a path leads to a file in a folder; links in the folder may lead out of it."""
    # An installed program may consist of links to its sources. After a link, `..` names another folder than the path.
    if ".." not in path.parts and folder.absolute() in path.absolute().parents:
        return True
    return folder.resolve() in path.resolve().parents


class EngineSnapshot:
    """Snapshot of an engine: reads its state, or restores a state into it.

    No event or goal may be active during a call.

    Args:
        run_state: clock and counters.
        input_topics: topics that goals have requested.
        slots: the types of event names.
        deployments: the deployments by folder.
        foreign_sources: loads Python modules and files of SWI-Prolog again.
    """

    def __init__(
        self,
        program: LoadedProgram,
        run_state: RunState,
        input_topics: InputTopics,
        slots: SlotNames,
        deployments: Dict[str, Deployment],
        foreign_sources: ForeignSources,
    ):
        self._program = program
        self._run_state = run_state
        self._input_topics = input_topics
        self._slots = slots
        self._deployments = deployments
        self._foreign_sources = foreign_sources
        self._signature: Any = None

    def capture(self, include_program: bool = True, max_explained_events: Optional[int] = None) -> Sections:
        """Return the state without the records of memories, which are separate sections; see `encode_records`.

        Args:
            include_program: whether the program is included even if it has not changed since the last call.
            max_explained_events: see `snapshot_matches`.

        Raises:
            UsageError: if an event or goal is active.
        """
        logic, rules, knowledge = self._program.logic, self._program.rules, self._program.knowledge
        # While a goal runs, choice points and bindings on the trail belong to its state, and they cannot be saved.
        if rules.dispatcher.current is not None or logic.machine.choices:
            raise UsageError("a goal or callback of an engine cannot take a snapshot of it")
        matches, numbered_rules = snapshot_matches(NetworkState(rules, knowledge), max_explained_events)
        sections = {
            "values": VALUES.encode(snapshot_values(logic)),
            "matches": NETWORK.encode(matches),
            "run": encode_state_alone(self._run_state),
        }
        # The program rarely changes, so checkpoints omit it while its signature stays the same.
        signature = self._program_signature(numbered_rules)
        if include_program or signature != self._signature:
            self._signature = signature
            sections["program"] = _STORED_PROGRAM.encode(self._stored_program(numbered_rules))
            # Clauses are a separate section, because it is large, and its variables are never bound: the caller can
            # encode it after the engine has continued.
            sections["clauses"] = PROGRAM.encode(snapshot_program(logic))
        return sections

    def _program_signature(self, numbered_rules: List[EventRule]) -> object:
        """Return a value that changes whenever the program changes."""
        logic, rules, knowledge = self._program.logic, self._program.rules, self._program.knowledge
        # Lists of objects are compared by identity: definitions are immutable, so a change replaces an object. The
        # objects stay referenced by the signature, so no new object can get the address of an old one.
        return (
            logic.database.change_count,
            len(logic.database.predicates),
            logic.operators.changes(),
            [rule.serial for rule in numbered_rules],
            len(rules.rules),
            rules.all_properties(),
            [rules.flags.get(name) for name in rules.flags.names()],
            list(knowledge.memories),
            knowledge.subscriptions.items(),
            list(knowledge.states),
            self._input_topics.snapshot(),
            dict(self._slots.events),
            self._slots.strings,
            sorted(self._slots.awaited),
            set(rules.files.loaded),
            rules.files.sandbox.program_folders,
            list(logic.foreign_modules),
            list(logic.swi_files),
            sorted(self._deployments),
            list(self._deployments.values()),
        )

    def _stored_program(self, numbered_rules: List[EventRule]) -> StoredProgram:
        logic, knowledge = self._program.logic, self._program.knowledge
        return StoredProgram(
            rules=stored_rules(self._program.rules, numbered_rules),
            memories=[StoredMemory(instance.definition, instance.active) for instance in knowledge.memories],
            subscriptions=[subscription.definition for _, subscription in knowledge.subscriptions.items()],
            states=[state.form.term for state in knowledge.states],
            deployments=save_deployments(self._deployments, logic, knowledge, numbered_rules),
            topics=self._input_topics.snapshot(),
            event_types=dict(self._slots.events),
            strings=self._slots.strings,
            awaited_types=sorted(self._slots.awaited),
            foreign_modules=list(logic.foreign_modules),
            swi_files=[SwiFile(*file) for file in logic.swi_files.values()],
        )

    def encode_records(self) -> List[Any]:
        """Return the encoded records of each memory."""
        return [encode_records(records_since(instance)) for instance in self._program.knowledge.memories]

    def restore(
        self,
        sections: Sections,
        records: Sequence[Sequence[DecodedRecords]],
        folder: Optional[Path],
        changes: Mapping[str, Sequence[FieldChange]],
    ) -> None:
        """Restore a state into a new engine.

        Args:
            sections: a result of `capture`, decoded.
            records: the records of each memory, in batches.
            folder: folder from which Python modules of the program may be loaded.
            changes: changes of records since the format of the sections, see `changes_since`.

        Raises:
            RetalisError: the reason why the state cannot be restored.
        """
        context = ReadContext(changes=changes)
        logic, rules, knowledge = self._program.logic, self._program.rules, self._program.knowledge
        program = _read_section("program", _STORED_PROGRAM, sections, context)
        clauses = _read_section("clauses", PROGRAM, sections, context)
        values = _read_section("values", VALUES, sections, context)
        # The order matters: event types and foreign predicates are needed to compile clauses, clauses to compile
        # rules, and rules and memories to restore partial matches and records. The deployments follow, because they
        # refer to all items by position.
        self._slots.events.update(program.event_types)
        self._slots.fix_strings(program.strings)
        self._slots.awaited.update(program.awaited_types)
        self._foreign_sources.load_modules(program.foreign_modules, folder)
        self._foreign_sources.load_swi_files(program.swi_files, folder)
        restore_program(logic, clauses)
        restore_values(logic, values)
        with logic.precompiling_goals(lambda: [rule.definition.term for rule in rules.rules]):
            numbered_rules = restore_rules(rules, program.rules)
            # Memories are created without emitting events.
            memories = [
                knowledge.memories.create_unreported(definition, is_active)
                for definition, is_active in program.memories
            ]
            for definition in program.subscriptions:
                knowledge.subscriptions.create(definition)
            for definition in program.states:
                knowledge.states.declare(definition)
        run = self._run_state
        read_run = with_path("section run", lambda value: run.STATE.check_state(value, run, context))
        run_state = read_run(sections["run"])
        if len(memories) != len(records):
            raise UsageError("the state is damaged: expected records for each memory")
        for instance, batches in zip(memories, records):
            restore_records(instance, batches)
        network = NetworkState(rules, knowledge)
        with_path(
            "section matches",
            lambda value: restore_matches(network, NETWORK.checker(context)(value), numbered_rules, context),
        )(sections["matches"])
        rules.files.set_loaded(map(Path, program.rules.loaded_files))
        # Each event checks the flag before it looks up a declaration; here it is not known whether there are any.
        rules.declared_events.check_all()
        self._deployments.update(
            restore_deployments(program.deployments, logic, knowledge, rules.timers, numbered_rules)
        )
        self._input_topics.restore(program.topics)
        run.restore(run_state)


def records_since(instance: MemoryInstance, position: int = 0) -> MemoryRecords:
    """Return the records of a memory, or only those after the first ``position`` records."""
    memory = instance.memory
    earlier_count, records = memory.records_since(position)
    return MemoryRecords(
        earlier_count, memory.oldest_number, memory.late_count, instance.has_variables, records
    )


def restore_records(instance: MemoryInstance, batches: Sequence[DecodedRecords]) -> None:
    """Restore the records of a memory from consecutive batches, see `decode_records`."""
    records: List[Tuple[Term, int, int]] = []
    dropped_count = late_count = 0
    for earlier_count, late_count_of_batch, has_variables, terms, ends, starts in batches:
        late_count = late_count_of_batch
        instance.has_variables = instance.has_variables or has_variables
        if not records:
            # The memory had dropped the records before the first batch.
            dropped_count = earlier_count
        elif earlier_count > dropped_count + len(records):
            raise UsageError("records of a memory are missing")
        # Batches may overlap: the records of a later batch replace those of earlier ones.
        del records[max(0, earlier_count - dropped_count) :]
        records += zip(terms, starts, ends)
    # Batches may contain records that the memory had dropped by the time of the last batch.
    surplus_count = max(0, len(records) - max(instance.memory.size, 1))
    records = records[surplus_count:]
    record_ends = list(map(int, map(itemgetter(2), records)))
    # Queries use binary search over the ends.
    if record_ends != sorted(record_ends) or any(map(gt, map(itemgetter(1), records), record_ends)):
        raise UsageError("the records of a memory are not ordered by their ends")
    instance.memory.restore(dropped_count + surplus_count, late_count, record_ends, records)


def create_clock(run_section: object) -> Optional[StreamClock]:
    """Return the clock with which an engine must be created to restore its state.

    Returns:
        A `StreamClock`, or None for the default clock of an engine, which follows the timestamps of events.
    """
    fields = with_path("section run", read_named_values)(run_section)
    return None if BOOLEAN.check(fields.get("clock_follows_events", False)) else StreamClock()


def encode_state(sections: Sections, records: Sequence[Any]) -> Dict[str, bytes]:
    """Return sections and records as bytes by name."""
    encoded = {name: to_bytes(data) for name, data in sections.items()}
    encoded.update({f"memory {position}": to_bytes(data) for position, data in enumerate(records)})
    return encoded


def decode_sections(encoded: Dict[str, bytes]) -> Sections:
    """Return the decoded sections, without records."""
    missing = set(SECTION_NAMES) - encoded.keys()
    if missing:
        raise UsageError(f"the state is damaged: it has no section {', '.join(sorted(missing))}")
    sections = {}
    for name, data in encoded.items():
        if name in SECTION_NAMES:
            sections[name] = from_bytes(data)
        elif not name.startswith("memory "):
            raise UsageError(f"section '{name[:40]}' is unknown")
    return sections


def encode_state_alone(owner: StateOwner) -> List[object]:
    """Return the encoding of the state of an object that refers to no others."""
    return owner.STATE.encode_state(owner.snapshot(), owner, NO_OBJECTS)


def _read_section(name: str, content: FieldType[Value], sections: Sections, context: ReadContext) -> Value:
    return with_path(f"section {name}", content.checker(context))(sections[name])


def convert_errors(restore: Callable[[], Result]) -> Result:
    """Call a function that restores a state; convert any exception to a `UsageError`.

    Raises:
        UsageError: the reason of the failure.
    """
    try:
        return restore()
    except RetalisError as error:
        raise UsageError(error.message) from error
    except Exception as error:
        # A damaged state can raise any exception in the functions that use its values. The new engine is discarded,
        # so no inconsistent state remains.
        raise UsageError(f"the state is damaged ({type(error).__name__}: {error})") from error
