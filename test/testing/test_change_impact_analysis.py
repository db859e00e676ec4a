"""Parts of two versions of a program that can differ; a comparison of parts has the result of whole runs."""

from contextlib import nullcontext
from functools import partial
from pathlib import Path
from random import Random
from typing import Any, Dict, List, Sequence, Tuple

import pytest
from nightly_round_numbers import round_numbers
from oracle.rule_notation import write_rule
from oracle.strategies import ARITY, Generator, event_name

from retalis import BagReader, BagWriter, Definitions, Playback, RetalisError, Term, functor
from retalis.playback.bag_locations import Bag
from retalis.prolog.syntax.term_writer import canonical_text
from retalis.testing.change_impact_analysis import Extent
from retalis.testing.output_changes import (
    Comparison,
    OutputChange,
    PlainOutput,
    Version,
    compare_versions,
    find_changes,
)

CASES_PER_ROUND = 10

DEFINITIONS = Definitions()
TYPES = {
    name: DEFINITIONS.add(
        f"test_msgs/{name.upper()}", "\n".join(f"int64 x{number}" for number in range(arity))
    )
    for name, arity in ARITY.items()
}
TOPICS = "".join(
    f'<subscribe_to name="{name}" msg_type="{definition.name}" event="{name}"/>'
    for name, definition in TYPES.items()
)


def write_bag(path: Path, messages: Sequence[Tuple[int, Term]], topics: str = "abcd") -> None:
    """Write messages, whose topics have the names of the terms, at times in seconds."""
    with BagWriter(path) as bag:
        connections = {name: bag.add(f"/{name}", TYPES[name]) for name in topics}
        for time, term in sorted(messages, key=lambda message: message[0]):
            name = event_name(term)
            if name in connections:
                arguments = term[1:] if isinstance(term, tuple) else ()
                data = b"".join(number.to_bytes(8, "little", signed=True) for number in arguments)
                bag.write(connections[name], time * 10**9, data)


def write_program(
    folder: Path, rules: Sequence[str], goals: Sequence[str] = (), topics: str = TOPICS
) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "pub_sub.xml").write_text(f"<publish_subscribe>{topics}</publish_subscribe>")
    (folder / "goalPredicates.txt").write_text("\n".join([*goals, "compile_event_file('eventRules.txt').\n"]))
    (folder / "eventRules.txt").write_text("\n".join([*rules, ""]))
    return folder


def load(folder: Path, bag: Bag, make_handler: Any = None) -> Playback:
    errors: List[RetalisError] = []
    handler = {} if make_handler is None else {"make_handler": make_handler}
    playback = Playback(folder, errors.append, bag=bag, definitions=DEFINITIONS, **handler)
    if errors:
        raise errors[0]
    return playback


def compare(folders: Sequence[Path], path: Path, **options: Any) -> Comparison:
    with BagReader(path) as bag:
        old, new = (Version(folder, partial(load, folder, bag), nullcontext) for folder in folders)
        return compare_versions(old, new, bag, **options)


def compare_whole_runs(folders: Sequence[Path], path: Path) -> List[OutputChange]:
    """Return the changes between the outputs of two separate runs of the whole programs."""
    runs = []
    for folder in folders:
        with BagReader(path) as bag:
            outputs = list(load(folder, bag).run(bag))
        runs.append(
            [PlainOutput(int(output.time), output.topic, canonical_text(output.term)) for output in outputs]
        )
    return find_changes(runs[0], runs[1])


def without_reasons(comparison: Comparison) -> List[OutputChange]:
    return [change._replace(reasons=()) for change in comparison.changes]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a bag: a(1), b(2), a(3), b(4) at seconds 1 to 4."""
    write_bag(
        tmp_path / "some.bag",
        [(number, functor("ab"[1 - number % 2], 1)(number)) for number in (1, 2, 3, 4)],
        "ab",
    )
    return tmp_path


RULES = [
    "big(X) :- X > 1.",
    "low(X) <- a(X) where X < 9.",
    "high(X) <- a(X) where big(X).",
    "both(X, Y) <- low(X) seq b(Y).",
    "made <- d do new_event(m(1), 3, 0).",
]
GOALS = [
    f"subscribe({event}, [], _, t_{event.split('(')[0]}, s)" for event in ("high(_)", "both(_, _)", "m(_)")
]


@pytest.mark.parametrize(
    ("replaced", "rules", "extent"),
    [
        # Comments, layout, names of variables.
        ((), ["% new", "low(Value) <- a(Value)", "  where Value < 9."], Extent.EQUAL),
        # A rule with one that awaits its events; `high` is not run.
        ((1,), ["low(X) <- a(X) where X < 3."], Extent.PART),
        # The bag has no messages d, but those of the other branch.
        ((1,), ["low(1) <- a(_) or d."], Extent.PART),
        # A condition that creates a text.
        ((1,), ["low(X) <- a(X) where (format(atom(T), '~w', [X]), T == '1')."], Extent.PART),
        # A goal that may call others.
        ((1,), ["low(X) <- a(X) where (format(atom(T), '~p', [X]), T == '1')."], Extent.WHOLE),
        # A property of the rules without a label.
        ((), ["event_rule_property(unlabeled, window, 0.5)."], Extent.PART),
        # A predicate.
        ((0,), ["big(X) :- X > 3."], Extent.PART),
        # The bag has no messages d.
        ((4,), ["made <- d do new_event(m(2), 3, 0)."], Extent.UNREACHED),
        # A dynamic predicate may affect every rule.
        ((1,), ["low(X) <- a(X) where X < 9 do assertz(seen(X)).", ":- dynamic seen/1."], Extent.WHOLE),
    ],
)
def test_difference_has_extent(folder: Path, replaced: Any, rules: List[str], extent: Extent) -> None:
    new_rules = [rule for number, rule in enumerate(RULES) if number not in replaced]
    if extent is Extent.EQUAL:
        new_rules = [RULES[0], *rules, *RULES[2:]]
    else:
        new_rules += rules
    folders = [write_program(folder / "old", RULES, GOALS), write_program(folder / "new", new_rules, GOALS)]
    comparison = compare(folders, folder / "some.bag")
    assert comparison.extent is extent
    assert without_reasons(comparison) == compare_whole_runs(folders, folder / "some.bag")
    assert comparison.changes or extent is not Extent.PART


def test_bag_with_topic_of_one_version_is_read(folder: Path) -> None:
    topics = TOPICS + '<subscribe_to name="a_or_b" msg_type="test_msgs/A" event="unused"/>'
    folders = [
        write_program(folder / "old", RULES, GOALS),
        write_program(folder / "new", RULES, GOALS, topics),
    ]
    assert compare(folders, folder / "some.bag").extent is Extent.UNREACHED
    # Its type may be another one, which is an error.
    write_program(folder / "new", RULES, GOALS, topics.replace("a_or_b", "c"))
    write_program(folder / "old", RULES, GOALS, TOPICS.replace('name="c"', 'name="unused"'))
    write_bag(folder / "other.bag", [], "c")
    assert compare(folders, folder / "other.bag").extent is Extent.PART


def test_rules_in_another_order_are_different(folder: Path) -> None:
    first, second, last = "low(1) <- a(_).", "low(2) <- a(_).", "last(X) <- low(X) and b(_)."
    goals = ["subscribe(last(_), [], _, t, s)", "subscribe(high(_), [], _, t_high, s)"]
    folders = [
        write_program(folder / "old", [*RULES[:3], first, second, last], goals),
        write_program(folder / "new", [*RULES[:3], second, first, last], goals),
    ]
    comparison = compare(folders, folder / "some.bag")
    assert comparison.extent is Extent.PART
    assert len(comparison.changes) == 2
    assert without_reasons(comparison) == compare_whole_runs(folders, folder / "some.bag")


class ProgramPairs:
    """Random pairs of programs with a recording."""

    def __init__(self, seed: int):
        self.random = random = Random(seed)
        self.generator = Generator(
            random.choice, streams=random.random() < 0.4, instants=True, overlaps=random.random() < 0.2
        )

    def draw_rules(self) -> List[str]:
        """Draw rules and clauses; later rules may await the events of earlier ones."""
        rules = [f"big(V) :- V > {self.random.choice([0, 1, 2])}."]
        self.messages: List[Any] = []
        drawn = []
        for name in ("m", "n", "o", "p", "q")[: self.random.choice([2, 3, 4, 5])]:
            rule = self.generator.rule(name, self.random.choice([0, 1, 2, 3]), bound_only=True)
            self.generator.names[name] = len(rule.head) - 1 if rule.head.__class__ is tuple else 0
            drawn.append(rule)
            rules.append(write_rule(rule, "V{}"))
        rules += self.random.sample(
            [
                "r(V) <- a(V) where big(V).",
                "s(V) <- b(V) do new_event(r(V), 11, 0).",
                "s(W) <- (r(V) seq c(V, W)) within 5.",
                "m(V) <- b(V).",
            ],
            2,
        )
        stream = self.generator.stream(self.random.choice([10, 20, 30]), drawn)
        self.messages = [(end + 100, _make_message(term)) for term, _, end in stream]
        self.random.shuffle(rules)
        return rules

    def change(self, rules: List[str]) -> List[str]:
        """Return the rules with a change or two."""
        changed = list(rules)
        for _ in range(self.random.choice([1, 1, 2])):
            kind = self.random.choice(["drop", "move", "replace", "add", "condition"])
            position = self.random.randrange(len(changed)) if changed else 0
            if kind in ("drop", "replace", "move") and changed:
                removed = changed.pop(position)
                if kind == "move":
                    changed.insert(self.random.randrange(len(changed) + 1), removed)
            if kind in ("add", "replace"):
                name = self.random.choice(["m", "n", "u"])
                rule = self.generator.rule(name, self.random.choice([0, 1, 2]), bound_only=True)
                changed.insert(position, write_rule(rule, "V{}"))
            if kind == "condition":
                changed = [
                    rule.replace("V > 1", "V > 0").replace("where big(V)", "where V > 1") for rule in changed
                ]
        return changed


def _make_message(term: Any) -> Term:
    """Return an event with integers in place of other arguments, so that it fits its message type."""
    if term.__class__ is not tuple:
        return term
    return (term[0], *(value if value.__class__ is int else 3 for value in term[1:]))


def run_random_pair(seed: int, folder: Path) -> Extent:
    """Compare a random pair; return its extent."""
    pairs = ProgramPairs(seed)
    random = pairs.random
    rules = pairs.draw_rules()
    policy = random.choice(["recent", "unrestricted", "chronological"])
    goals = [
        f"set_etalis_flag(event_consumption_policy, {policy})",
        *(
            f"subscribe({name}{arguments}{random.choice(['', '', ' with throttle(2)', ' with debounce(1)'])}, [], _, "
            f"t_{name}, {number})"
            for name in "mnopqrsu"
            for number, arguments in enumerate(["", "(_)"])
        ),
    ]
    new_goals, new_topics = list(goals), TOPICS
    if random.random() < 0.1:
        del new_goals[random.randrange(1, len(goals))]
    if random.random() < 0.1:
        new_topics = TOPICS.replace('event="a"', random.choice(['event="m"', 'event="b"']))
    write_bag(folder / "some.bag", pairs.messages, "".join(name for name in "abcd" if random.random() < 0.85))
    folders = [
        write_program(folder / "old", rules, goals),
        write_program(folder / "new", pairs.change(rules), new_goals, new_topics),
    ]
    try:
        expected = compare_whole_runs(folders, folder / "some.bag")
    except RetalisError:
        # Some combinations of operators are refused.
        return Extent.WHOLE
    comparison = compare(folders, folder / "some.bag")
    assert without_reasons(comparison) == expected, seed
    return comparison.extent


@pytest.mark.parametrize("number", round_numbers(1, 200))
def test_random_pairs_differ_as_whole_runs_do(number: int, tmp_path: Path) -> None:
    extents: Dict[Extent, int] = dict.fromkeys(Extent, 0)
    for seed in range(number * CASES_PER_ROUND, (number + 1) * CASES_PER_ROUND):
        folder = tmp_path / str(seed)
        folder.mkdir()
        extents[run_random_pair(seed, folder)] += 1
    assert extents[Extent.PART]
