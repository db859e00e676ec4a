"""Workload of the original's experiments: the NAO's streams and programs, with exchangeable names."""

import math
from pathlib import Path
from typing import Callable, Dict, Iterator, List, NamedTuple, Tuple

import retalis.events.language.event_operators  # noqa: F401 -- adds its operators to those of Prolog
from retalis import Definitions, Engine, Operators, StreamClock, Term, atom, deref, functor, make_list
from retalis.prolog.syntax.term_reader import read_program, read_term
from retalis.prolog.syntax.term_writer import write_term

APPLICATION = Path(__file__).resolve().parent.parent / "application_source"
BASE = 1_413_748_205
"""Start of the streams in seconds since the epoch."""

CHAIN = (
    ("/odom", "/base_link", "odom_base", 10),
    ("base_link", "torso", "base_torso", 50),
    ("torso", "Neck", "torso_neck", 10),
    ("Neck", "Head", "neck_head", 10),
    ("Head", "CameraTop_frame", "head_cam", 50),
)


NAMES: Dict[Tuple[str, int], Tuple[str, Tuple[int, ...]]] = {
    ("tf__0__tfMessage", 1): ("robot__0__Links", (1,)),
    ("geometry_msgs__0__TransformStamped", 3): ("robot__0__Link", (3, 1, 2)),
    ("geometry_msgs__0__Transform", 2): ("robot__0__Offset", (2, 1)),
    ("geometry_msgs__0__Vector3", 3): ("robot__0__Step", (3, 2, 1)),
    ("geometry_msgs__0__Quaternion", 4): ("robot__0__Turn", (4, 1, 2, 3)),
    ("ar_pose__0__ARMarkers", 2): ("shop__0__Tags", (2, 1)),
    ("ar_pose__0__ARMarker", 4): ("shop__0__Tag", (4, 3, 2, 1)),
    ("geometry_msgs__0__PoseWithCovariance", 2): ("shop__0__Guess", (2, 1)),
    ("geometry_msgs__0__Pose", 2): ("shop__0__Place", (2, 1)),
    ("geometry_msgs__0__Point", 3): ("shop__0__Spot", (2, 3, 1)),
    ("geometry_msgs__0__PoseStamped", 2): ("shop__0__Found", (2, 1)),
    ("std_msgs__0__Header", 3): ("shop__0__Top", (3, 1, 2)),
    ("tf", 4): ("edge", (4, 2, 1, 3)),
    ("tf", 2): ("offset", (2, 1)),
    ("ar_marker", 5): ("sighting", (5, 3, 2, 1, 4)),
}
"""New name by functor, and the old position of each new argument."""


def renamed(term: Term) -> Term:
    """Return a term with other names and orders of arguments."""
    term = deref(term)
    if term.__class__ is not tuple:
        return term
    return make_renamed(term[0].name, *map(renamed, term[1:]))


def make_renamed(name: str, *arguments: Term) -> Term:
    """Return a compound term with the other name and argument order."""
    found = NAMES.get((name, len(arguments)))
    if found is None:
        return functor(name, len(arguments))(*arguments)
    name, order = found
    return functor(name, len(order))(*[arguments[at - 1] for at in order])


def renamed_program(text: str) -> List[str]:
    """Return the clauses of a program with other names, as texts without full stop."""
    operators = Operators.prolog()
    return [
        write_term(
            renamed(read.term), operators, variable_names={var: name for name, var in read.names.items()}
        )
        for read in read_program(text, operators)
    ]


class Item(NamedTuple):
    """One event of a stream: the term and its instant; None if it is stamped on receipt."""

    term: Term
    instant: "int | None"
    type: str


def quoted(text: str) -> Term:
    """Return the atom of a message's string."""
    return atom(f'"{text}"')


def make_term(name: str, *arguments: Term) -> Term:
    """Return a compound term."""
    return functor(name, len(arguments))(*arguments)


class Messages:
    """The NAO's messages as terms.

    Args:
        make: returns a compound term for a name and arguments.
    """

    def __init__(self, make: Callable[..., Term] = make_term):
        self.make = make

    def numbers(self, name: str, *values: float) -> Term:
        """Return a message of numbers."""
        return self.make(f"geometry_msgs__0__{name}", *values)

    def header(self, seconds: int, nanoseconds: int, frame: str) -> Term:
        """Return a header."""
        return self.make("std_msgs__0__Header", 1, make_list([seconds, nanoseconds]), quoted(frame))

    def transform(self, time: float, parent: str, child: str) -> Term:
        """Return the tf message of one transform at a time after `BASE`."""
        seconds, nanoseconds = BASE + int(time), int((time - int(time)) * 1e9)
        x = math.sin(time)
        pose = self.make(
            "geometry_msgs__0__Transform",
            self.numbers("Vector3", x, x / 10, 0.2),
            self.numbers("Quaternion", 0.0, 0.0, math.sin(x / 2), math.cos(x / 2)),
        )
        header = self.header(seconds, nanoseconds, parent)
        stamped = self.make("geometry_msgs__0__TransformStamped", header, quoted(child), pose)
        return self.make("tf__0__tfMessage", make_list([stamped]))

    def marker(self, time: float, number: int) -> Tuple[Term, int]:
        """Return the message of one observation, and its instant."""
        seconds, nanoseconds = BASE + int(time), int((time - int(time)) * 1e9)
        pose = self.make(
            "geometry_msgs__0__Pose",
            self.numbers("Point", 1.0, 0.5, 0.2),
            self.numbers("Quaternion", 0.0, 0.0, 0.0, 1.0),
        )
        with_covariance = self.make("geometry_msgs__0__PoseWithCovariance", pose, make_list([0.0] * 36))
        header = self.header(seconds, nanoseconds, f"4x4_{number}")
        one = self.make("ar_pose__0__ARMarker", header, number, with_covariance, 50)
        message = self.make("ar_pose__0__ARMarkers", self.header(seconds, nanoseconds, ""), make_list([one]))
        return message, seconds * 10**9 + nanoseconds


def nao_stream(seconds: int, other_names: bool = False) -> List[Item]:
    """Return the NAO's messages in order of time: 1,880 transforms and 7 markers per second.

    Terms with other names are created with them, not renamed: their memory layout affects the measurement.
    """
    pairs = [(parent, child, rate) for parent, child, _, rate in CHAIN]
    pairs += [(f"link{i}", f"link{i}_child", 50) for i in range(1, 36)]
    timed = []
    for parent, child, rate in pairs:
        for k in range(seconds * rate):
            timed.append((k / rate + 0.0005, 0, parent, child))
    for k in range(1, seconds * 7 + 1):
        timed.append(((k - 1) / 7 + 0.01, 1, str(k % 8 + 1), ""))
    timed.sort(key=lambda entry: entry[0])
    messages = Messages(make_renamed if other_names else make_term)
    items = []
    for time, kind, first, second in timed:
        if kind == 0:
            items.append(Item(messages.transform(time, first, second), None, "tf/tfMessage"))
        else:
            items.append(Item(*messages.marker(time, int(first)), "ar_pose/ARMarkers"))
    return items


MEMORIES = "\n".join(
    f"""memorize(tf('"{parent}"', '"{child}"', V, Q), [], tf(V, Q), {name}, 2500)"""
    for parent, child, name, _ in CHAIN
)
SUBSCRIPTIONS = "\n".join(
    f"""subscribe(geometry_msgs__0__PoseStamped(std_msgs__0__Header(_,_,'"4x4_{i}"'),_),[],_,marker{i},m{i})"""
    for i in range(1, 9)
)


def nao_engine(other_names: bool = False) -> Engine:
    """Return an engine with the NAO's rules, its memories and its subscriptions, unrestricted."""
    engine = Engine(StreamClock(0))
    engine.load(goals="set_etalis_flag(event_consumption_policy, unrestricted)")
    rules = (APPLICATION / "eventRules.txt").read_text(encoding="utf-8")
    goals = f"{MEMORIES}\n{SUBSCRIPTIONS}"
    if other_names:
        rules = "\n".join(clause + "." for clause in renamed_program(rules))
        goals = "\n".join(renamed_program(goals.replace("\n", ".\n") + "."))
    engine.load_rules(rules, "eventRules.txt")
    engine.load(goals=goals)
    return engine


def extra_memories(number: int, pattern: str, record: str, size: int) -> str:
    """Return the goals that create further memories."""
    return "\n".join(f"memorize({pattern}, [], {record}, extra{i}, {size})" for i in range(number))


def as_bytes(items: List[Item], definitions: Definitions) -> Iterator[Tuple[bytes, str]]:
    """Yield the messages of a stream as bytes, with their types."""
    for item in items:
        yield definitions.encoder(item.type).encode(item.term), item.type


def term(text: str) -> Term:
    """Return the term of a text."""
    return read_term(text, Operators.prolog()).term
