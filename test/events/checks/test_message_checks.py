"""Messages in rules, memories and subscriptions that do not fit their types."""

from pathlib import Path
from typing import Any, List, Optional, Tuple

import pytest

from retalis import Definitions, Engine
from retalis.engine.program_check import check_program
from retalis.events.checks.check_runner import INFO, run_checks
from retalis.events.checks.message_checks import find_message_mismatches
from retalis.events.checks.program_model import ProgramModel
from retalis.events.program.topic_configuration import TopicEvent, Topics, topic_type
from retalis.messages.type_registry import InstalledTypes

HEADER = "uint32 seq\ntime stamp\nstring frame_id\n"
WARM = f"Header header\nfloat64 warmth\n{'=' * 80}\nMSG: std_msgs/Header\n{HEADER}"


@pytest.fixture
def definitions() -> Definitions:
    definitions_with_types = Definitions()
    definitions_with_types.add("my_msgs/Warm", WARM)
    definitions_with_types.add("my_msgs/Empty", "")
    return definitions_with_types


def warnings(
    definitions: Any,
    folder: Any,
    rules: str = "",
    goals: str = "",
    types: Any = ("my_msgs/Warm", "my_msgs/Empty"),
) -> List[Any]:
    """Return the findings about messages in a program."""
    engine = Engine()
    engine.on_event(lambda term, start, end: None)
    engine.load(rules=rules, goals=goals)
    topics = Topics(tuple([topic_type(f"t{number}", type_name) for number, type_name in enumerate(types)]))
    texts = [str(warning) for warning in engine.warnings(folder, definitions, topics)]
    return [
        text
        for text in texts
        if "__0__" in text and "no producer of" not in text and "stands here only" not in text
    ]


@pytest.mark.parametrize(
    ("rules", "warning"),
    [
        (
            "a <- b where X = my_msgs__0__Warm(std_msgs__0__Header(_, _), 1), X == X.",
            "std_msgs__0__Header/2 does not match its type: std_msgs/Header has 3 slots: seq, stamp, frame_id; "
            "write all of them, or some by name: std_msgs__0__Header{seq: ...}",
        ),
        (
            "a <- my_msgs__0__Empty(_).",
            "my_msgs__0__Empty/1 does not match its type: my_msgs/Empty has 0 slots",
        ),
        (
            "a <- my_msgs__0__Warn(_, _).",
            "there is no message type my_msgs/Warn here; did you mean my_msgs/Warm?",
        ),
    ],
)
def test_message_that_does_not_match_type_is_reported(
    definitions: Definitions, tmp_path: Path, rules: str, warning: str
) -> None:
    (text,) = warnings(definitions, tmp_path, rules)
    assert text.startswith(f"text:1:1: {warning} [RT1104]\n")


def test_memories_and_subscriptions_are_named(definitions: Definitions, tmp_path: Path) -> None:
    goals = "memorize(my_msgs__0__Warm(_), [], _, m, 5)\nsubscribe(my_msgs__0__Warm(_, _, _), [], _, out, s)"
    slots = (
        "does not match its type: my_msgs/Warm has 2 slots: header, warmth; "
        "write all of them, or some by name: my_msgs__0__Warm{header: ...} [RT1104]"
    )
    texts = warnings(definitions, tmp_path, goals=goals)
    assert [text for text in texts if "does not match its type" in text] == [
        f"memory m: my_msgs__0__Warm/1 {slots}",
        f"a subscription of topic out: my_msgs__0__Warm/3 {slots}",
    ]


def test_valid_and_unknown_messages_are_not_reported(definitions: Definitions, tmp_path: Path) -> None:
    rules = "a(X) <- my_msgs__0__Warm(std_msgs__0__Header(_, _, _), X). b <- other__0__Thing(_)."
    assert warnings(definitions, tmp_path, rules) == []


def test_quoted_texts_are_not_reported(definitions: Definitions, tmp_path: Path) -> None:
    header = "std_msgs__0__Header(0, [0,0], {})".format
    right = header("""'"ann"'""")
    rules = f"my_msgs__0__Warm({header('ann')}, 1) <- my_msgs__0__Warm({right}, X) where X = {header('b')}."
    assert warnings(definitions, tmp_path, rules) == []


def test_types_known_later_are_not_reported(definitions: Definitions, tmp_path: Path) -> None:
    rules = "a(X) <- far_msgs__0__WarmFeedback(far_msgs__0__Warm(X), my_msgs__0__Warm(_, _))."
    assert warnings(definitions, tmp_path, rules, types=["my_msgs/Warm", "far_msgs/WarmFeedback"]) == []


def test_misspelt_type_hides_no_other_warning(tmp_path: Path) -> None:
    rules = "a <- std_msgs__0__Strin(_). b <- std_msgs__0__Bool(_, _)."
    texts = warnings(Definitions(), tmp_path, rules, types=["std_msgs/Strng", "std_msgs/Bool"])
    assert [text.split("\n")[0].partition(": ")[2] for text in texts] == [
        "there is no message type std_msgs/Strin here; did you mean std_msgs/String? [RT1104]",
        "std_msgs__0__Bool/2 does not match its type: std_msgs/Bool has 1 slot: data; "
        "write all of them, or some by name: std_msgs__0__Bool{data: ...} [RT1104]",
    ]


FAN = Topics((topic_type("fan/state", "std_msgs/Bool"),), events=(TopicEvent("fan/state", "fan"),))


def findings_of_fan_topic(rules: Any, goals: str = "") -> List[Tuple[Any, ...]]:
    engine = Engine()
    engine.load(rules=rules, goals=goals)
    program = ProgramModel(engine.rules, engine.knowledge, Definitions(), FAN)
    return [(error.message, error.place and error.place.column) for error in find_message_mismatches(program)]


def test_atom_named_as_event_is_not_reported() -> None:
    rules = (
        "a <- says(fan, true) where (access_mem(fan, false, _), device(fan), F = fan(1, 2), F \\== fan(1)).\n"
        "device(fan). says(fan, true) do note(fan) <- fan(_)."
    )
    assert findings_of_fan_topic(rules, "memorize(fan(On), [], fan, fan, 1)") == []


MISSING_SLOT_MESSAGE = "fan/0 does not match its type: std_msgs/Bool has 1 slot: data; write fan{data: ...}"


@pytest.mark.parametrize(
    ("rules", "goals"),
    [
        ("a <- (b where x(fan)) seq fan.", ""),
        ("a <- fan.", ""),
        ("fan <- b.", ""),
        ("fan do note(fan) <- b.", ""),
        ("null_event do event(fan) <- b.", ""),
        ("a(b).", "memorize(fan, [], x, m, 5)"),
        ("a(b).", "subscribe(fan, [], std_msgs__0__Bool(true), out, s)"),
    ],
)
def test_event_without_slots_is_reported(rules: str, goals: str) -> None:
    ((message, _),) = findings_of_fan_topic(rules, goals)
    assert message.endswith(MISSING_SLOT_MESSAGE)


def test_slot_named_in_parentheses_is_reported(tmp_path: Path) -> None:
    (tmp_path / "eventRules.txt").write_text("a <- (b where x(fan)) seq fan.\nc <- fan(data: true).\n")
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt')")
    (tmp_path / "pub_sub.xml").write_text(
        '<publish_subscribe><subscribe_to name="f" msg_type="std_msgs/Bool" event="fan"/></publish_subscribe>'
    )
    texts = [str(finding.problem) for finding in check_program(tmp_path, Definitions())]
    (without_slots,) = [text for text in texts if MISSING_SLOT_MESSAGE in text]
    (in_parentheses,) = [text for text in texts if "in parentheses" in text]
    assert without_slots.startswith(f"{tmp_path}/eventRules.txt:1:27: ")
    assert in_parentheses.startswith(
        f"{tmp_path}/eventRules.txt:2:10: data of std_msgs/Bool is not named in parentheses"
    )
    assert "write fan{data: ...}" in in_parentheses


def output_warnings(definitions: Any, folder: Any, goal: str, rules: str = "") -> List[Any]:
    """Return the findings about a subscription of topic ``out``, whose type is ``my_msgs/Warm``."""
    engine = Engine()
    engine.load(rules=rules, goals=goal)
    topics = Topics(published=(topic_type("out", "my_msgs/Warm"),))
    texts = [str(warning) for warning in engine.warnings(folder, definitions, topics)]
    return [text for text in texts if "topic out, my_msgs/Warm" in text]


@pytest.mark.parametrize(
    "goal",
    [
        "subscribe(seen(H), [], H, out, s1)",
        "subscribe(seen(H), [H = wrapped(Message)], Message, out, s1)",
        "subscribe(seen(_, H) with throttle(1), [], H, out, s1)",
    ],
)
def test_variable_template_may_be_message(definitions: Definitions, tmp_path: Path, goal: str) -> None:
    assert output_warnings(definitions, tmp_path, goal) == []


@pytest.mark.parametrize("form", ["_", "Event", "seen(H)"])
def test_output_that_is_no_message_is_reported(definitions: Definitions, tmp_path: Path, form: str) -> None:
    (text,) = output_warnings(definitions, tmp_path, f"subscribe(seen(H), [], {form}, out, s1)")
    assert "expected my_msgs__0__Warm/2, got seen/1" in text


TWO_FLAGS = (
    '<subscribe_to name="door" msg_type="my_msgs/Flag"/><subscribe_to name="bumper" msg_type="my_msgs/Flag"/>'
)
TWO_WARM = (
    '<subscribe_to name="left" msg_type="my_msgs/Warm"/><subscribe_to name="right" msg_type="my_msgs/Warm"/>'
)


def shared_events(folder: Path, definitions: Any, topics: Any, rules: str) -> List[Any]:
    definitions.add("my_msgs/Flag", "bool on")
    (folder / "pub_sub.xml").write_text(f"<publish_subscribe>{topics}</publish_subscribe>")
    (folder / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt')\n")
    (folder / "eventRules.txt").write_text(f"{rules}\n")
    findings = check_program(folder, definitions)
    return [finding.problem.message for finding in findings if finding.problem.code == "RT1110"]


def test_topics_with_one_event_are_reported(tmp_path: Path, definitions: Definitions) -> None:
    (message,) = shared_events(tmp_path, definitions, TWO_FLAGS, "opened <- my_msgs__0__Flag(true).")
    assert message.startswith("my_msgs__0__Flag/1 is the event of both door and bumper")
    (message,) = shared_events(tmp_path, definitions, TWO_WARM, "warm(W) <- my_msgs__0__Warm(_, W).")
    assert message.startswith("my_msgs__0__Warm/2 is the event of both left and right")


@pytest.mark.parametrize(
    ("topics", "rules"),
    [
        (TWO_FLAGS, "opened <- other(true)."),
        (TWO_FLAGS.replace('Flag"/><', 'Flag" event="door"/><'), "opened <- my_msgs__0__Flag(true)."),
        (TWO_WARM, "warm(F, W) <- my_msgs__0__Warm{header: {frame_id: F}, warmth: W}."),
        (TWO_WARM, "warm(W) <- my_msgs__0__Warm{header: {frame_id: '\"left\"'}, warmth: W}."),
        (TWO_WARM, "warm(H, W) <- my_msgs__0__Warm(H, W)."),
        (TWO_FLAGS[: TWO_FLAGS.index("/>") + 2], "opened <- my_msgs__0__Flag(true)."),
    ],
    ids=["unused", "event", "frame", "one frame", "header", "one topic"],
)
def test_distinguishable_topics_are_not_reported(
    tmp_path: Path, definitions: Definitions, topics: Any, rules: str
) -> None:
    assert shared_events(tmp_path, definitions, topics, rules) == []


def test_type_that_installed_package_lacks_is_reported(tmp_path: Path) -> None:
    types = tmp_path / "types" / "door_msgs" / "msg"
    types.mkdir(parents=True)
    (types / "Door.msg").write_text("bool open\n")
    (tmp_path / "goalPredicates.txt").write_text("compile_event_file('eventRules.txt')\n")
    (tmp_path / "eventRules.txt").write_text("moved(X) <- door_msgs__0__Doors(X).\n")
    topics = [
        '<subscribe_to name="door" msg_type="door_msgs/Door"/>',
        '<publish_to name="moved" msg_type="door_msgs/Movement"/>',
        # A publisher defines the types of a package that is not installed.
        '<subscribe_to name="lift" msg_type="lift_msgs/Lift"/>',
    ]
    (tmp_path / "pub_sub.xml").write_text(
        f"<publish_subscribe>\n{chr(10).join(topics)}\n</publish_subscribe>"
    )
    definitions = Definitions(InstalledTypes(extra_folders=[str(tmp_path / "types")]))
    found = [finding.problem for finding in check_program(tmp_path, definitions)]
    assert [(problem.code, problem.message) for problem in found if problem.code in ("RT1101", "RT1104")] == [
        (
            "RT1101",
            "there is no message type door_msgs/Movement: the installed package door_msgs does not have it",
        ),
        ("RT1104", "there is no message type door_msgs/Doors here; did you mean door_msgs/Door?"),
    ]


def test_advice_for_invalid_topic_is_its_fault(tmp_path: Path, definitions: Definitions) -> None:
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe/>")
    (tmp_path / "goalPredicates.txt").write_text("subscribe(a(X), [], _, 'front door', warn)\n")
    findings = check_program(tmp_path, definitions)
    (message,) = [finding.problem.message for finding in findings if finding.problem.code == "RT1102"]
    assert "publish_to" not in message
    assert message.endswith("found 'front door': ' ' is not allowed in it")


def test_each_subscription_to_invalid_topic_is_reported(tmp_path: Path, definitions: Definitions) -> None:
    (tmp_path / "pub_sub.xml").write_text("<publish_subscribe/>")
    (tmp_path / "goalPredicates.txt").write_text(
        "subscribe(a(X), [], _, 'front door', s1)\nsubscribe(b, [], _, 'front door', s2)\n"
    )
    findings = check_program(tmp_path, definitions)
    places = [finding.problem.place for finding in findings if finding.problem.code == "RT1102"]
    assert [place and place.line for place in places] == [1, 2]


def test_exchanged_topic_and_id_are_named(tmp_path: Path, definitions: Definitions) -> None:
    (tmp_path / "pub_sub.xml").write_text(
        '<publish_subscribe><publish_to name="warn" msg_type="my_msgs/Flag"/></publish_subscribe>'
    )
    (tmp_path / "goalPredicates.txt").write_text("subscribe(a(X), [], my_msgs__0__Flag(X), w1, warn)\n")
    findings = check_program(tmp_path, definitions)
    (message,) = [finding.problem.message for finding in findings if finding.problem.code == "RT1102"]
    assert message.endswith("warn is the id here: write subscribe(Pattern, Conditions, Template, Topic, Id)")


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        (
            "a <- my_msgs__0__Warm(_, w).",
            "warmth of my_msgs/Warm is a number in events: write a number, or the variable W",
        ),
        ("a <- my_msgs__0__Warm(_, warm).", "warmth of my_msgs/Warm is a number in events"),
    ],
)
def test_letter_in_place_of_a_number_may_be_a_variable(
    tmp_path: Path, definitions: Definitions, rules: str, message: str
) -> None:
    (tmp_path / "rules.txt").write_text(rules)
    findings = check_program(tmp_path / "rules.txt", definitions)
    assert [finding.problem.message for finding in findings if finding.problem.code == "RT1105"] == [message]


@pytest.mark.parametrize(
    ("goal", "warning"),
    [
        (
            "ros_service(arm, 'std_srvs/SetBool', std_srvs__0__SetBool_Request(up), X)",
            "text:1:1: request of service arm: std_srvs/SetBool_Request, slot data: expected bool (true or false), "
            "got the atom up [RT1103]",
        ),
        (
            "ros_service(arm, 'std_srvs/srv/SetBool', lift, X, [timeout(1)])",
            "text:1:1: request of service arm: std_srvs/SetBool_Request: expected std_srvs__0__SetBool_Request/1, "
            "got the atom lift [RT1103]",
        ),
        (
            "ros_service('/dock', 'std_srvs/Trigger', std_srvs__0__Trigger_Request, X)",
            "text:1:1: goals may not call /dock [RT1112]",
        ),
        (
            "ros_service(arm, 'arm_srvs/Mov', _, X)",
            "text:1:1: there is no service type arm_srvs/Mov; did you mean arm_srvs/Move? [RT1101]",
        ),
        (
            "ros_service(arm, 'std_srvs/Triger', std_srvs__0__Trigger_Request, X)",
            "text:1:1: there is no service type std_srvs/Triger; did you mean std_srvs/Trigger? [RT1101]",
        ),
        ("ros_service(arm, 'std_srvs/SetBool', std_srvs__0__SetBool_Request(_), X)", None),
        ("ros_service(arm, 'std_srvs/Trigger', std_srvs__0__Trigger_Request, X)", None),
        ("ros_service(arm, 'no_srvs/Type', x, X)", None),
    ],
)
def test_mistake_in_call_of_service_is_reported(tmp_path: Path, goal: str, warning: Optional[str]) -> None:
    (tmp_path / "arm_srvs" / "srv").mkdir(parents=True)
    (tmp_path / "arm_srvs" / "srv" / "Move.srv").write_text("---\n")
    engine = Engine()
    engine.load(f"go(X) do ({goal}).")
    problems = engine.warnings(
        tmp_path,
        Definitions(InstalledTypes([str(tmp_path)], [], include_rosbags=False)),
        find_refusal=lambda name: "" if name == "arm" else f"goals may not call {name}",
    )
    texts = [str(problem).partition("\n")[0] for problem in problems if "no producer" not in str(problem)]
    assert texts == ([] if warning is None else [warning])


CALL = "go({0}) do ros_service({0}, 'std_srvs/Trigger', std_srvs__0__Trigger_Request, x)."


@pytest.mark.parametrize(
    ("services", "permission"),
    [
        (["'/dock'"], "allow_services:=[/dock]"),
        (["'/dock'", "arm", "'/dock'", "Name"], "allow_services:=[/dock,arm]"),
        (["Name"], "allow_services:=[/name/*]"),
    ],
)
def test_permission_to_call_services_is_named_once(services: List[str], permission: str) -> None:
    engine = Engine()
    engine.load("\n".join(CALL.format(service) for service in services))
    program = ProgramModel(engine.rules, engine.knowledge, Definitions(), Topics())
    (hint,) = [finding for finding in run_checks(program) if finding.check == "called-services"]
    assert hint.severity == INFO
    assert (
        hint.problem.message
        == f"goals call services: a node needs the parameter ~allow_services, as in {permission}"
    )


def test_program_without_services_needs_no_permission() -> None:
    engine = Engine()
    engine.load("x <- y.")
    program = ProgramModel(engine.rules, engine.knowledge, Definitions(), Topics())
    assert "called-services" not in [finding.check for finding in run_checks(program)]


@pytest.mark.parametrize(
    ("event", "has_source"),
    [("service_call", True), ("service_reply", True), ("service_failed", True), ("service_refused", False)],
)
def test_events_of_services_have_a_source(tmp_path: Path, event: str, has_source: bool) -> None:
    engine = Engine()
    engine.load(f"x(R) <- {event}(_, R, _).")
    warnings = [problem for problem in engine.warnings(tmp_path, Definitions()) if "producer" in str(problem)]
    assert bool(warnings) is not has_source
