"""Predicates that read transforms, and queries that wait for them."""

import pytest

from retalis import Engine, PrologError, Reports, Settings, StreamClock
from retalis.prolog.terms.timestamps import SECOND

NONE = (0.0, 0.0, 0.0, 1.0)
RULES = """
synchronized(seen(M, P), tf_lookup(map, camera, T, P), [[tf(map, camera), T]], [timeout(5)]) <- marker(M, T).
late(M, Missing) <- query_given_up(seen(M, _), _, Missing).
"""


class Run:
    """An engine with a list of its events and warnings, fed with transforms."""

    def __init__(self, rules=RULES, goals="", **settings):
        self.warnings = []
        reports = Reports()
        reports.warning = lambda problem, *_, **__: self.warnings.append(str(problem))
        self.engine = Engine(None, Settings(**settings), reports)
        self.events = []
        self.engine.on_event(self.note)
        self.engine.load(rules=rules, goals=goals)

    def note(self, term, start, end):
        text = self.engine.show(term)
        if text.startswith(("seen", "late", "got")):
            self.events.append(text)

    def transform(self, parent, child, second, x, is_static=False):
        numbers = (float(x), 0.0, 0.0, *NONE)
        transform = (parent, child, round(second * SECOND), numbers)
        self.engine.do(lambda: self.engine.knowledge.transforms.store_message([transform], is_static))

    def event(self, text, second):
        self.engine.event(text, second)

    def answers(self, goal):
        return [
            {name: self.engine.show(value) for name, value in found.items()}
            for found in self.engine.query(goal)
        ]

    def waiting(self):
        return [memory.id for query in self.engine.status().waiting for memory in query.memories]


def pose(x):
    return f"[[{float(x)},0.0,0.0],[0.0,0.0,0.0,1.0]]"


def test_a_query_waits_for_each_frame_of_the_path():
    run = Run()
    run.event("marker(a, 5)", 5)
    assert run.waiting() == ["tf(map,camera): not connected"]
    run.transform("map", "odom", 4, 1)
    run.transform("odom", "base", 6, 10)
    run.transform("base", "camera", 0, 100, is_static=True)
    assert run.waiting() == ["tf(map,camera): frame odom"]
    run.transform("map", "odom", 4.5, 1)
    assert run.events == []
    run.transform("map", "odom", 6, 3)
    # base has no transform at 5 s or before: the query is called, and has no solution.
    assert run.events == run.waiting() == []
    run.event("marker(b, 6)", 6)
    assert run.events == [f"seen(b,{pose(113)})"]
    run.event("marker(c, 6.5)", 6.5)
    run.transform("odom", "base", 7, 20)
    run.transform("map", "odom", 7, 5)
    assert run.events[1:] == [f"seen(c,{pose(119)})"]


def test_queries_are_called_in_order_of_their_registration():
    run = Run()
    run.transform("map", "camera", 1, 0)
    for name, second in (("a", 3), ("b", 2), ("c", 3), ("d", 9)):
        run.event(f"marker({name}, {second})", 3)
    run.transform("map", "camera", 4, 3)
    assert [text[5] for text in run.events] == ["a", "b", "c"]
    assert len(run.waiting()) == 1


def test_a_query_is_given_up():
    run = Run()
    run.transform("map", "camera", 1, 0)
    run.event("marker(a, 5)", 5)
    run.event("other", 10.5)
    assert run.events == ["late(a,[[tf(map,camera),datime(1970,1,1,0,0,5.0,0)]])"]
    run.transform("map", "camera", 6, 0)
    assert len(run.events) == 1
    transforms = run.engine.knowledge.transforms
    assert not any(frame.queries for frame in transforms.buffer.frames())


def test_a_frame_that_gets_another_parent():
    """A cup stands on a table that is in no tree with the map; then the robot grips it."""
    run = Run(rules="synchronized(got(P), tf_lookup(map, cup, T, P), [[tf(map, cup), T]]) <- ask(T).")
    run.transform("table", "cup", 1, 1)
    run.transform("map", "hand", 1, 10)
    run.event("ask(2)", 2)
    assert run.waiting() == ["tf(map,cup): not connected"]
    run.transform("hand", "cup", 1.5, 2)
    assert run.waiting() == ["tf(map,cup): frame cup"]
    run.transform("hand", "cup", 2.5, 2)
    run.transform("map", "hand", 3, 10)
    assert run.events == [f"got({pose(12)})"]


def test_frames_that_only_the_event_knows():
    run = Run(rules="synchronized(got(P), tf_lookup(map, F, T, P), [[tf(map, F), T]]) <- ask(F, T).")
    run.transform("map", "left", 1, 1)
    run.event("""ask('"/left"', 2)""", 2)
    assert run.waiting() == ["tf(map,left): frame left"]
    run.transform("map", "left", 3, 3)
    assert run.events == [f"got({pose(2)})"]
    run.event("ask(7, 2)", 2)
    run.event("ask(f(x), 2)", 2)
    assert len([text for text in run.warnings if "names of frames" in text]) == 2


def test_transforms_and_memories_together():
    run = Run(
        rules="synchronized(got(P), tf_lookup(map, camera, T, P), [[tf(map, camera), T], [odom, T]]) <- ask(T).",
        goals="memorize(odom, [], _, odom, 5)",
    )
    run.transform("map", "camera", 1, 1)
    run.event("ask(2)", 2)
    run.event("odom", 3)
    assert run.waiting() == ["tf(map,camera): frame camera"]
    run.transform("map", "camera", 3, 3)
    run.event("ask(3)", 3)
    run.event("ask(4)", 4)
    run.transform("map", "camera", 4, 3)
    assert run.waiting() == ["odom"]
    run.event("odom", 5)
    assert run.events == [f"got({pose(x)})" for x in (2, 3, 3)]


def test_a_memory_with_the_id_of_a_transform_takes_precedence():
    run = Run(
        rules="synchronized(got(T), true, [[tf(map, camera), T]]) <- ask(T).",
        goals="memorize(pose, [], _, tf(map, camera), 5)",
    )
    run.event("ask(2)", 2)
    run.transform("map", "camera", 3, 1)
    assert run.waiting() == ["tf(map,camera)"]
    run.event("pose", 3)
    assert run.events == ["got(2)"]


def test_the_newest_transform():
    run = Run(rules="synchronized(got(P), tf_lookup(map, camera, 0, P), [[tf(map, camera), 0]]) <- ask.")
    run.event("ask", 1)
    run.transform("base", "camera", 5, 1)
    run.transform("map", "base", 4, 10)
    run.event("ask", 2)
    run.transform("map", "base", 6, 30)
    run.event("ask", 3)
    # The first one was called when the frames were connected: at 4 s there is no transform of the camera.
    assert run.events == [f"got({pose(21)})"]
    run.transform("base", "camera", 6, 1)
    run.event("ask", 4)
    assert run.events[1:] == [f"got({pose(31)})"]


def test_lookups_fail_with_a_reason():
    run = Run(rules="")
    run.transform("map", "base", 2, 1)
    run.transform("map", "base", 4, 3)
    run.transform("other", "lamp", 4, 3)
    assert run.answers("tf_lookup(map, base, 3, P)") == [{"P": pose(2)}]
    assert run.answers("tf_lookup(base, map, [3,0], P)") == [{"P": "[[-2.0,0.0,0.0],[-0.0,-0.0,-0.0,1.0]]"}]
    moved = run.answers("tf_transform([[1,2,0],[0,0,0,1]], base, map, 3.5, P)")
    assert moved == [{"P": "[[3.5,2.0,0.0],[0.0,0.0,0.0,1.0]]"}]
    for question, reason in (
        ("map, base, 3", None),
        ("map, base, 1", "before(base,datime(1970,1,1,0,0,2,0))"),
        ("map, base, 5", "after(base,datime(1970,1,1,0,0,4,0))"),
        ("map, basis, 3", "unknown(basis)"),
        ("lamp, base, 4", "unconnected(lamp,base)"),
        ("map, '', 4", "invalid('')"),
    ):
        missing = run.answers(f"tf_missing({question}, R)")
        assert missing == ([] if reason is None else [{"R": reason}]), question
        assert bool(run.answers(f"tf_lookup({question}, _)")) == (reason is None)


def test_an_unknown_frame_is_reported_once():
    run = Run(rules="")
    assert not run.engine.call("tf_lookup(map, camara, 3, _)") and not run.warnings, "nothing is known yet"
    run.transform("map", "camera", 2, 1)
    for _ in range(3):
        assert not run.engine.call("tf_lookup(map, camara, 3, _)")
    assert run.warnings == ["tf_lookup: there is no frame 'camara' yet; did you mean 'camera'?"]


def test_gaps():
    run = Run(rules="", max_gap=0.5)
    for second in (1, 1.4, 2, 2.6):
        run.transform("map", "base", second, second)
    assert run.engine.call("tf_lookup(map, base, 1.2, _)")
    assert run.engine.call("tf_lookup(map, base, 2, _)"), "a sample needs no interpolation"
    assert not run.engine.call("tf_lookup(map, base, 1.7, _)")
    assert run.answers("tf_missing(map, base, 1.7, R)") == [{"R": "gap(base,0.6)"}]
    assert run.engine.call("set_etalis_flag(max_gap, 1)")
    assert run.engine.call("tf_lookup(map, base, 1.7, _)")


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
def test_errors(goal, error):
    run = Run(rules="")
    run.transform("map", "base", 3, 1)
    with pytest.raises(PrologError) as raised:
        run.engine.call(goal)
    assert run.engine.show(raised.value.term).startswith(f"error({error},")


def test_goals_store_transforms():
    run = Run(rules=RULES + "null_event do tf_add(map, camera, T, [[X,0,0],[0,0,0,1]]) <- put(X, T).\n")
    run.event("marker(a, 2)", 2)
    run.event("put(1, 1)", 2.1)
    run.event("put(3, 3)", 2.2)
    assert run.events == [f"seen(a,{pose(2)})"]
    assert run.engine.call("tf_add(map, camera, 3, [[9,0,0],[0,0,0,1]])"), "a repetition is ignored"
    assert run.engine.call("tf_add_static(camera, lens, [[1,0,0],[0,0,0,1]])")
    assert run.answers("tf_lookup(map, lens, 3, P)") == [{"P": pose(4)}]


def test_going_back_clears_the_history():
    run = Run()
    run.transform("map", "base", 5, 1)
    run.transform("base", "camera", 5, 1, is_static=True)
    run.event("marker(a, 50)", 50)
    run.engine.clock.move_to(3 * SECOND, back=True)
    run.engine.advance()
    assert run.waiting() == []
    assert run.answers("tf_missing(map, camera, 5, R)") == [{"R": "after(base,none)"}]
    run.transform("map", "base", 3, 1)
    run.event("marker(b, 3)", 3)
    assert run.events == [f"seen(b,{pose(2)})"]


def test_waiting_queries_are_part_of_the_state():
    run = Run()
    run.transform("map", "camera", 1, 0)
    run.event("marker(a, 5)", 5)
    engine = Engine.restore(run.engine.snapshot(), StreamClock(6 * SECOND))
    events = []
    engine.on_event(lambda term, start, end: events.append(engine.show(term)))
    assert [memory.id for query in engine.status().waiting for memory in query.memories] == [
        "tf(map,camera): not connected"
    ]
    for second in (4, 6):
        assert engine.call(f"tf_add(map, camera, {second}, [[{second},0,0],[0,0,0,1]])")
    assert events == [f"seen(a,{pose(5)})"]


def test_invalid_transforms_are_reported():
    run = Run(rules="")
    run.transform("map", "map", 1, 1)
    assert run.warnings == ["the transform of frame 'map' is refused: a frame cannot be its own parent"]


def test_the_buffer_is_fed_only_if_the_program_reads_transforms():
    for rules, goals, expected in (
        ("a <- b.", "", False),
        ("a <- tf(map, camera).", "memorize(tf(_, _), [], _, m, 5)", False),
        ("p(P) :- tf_lookup(a, b, 0, P).", "", True),
        ("a <- b where (c ; \\+ tf_missing(a, b, 0, _)).", "", True),
        ("synchronized(a, p, [[m, 1], [tf(a, b), 2]]) <- b.", "", True),
        ("synchronized(a, p, [[m, 1], [tf, 2]]) <- b.", "", False),
    ):
        run = Run(rules=rules, goals=goals)
        fed = []
        transforms = run.engine.knowledge.transforms
        transforms.require_if_mentioned(run.engine.rules.terms())
        transforms.set_feed(lambda: fed.append(True))  # noqa: B023
        assert fed == [True] * expected, rules
        run.engine.call("ignore(tf_lookup(a, b, 0, _))")
        assert fed == [True]


def test_counts():
    run = Run()
    run.transform("map", "camera", 1, 0)
    run.transform("map", "camera", 2, 0)
    run.transform("map", "map", 2, 0)
    run.event("marker(a, 1)", 1)
    assert run.engine.status().transforms == (2, 2, 1)
    assert Engine().status().transforms is None


def test_an_incremental_table_is_evaluated_again():
    run = Run(rules=":- table where/1 as incremental.\nwhere(X) :- tf_lookup(map, base, 0, [[X,_,_],_]).")
    run.transform("map", "base", 1, 1)
    assert run.answers("where(X)") == [{"X": "1.0"}]
    run.transform("map", "base", 2, 5)
    assert run.answers("where(X)") == [{"X": "5.0"}]


def test_repair_registers_the_queries_again():
    run = Run()
    run.transform("map", "camera", 1, 0)
    run.event("marker(a, 5)", 5)
    run.event("marker(b, 6)", 5)
    run.engine.knowledge.repair()
    assert len(run.waiting()) == 2
    run.transform("map", "camera", 7, 6)
    assert [text[:6] for text in run.events] == ["seen(a", "seen(b"]


def test_a_withdrawn_wait_leaves_nothing():
    run = Run()
    run.transform("map", "camera", 1, 0)
    for number in range(500):
        run.event(f"marker(m{number}, {number + 1000})", 6 * number + 5)
    transforms = run.engine.knowledge.transforms
    (camera,) = [frame for frame in transforms.buffer.frames() if frame.name == "camera"]
    assert len(camera.instants) < 50 and len(camera.queries) <= 1
