"""Predicates that read transforms, and queries that wait for them."""

from typing import Any, Dict, List

import pytest
from asserting_accessors import stream_clock
from recording_reports import RecordingReports

from retalis import Engine, PrologError, Settings, StreamClock
from retalis.prolog.terms.timestamps import SECOND

NO_ROTATION = (0.0, 0.0, 0.0, 1.0)
RULES = """
synchronized(seen(M, P), tf_lookup(map, camera, T, P), [[tf(map, camera), T]], [timeout(5)]) <- marker(M, T).
late(M, Missing) <- query_given_up(seen(M, _), _, Missing).
"""


class TransformEngine:
    """An engine with transforms, and lists of its events and warnings."""

    def __init__(self, rules: Any = RULES, goals: str = "", **settings: Any) -> None:
        self.reports = RecordingReports()
        self.engine = Engine(None, Settings(**settings), self.reports)
        self.events: List[Any] = []
        self.engine.on_event(self.note)
        self.engine.load(rules=rules, goals=goals)

    def note(self, term: Any, start: Any, end: Any) -> None:
        text = self.engine.show(term)
        if text.startswith(("seen", "late", "got")):
            self.events.append(text)

    def transform(self, parent: str, child: str, second: Any, x: float, is_static: bool = False) -> None:
        numbers = (float(x), 0.0, 0.0, *NO_ROTATION)
        transform = (parent, child, round(second * SECOND), numbers)
        self.engine.do(lambda: self.engine.knowledge.transforms.store_message([transform], is_static))

    def event(self, text: str, second: Any) -> None:
        self.engine.event(text, second)

    def answers(self, goal: str) -> List[Dict[Any, Any]]:
        return [
            {name: self.engine.show(value) for name, value in answer.items()}
            for answer in self.engine.query(goal)
        ]

    def waiting(self) -> List[Any]:
        return [memory.id for query in self.engine.status().waiting for memory in query.memories]


def pose(x: int) -> str:
    return f"[[{float(x)},0.0,0.0],[0.0,0.0,0.0,1.0]]"


def test_query_waits_for_frames_of_path() -> None:
    program = TransformEngine()
    program.event("marker(a, 5)", 5)
    assert program.waiting() == ["tf(map,camera): not connected"]
    program.transform("map", "odom", 4, 1)
    program.transform("odom", "base", 6, 10)
    program.transform("base", "camera", 0, 100, is_static=True)
    assert program.waiting() == ["tf(map,camera): frame odom"]
    program.transform("map", "odom", 4.5, 1)
    assert program.events == []
    program.transform("map", "odom", 6, 3)
    # base has no transform at 5 s or before: the query is called, and has no solution.
    assert program.events == program.waiting() == []
    program.event("marker(b, 6)", 6)
    assert program.events == [f"seen(b,{pose(113)})"]
    program.event("marker(c, 6.5)", 6.5)
    program.transform("odom", "base", 7, 20)
    program.transform("map", "odom", 7, 5)
    assert program.events[1:] == [f"seen(c,{pose(119)})"]


def test_queries_are_called_in_order() -> None:
    program = TransformEngine()
    program.transform("map", "camera", 1, 0)
    for name, second in (("a", 3), ("b", 2), ("c", 3), ("d", 9)):
        program.event(f"marker({name}, {second})", 3)
    program.transform("map", "camera", 4, 3)
    assert [text[5] for text in program.events] == ["a", "b", "c"]
    assert len(program.waiting()) == 1


def test_query_times_out() -> None:
    program = TransformEngine()
    program.transform("map", "camera", 1, 0)
    program.event("marker(a, 5)", 5)
    program.event("other", 10.5)
    assert program.events == ["late(a,[[tf(map,camera),datime(1970,1,1,0,0,5.0,0)]])"]
    program.transform("map", "camera", 6, 0)
    assert len(program.events) == 1
    transforms = program.engine.knowledge.transforms
    assert not any(frame.queries for frame in transforms.buffer.frames())


def test_query_follows_change_of_parent() -> None:
    """A cup stands on a table that is in no tree with the map; then the robot grips it."""
    program = TransformEngine(
        rules="synchronized(got(P), tf_lookup(map, cup, T, P), [[tf(map, cup), T]]) <- ask(T)."
    )
    program.transform("table", "cup", 1, 1)
    program.transform("map", "hand", 1, 10)
    program.event("ask(2)", 2)
    assert program.waiting() == ["tf(map,cup): not connected"]
    program.transform("hand", "cup", 1.5, 2)
    assert program.waiting() == ["tf(map,cup): frame cup"]
    program.transform("hand", "cup", 2.5, 2)
    program.transform("map", "hand", 3, 10)
    assert program.events == [f"got({pose(12)})"]


def test_frame_may_be_argument_of_event() -> None:
    program = TransformEngine(
        rules="synchronized(got(P), tf_lookup(map, F, T, P), [[tf(map, F), T]]) <- ask(F, T)."
    )
    program.transform("map", "left", 1, 1)
    program.event("""ask('"/left"', 2)""", 2)
    assert program.waiting() == ["tf(map,left): frame left"]
    program.transform("map", "left", 3, 3)
    assert program.events == [f"got({pose(2)})"]
    program.event("ask(7, 2)", 2)
    program.event("ask(f(x), 2)", 2)
    assert len([text for text in program.reports.texts if "names of frames" in text]) == 2


def test_query_waits_for_transforms_and_memories() -> None:
    program = TransformEngine(
        rules="synchronized(got(P), tf_lookup(map, camera, T, P), [[tf(map, camera), T], [odom, T]]) <- ask(T).",
        goals="memorize(odom, [], _, odom, 5)",
    )
    program.transform("map", "camera", 1, 1)
    program.event("ask(2)", 2)
    program.event("odom", 3)
    assert program.waiting() == ["tf(map,camera): frame camera"]
    program.transform("map", "camera", 3, 3)
    program.event("ask(3)", 3)
    program.event("ask(4)", 4)
    program.transform("map", "camera", 4, 3)
    assert program.waiting() == ["odom"]
    program.event("odom", 5)
    assert program.events == [f"got({pose(x)})" for x in (2, 3, 3)]


def test_memory_with_id_of_transform_takes_precedence() -> None:
    program = TransformEngine(
        rules="synchronized(got(T), true, [[tf(map, camera), T]]) <- ask(T).",
        goals="memorize(pose, [], _, tf(map, camera), 5)",
    )
    program.event("ask(2)", 2)
    program.transform("map", "camera", 3, 1)
    assert program.waiting() == ["tf(map,camera)"]
    program.event("pose", 3)
    assert program.events == ["got(2)"]


def test_instant_zero_is_newest_transform() -> None:
    program = TransformEngine(
        rules="synchronized(got(P), tf_lookup(map, camera, 0, P), [[tf(map, camera), 0]]) <- ask."
    )
    program.event("ask", 1)
    program.transform("base", "camera", 5, 1)
    program.transform("map", "base", 4, 10)
    program.event("ask", 2)
    program.transform("map", "base", 6, 30)
    program.event("ask", 3)
    # The first query was called when the frames were connected: at 4 s there is no transform of the camera.
    assert program.events == [f"got({pose(21)})"]
    program.transform("base", "camera", 6, 1)
    program.event("ask", 4)
    assert program.events[1:] == [f"got({pose(31)})"]


@pytest.fixture
def moving_base() -> TransformEngine:
    """Return an engine in which the base moves from 1 m to 3 m between 2 s and 4 s."""
    program = TransformEngine(rules="")
    program.transform("map", "base", 2, 1)
    program.transform("map", "base", 4, 3)
    program.transform("other", "lamp", 4, 3)
    return program


def test_lookup_between_transforms_is_interpolated(moving_base: TransformEngine) -> None:
    program = moving_base
    assert program.answers("tf_lookup(map, base, 3, P)") == [{"P": pose(2)}]
    assert program.answers("tf_lookup(base, map, [3,0], P)") == [
        {"P": "[[-2.0,0.0,0.0],[-0.0,-0.0,-0.0,1.0]]"}
    ]
    moved = program.answers("tf_transform([[1,2,0],[0,0,0,1]], base, map, 3.5, P)")
    assert moved == [{"P": "[[3.5,2.0,0.0],[0.0,0.0,0.0,1.0]]"}]
    assert program.answers("tf_missing(map, base, 3, R)") == []


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ("map, base, 1", "before(base,datime(1970,1,1,0,0,2,0))"),
        ("map, base, 5", "after(base,datime(1970,1,1,0,0,4,0))"),
        ("map, basis, 3", "unknown(basis)"),
        ("lamp, base, 4", "unconnected(lamp,base)"),
        ("map, '', 4", "invalid('')"),
    ],
)
def test_failed_lookup_has_reason(moving_base: TransformEngine, arguments: str, reason: str) -> None:
    assert moving_base.answers(f"tf_lookup({arguments}, _)") == []
    assert moving_base.answers(f"tf_missing({arguments}, R)") == [{"R": reason}]


def test_unknown_frame_is_reported_once() -> None:
    program = TransformEngine(rules="")
    # A frame is not reported as unknown before any frame is known.
    assert not program.engine.call("tf_lookup(map, camara, 3, _)")
    assert not program.reports.texts
    program.transform("map", "camera", 2, 1)
    for _ in range(3):
        assert not program.engine.call("tf_lookup(map, camara, 3, _)")
    assert program.reports.texts == ["tf_lookup: there is no frame 'camara' yet; did you mean 'camera'?"]


def test_wide_gap_has_no_transform() -> None:
    program = TransformEngine(rules="", max_gap=0.5)
    for second in (1, 1.4, 2, 2.6):
        program.transform("map", "base", second, second)
    assert program.engine.call("tf_lookup(map, base, 1.2, _)")
    assert program.engine.call("tf_lookup(map, base, 2, _)"), "a sample needs no interpolation"
    assert not program.engine.call("tf_lookup(map, base, 1.7, _)")
    assert program.answers("tf_missing(map, base, 1.7, R)") == [{"R": "gap(base,0.6)"}]
    assert program.engine.call("set_etalis_flag(max_gap, 1)")
    assert program.engine.call("tf_lookup(map, base, 1.7, _)")


@pytest.mark.parametrize(
    ("goal", "error"),
    [
        ("tf_lookup(_, base, 3, P)", "instantiation_error"),
        ("tf_lookup(map, base, _, P)", "instantiation_error"),
        ("tf_lookup(map, 7, 3, P)", "type_error(frame,7)"),
        ("tf_lookup(map, base, now, P)", "type_error(datime,now)"),
        ("tf_transform(nothing, base, map, 3, P)", "type_error(pose,nothing)"),
        ("tf_missing(map, f(x), 3, P)", "type_error(frame,f(x))"),
        ("tf_add(map, map, 3, [[0,0,0],[0,0,0,1]])", "permission_error(create,transform,map)"),
        ("tf_add(map, base, 3, [[0,0,0],[0,0,0,2]])", "permission_error(create,transform,base)"),
        ("tf_add_static(map, base, [[0,0,0]])", "type_error(pose,[[0,0,0]])"),
    ],
)
def test_invalid_arguments_are_refused(goal: str, error: str) -> None:
    program = TransformEngine(rules="")
    program.transform("map", "base", 3, 1)
    with pytest.raises(PrologError) as raised:
        program.engine.call(goal)
    assert program.engine.show(raised.value.term).startswith(f"error({error},")


def test_goals_store_transforms() -> None:
    program = TransformEngine(
        rules=RULES + "null_event do tf_add(map, camera, T, [[X,0,0],[0,0,0,1]]) <- put(X, T).\n"
    )
    program.event("marker(a, 2)", 2)
    program.event("put(1, 1)", 2.1)
    program.event("put(3, 3)", 2.2)
    assert program.events == [f"seen(a,{pose(2)})"]
    assert program.engine.call("tf_add(map, camera, 3, [[9,0,0],[0,0,0,1]])"), "a repetition is ignored"
    assert program.engine.call("tf_add_static(camera, lens, [[1,0,0],[0,0,0,1]])")
    assert program.answers("tf_lookup(map, lens, 3, P)") == [{"P": pose(4)}]


def test_clock_moved_back_clears_history() -> None:
    program = TransformEngine()
    program.transform("map", "base", 5, 1)
    program.transform("base", "camera", 5, 1, is_static=True)
    program.event("marker(a, 50)", 50)
    stream_clock(program.engine).move_to(3 * SECOND, back=True)
    program.engine.advance()
    assert program.waiting() == []
    assert program.answers("tf_missing(map, camera, 5, R)") == [{"R": "after(base,none)"}]
    program.transform("map", "base", 3, 1)
    program.event("marker(b, 3)", 3)
    assert program.events == [f"seen(b,{pose(2)})"]


def test_pending_queries_are_restored() -> None:
    program = TransformEngine()
    program.transform("map", "camera", 1, 0)
    program.event("marker(a, 5)", 5)
    engine = Engine.restore(program.engine.snapshot(), StreamClock(6 * SECOND))
    events: List[Any] = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    assert [memory.id for query in engine.status().waiting for memory in query.memories] == [
        "tf(map,camera): not connected"
    ]
    for second in (4, 6):
        assert engine.call(f"tf_add(map, camera, {second}, [[{second},0,0],[0,0,0,1]])")
    assert events == [f"seen(a,{pose(5)})"]


def test_invalid_transforms_are_reported() -> None:
    program = TransformEngine(rules="")
    program.transform("map", "map", 1, 1)
    assert program.reports.texts == [
        "the transform of frame 'map' is refused: a frame cannot be its own parent"
    ]


@pytest.mark.parametrize(
    ("rules", "goals", "is_required"),
    [
        ("a <- b.", "", False),
        ("a <- tf(map, camera).", "memorize(tf(_, _), [], _, m, 5)", False),
        ("p(P) :- tf_lookup(a, b, 0, P).", "", True),
        ("a <- b where (c ; \\+ tf_missing(a, b, 0, _)).", "", True),
        ("synchronized(a, p, [[m, 1], [tf(a, b), 2]]) <- b.", "", True),
        ("synchronized(a, p, [[m, 1], [tf, 2]]) <- b.", "", False),
    ],
)
def test_transforms_are_required_if_program_reads_them(rules: str, goals: str, is_required: bool) -> None:
    program = TransformEngine(rules=rules, goals=goals)
    requests: List[str] = []
    transforms = program.engine.knowledge.transforms
    transforms.require_if_mentioned(program.engine.rules.terms())
    transforms.add_feed(lambda: requests.append("feed"))
    assert requests == ["feed"] * is_required
    program.engine.call("ignore(tf_lookup(a, b, 0, _))")
    assert requests == ["feed"]


def test_status_counts_transforms() -> None:
    program = TransformEngine()
    program.transform("map", "camera", 1, 0)
    program.transform("map", "camera", 2, 0)
    program.transform("map", "map", 2, 0)
    program.event("marker(a, 1)", 1)
    assert program.engine.status().transforms == (2, 2, 1)
    assert Engine().status().transforms is None


def test_incremental_table_depends_on_transforms() -> None:
    program = TransformEngine(
        rules=":- table where/1 as incremental.\nwhere(X) :- tf_lookup(map, base, 0, [[X,_,_],_])."
    )
    program.transform("map", "base", 1, 1)
    assert program.answers("where(X)") == [{"X": "1.0"}]
    program.transform("map", "base", 2, 5)
    assert program.answers("where(X)") == [{"X": "5.0"}]


def test_timed_out_queries_leave_frames() -> None:
    program = TransformEngine()
    program.transform("map", "camera", 1, 0)
    for number in range(500):
        program.event(f"marker(m{number}, {number + 1000})", 6 * number + 5)
    transforms = program.engine.knowledge.transforms
    (camera,) = [frame for frame in transforms.buffer.frames() if frame.name == "camera"]
    assert len(camera.instants) < 50
    assert len(camera.queries) <= 1
