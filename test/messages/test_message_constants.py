"""Constants of message definitions by name: parsing, errors, output, and definitions that become known later."""

from pathlib import Path
from typing import Any, List

import pytest
from asserting_accessors import fail, place_of
from message_registries import empty_registry, section
from node.in_memory_hosts import DEFINITIONS as HOST_DEFINITIONS
from node.in_memory_hosts import Robot, start_host
from node.memory_transport import MemoryNetwork

from retalis import BagReader, BagWriter, Definitions, Engine, Playback, ProgramErrors, Settings
from retalis.engine.program_check import check_program
from retalis.messages.message_dictionaries import make_message_term
from retalis.messages.message_slots import SlotNames
from retalis.messages.type_definition import PLAIN_STRINGS
from retalis.messages.type_registry import parse_ros2_type
from retalis.prolog.syntax.event_text import to_text
from retalis.prolog.syntax.term_reader import read_term
from retalis.prolog.terms.term_traversal import term_key

BATTERY, LEVEL, ALL = "my_msgs__0__Battery", "my_msgs__0__Level", "my_msgs__0__All"


def definitions() -> Definitions:
    registry = empty_registry()
    registry.add(
        "my_msgs/Battery", "uint8 STATUS_FULL=4\nuint8 STATUS_EMPTY=2\nuint8 status\nfloat32 charge\n"
    )
    registry.add("my_msgs/Level", "byte OK=0\nbyte ERROR=2\nbyte level\nstring name\n")
    registry.add(
        "my_msgs/All",
        "bool YES=true\nstring GREETING=hello\nfloat32 HALF=0.5\nint8 low=-3\nint8 TWO=2\n"
        "float64 x\nint8[] many\nstring text\nbool on\nBattery battery\nLevel[] levels\n",
    )
    return registry


def engine(settings: Any = None) -> Engine:
    return Engine(settings=settings, definitions=definitions())


def read(text: str, operators: Any = None) -> Any:
    return read_term(text, operators or engine().operators).term


READINGS = {
    f"a <- {BATTERY}(S, _) where S == {BATTERY}{{STATUS_FULL}}": f"a <- {BATTERY}(S, _) where S == 4",
    f"a <- {BATTERY}({BATTERY}{{STATUS_FULL}}, _)": f"a <- {BATTERY}(4, _)",
    f"a <- {BATTERY}{{status: {{STATUS_EMPTY}}}}": f"a <- {BATTERY}(2, _)",
    f"{LEVEL}{{level: {{ERROR}}}} <- b": f"{LEVEL}(2, '\"\"') <- b",
    f"a <- {LEVEL}{{level: {BATTERY}{{STATUS_FULL}}}}": f"a <- {LEVEL}(4, _)",
    f"a <- {ALL}{{x: {{TWO}}, many: [{{low}}, 1 | _], on: {{YES}}}}": f"a <- {ALL}(2.0, [-3, 1 | _], _, true, _, _)",
    f"a <- {ALL}{{text: {{GREETING}}, x: {{HALF}}}}": f"a <- {ALL}(0.5, _, '\"hello\"', _, _, _)",
    f"a <- {ALL}{{battery: {{status: {{STATUS_FULL}}}}}}": f"a <- {ALL}(_, _, _, _, {BATTERY}(4, _), _)",
    f"a <- {ALL}{{levels: [{{level: {{ERROR}}}} | _]}}": f"a <- {ALL}(_, _, _, _, _, [{LEVEL}(2, _) | _])",
    f"a(X) :- X is {ALL}{{TWO}} + {ALL}{{low}}": "a(X) :- X is 2 + -3",
    "a <- b(X) where X = {Y}": "a <- b(X) where X = '{}'(Y)",
}


@pytest.mark.parametrize(("text", "expected"), READINGS.items())
def test_constant_is_read_as_its_value(text: str, expected: str) -> None:
    assert term_key(read(text)) == term_key(read(expected))


ERRORS = {
    f"a <- {BATTERY}{{STATUS_FUL}}": (
        len(f"a <- {BATTERY}{{") + 1,
        f"{BATTERY} has no constant STATUS_FUL; did you mean STATUS_FULL?",
    ),
    f"a <- {BATTERY}{{status: {{EMPTY}}}}": (
        len(f"a <- {BATTERY}{{status: {{") + 1,
        f"{BATTERY} has no constant EMPTY; did you mean STATUS_EMPTY?",
    ),
    f"a <- {BATTERY}{{status: {{Other}}}}": (
        len(f"a <- {BATTERY}{{status: {{") + 1,
        f"{BATTERY} has no constant Other; it has STATUS_FULL, STATUS_EMPTY",
    ),
    f"a <- {ALL}{{battery: {{X}}}}": (
        len(f"a <- {ALL}{{battery: {{") + 1,
        'expected the name of a slot before "X"',
    ),
}


@pytest.mark.parametrize(("text", "expected"), ERRORS.items())
def test_unknown_constant_is_reported_at_its_place(text: str, expected: Any) -> None:
    with pytest.raises(ProgramErrors) as errors:
        engine().load_rules(f"{text}.")
    (error,) = errors.value.errors
    assert (place_of(error).column, error.message) == expected


def test_misspelt_type_of_constant_is_reported() -> None:
    with pytest.raises(ProgramErrors, match="no message type std_msgs/Strng; did you mean std_msgs/String?"):
        Engine().load_rules("a <- b(std_msgs__0__Strng{X}).")


def test_number_of_listed_constants_is_limited() -> None:
    registry = empty_registry()
    registry.add("my_msgs/Many", "".join(f"int8 A{number}={number}\n" for number in range(9)))
    with pytest.raises(ProgramErrors, match="no constant Other; it has A0, A1, A2, A3, A4 and 4 more"):
        Engine(definitions=registry).load_rules("a <- b(my_msgs__0__Many{Other}).")


def test_plain_text_of_constant_has_no_quotes() -> None:
    settings = Settings(strings=PLAIN_STRINGS)
    (solution,) = engine(settings).query(f"X = {ALL}{{GREETING}}")
    assert to_text(solution["X"]) == "hello"


def test_topic_event_names_constants_of_its_type() -> None:
    program = engine()
    slot_names = program.operators.message_types
    assert isinstance(slot_names, SlotNames)
    slot_names.set_events({"cell": "my_msgs/Battery"})
    program.load_rules("full <- cell{status: {STATUS_FULL}}. half <- cell(X, _) where X < cell{STATUS_FULL}.")
    outputs: List[str] = []
    program.on_event(lambda term, start, end: outputs.append(to_text(term)))
    program.event("cell(4, 0.5)", 1)
    program.event("cell(2, 0.5)", 2)
    assert [text for text in outputs if "cell" not in text] == ["full", "half"]


def test_constants_of_ros2_definition_are_known() -> None:
    registry = empty_registry()
    text = "byte OK=0\nstring HI='it is'\nbyte level\n"
    definition = parse_ros2_type("my_msgs/msg/Status", text, lambda name: None)
    registry.add("my_msgs/Status", definition.text)
    (solution,) = Engine(definitions=registry).query("X = [my_msgs__0__Status{OK}, my_msgs__0__Status{HI}]")
    assert to_text(solution["X"]) == "[0,'\"it is\"']"


SHOWN_RULES = (
    f"a<-{BATTERY}{{status: {{STATUS_FULL}}, charge: 1}}",
    f"{LEVEL}{{level: {{ERROR}}}}<-b",
    f"a<-{LEVEL}{{level: {BATTERY}{{STATUS_EMPTY}}}}",
    f"a<-{ALL}{{x: {{TWO}}, battery: {{status: {{STATUS_FULL}}}}}}",
)


@pytest.mark.parametrize("text", SHOWN_RULES)
def test_constant_is_shown_by_its_name(text: str) -> None:
    program = engine()
    assert program.show(read(text, program.operators)) == text


def test_other_value_is_shown_as_number() -> None:
    program = engine()
    read(f"a<-{BATTERY}{{status: {{STATUS_FULL}}}}", program.operators)
    other = f"a<-{BATTERY}{{status: 3}}"
    assert program.show(read(other, program.operators)) == other


# ---- definitions that become known later -------------------------------------------------------------

DOOR = "my_msgs/Door"
DOOR_TEXT = "uint8 OPEN=1\nuint8 SHUT=2\nuint8 state\n"
TOPICS = f"""
<publish_subscribe>
  <subscribe_to name="door" msg_type="{DOOR}"/>
  <publish_to name="alarm" msg_type="std_msgs/String"/>
</publish_subscribe>
"""
GOALS = """
compile_event_file('rules.txt')
subscribe(opened, [], std_msgs__0__String('"open"'), alarm, a1)
"""
RULES = "opened <- my_msgs__0__Door(my_msgs__0__Door{OPEN}).\n"


def write_program(folder: Path, rules: str = RULES) -> Path:
    (folder / "pub_sub.xml").write_text(TOPICS)
    (folder / "goalPredicates.txt").write_text(GOALS)
    (folder / "rules.txt").write_text(rules)
    return folder


def write_bag(path: Path) -> Path:
    registry = empty_registry()
    definition = registry.add(DOOR, DOOR_TEXT)
    with BagWriter(path) as writer:
        connection = writer.add("/door", definition)
        for second, state in enumerate((2, 1), 1):
            message = make_message_term(definition, {"state": state})
            writer.write(connection, second * 10**9, registry.encoder(definition).encode(message))
    return path


def played_alarms(playback: Playback, bag: Path) -> List[int]:
    with BagReader(bag) as reader:
        return [output.time for output in playback.run(reader) if output.topic == "alarm"]


LATE_TYPE_WARNING = (
    "the definition of my_msgs/Door came after the program was loaded: its constants have no values until the "
    "program is loaded again; call ~reload, or install the package"
)


def late_type_warnings(caplog: pytest.LogCaptureFixture) -> List[str]:
    return [text for text in caplog.messages if "came after the program was loaded" in text]


def test_bag_defines_constants_of_program(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "doors.bag")
    with BagReader(bag) as reader:
        playback = Playback(write_program(tmp_path), fail, bag=reader)
    assert played_alarms(playback, bag) == [2 * 10**9]


def test_late_definition_is_reported_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    bag = write_bag(tmp_path / "doors.bag")
    playback = Playback(write_program(tmp_path), fail)
    assert played_alarms(playback, bag) == played_alarms(playback, bag) == []
    assert late_type_warnings(caplog) == [LATE_TYPE_WARNING]


def test_late_definition_of_restored_program_is_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    bag = write_bag(tmp_path / "doors.bag")
    state = Playback(write_program(tmp_path), fail).engine.snapshot()
    assert played_alarms(Playback(tmp_path, fail, state=state), bag) == []
    assert late_type_warnings(caplog) == [LATE_TYPE_WARNING]


def test_late_definition_reads_no_file_and_calls_no_goal(tmp_path: Path) -> None:
    write_program(tmp_path)
    with (tmp_path / "goalPredicates.txt").open("a") as goals:
        goals.write("ros_service('/arm/home', 'std_srvs/Trigger', std_srvs__0__Trigger_Request, home)\n")
    called: List[str] = []
    playback = Playback(
        tmp_path,
        fail,
        prepare=lambda engine: engine.on_service_call(lambda call: called.append(call.request.name)),
    )
    (tmp_path / "rules.txt").write_text(f"{RULES}edited <- p.\n")
    played_alarms(playback, write_bag(tmp_path / "doors.bag"))
    assert called == ["/arm/home"]
    assert [rule.name for rule in playback.engine.status().rules] == ["opened"]


def test_reload_gives_constants_of_late_type_their_values(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    network = MemoryNetwork()
    robot = Robot(network)
    robot.subscribe("/alarm")
    host = start_host(network, write_program(tmp_path))
    definition = HOST_DEFINITIONS.add(DOOR, DOOR_TEXT)
    publisher = robot.transport.advertise("/door", definition, 10)
    publisher.send(b"\1")
    assert (robot.received["/alarm"], late_type_warnings(caplog)) == ([], [LATE_TYPE_WARNING])
    host.engine.reload(tmp_path)
    publisher.send(b"\2", b"\1")
    assert robot.received["/alarm"] == ["open"]
    host.transport.shut_down()


def test_failed_reload_is_repeatable_after_late_definition(tmp_path: Path) -> None:
    registry = empty_registry()
    program = Engine(definitions=registry)
    program.load_program(write_program(tmp_path))
    registry.add(DOOR, DOOR_TEXT)
    (tmp_path / "rules.txt").write_text(RULES.replace("OPEN", "OPENED"))
    with pytest.raises(ProgramErrors, match="rules.txt:1:45: my_msgs__0__Door has no constant OPENED"):
        program.reload(tmp_path)
    assert program.pop_late_types() == [DOOR]
    (tmp_path / "rules.txt").write_text(RULES)
    program.reload(tmp_path)
    opened: List[str] = []
    program.on_event(lambda term, start, end: opened.append(to_text(term)))
    program.event("my_msgs__0__Door(1)", 1)
    assert "opened" in opened


def test_reload_with_known_definition_leaves_no_late_type(tmp_path: Path) -> None:
    registry = empty_registry()
    program = Engine(definitions=registry)
    program.load_program(write_program(tmp_path))
    registry.add(DOOR, DOOR_TEXT)
    program.reload(tmp_path)
    assert program.pop_late_types() == []


def test_constants_of_type_without_definition_are_reported(tmp_path: Path) -> None:
    (finding,) = check_program(write_program(tmp_path), Definitions())
    place = place_of(finding.problem)
    assert (place.line, place.column) == (1, 45)
    assert finding.problem.message == (
        "the constants of my_msgs/Door are not known: rules with them match nothing until the program is loaded "
        "again, after a publisher has defined the type"
    )
    registry = Definitions()
    registry.add("my_msgs/Doors", "Door[] doors\n" + section(DOOR, DOOR_TEXT))
    assert list(check_program(tmp_path, registry)) == []


def test_text_outside_of_program_needs_definition() -> None:
    with pytest.raises(ProgramErrors, match="the constants of my_msgs/Door are not known when this is read"):
        engine().load_rules(RULES)
