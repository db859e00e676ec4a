"""Chains of poses, compared with single steps and with tf2."""

import math
import random
import sys
from pathlib import Path
from typing import Any, List, Tuple

import pytest
from asserting_accessors import compound, required
from hypothesis import given, settings
from hypothesis import strategies as st

from retalis import Engine, PrologError, Reports, StreamClock, functor
from retalis.prolog.terms.timestamps import SECOND

sys.path.append(str(Path(__file__).resolve().parents[2]))

SINGLE_STEPS = """
at(Id, T, Pose) :-
    prev(Id, tf(V1, Q1), T1, _, T),
    next_inf(Id, tf(V2, Q2), T2, _, T),
    datime_interpolate(T1, T2, T, F),
    interpolate_quaternion(V1, Q1, V2, Q2, [F], Pose).
one_by_one(T, Last, Pose) :-
    at(m0, T, P0), at(m1, T, P1), at(m2, T, P2),
    transform_quaternion([P0, P1, P2, Last], Pose).
"""
CHAIN = ("map", "base", "neck", "camera")
LAST_POSE = [[1.0, -0.5, 0.25], [0.1, -0.7, 0.1, 0.7]]


def engine_with(
    rules: Any = SINGLE_STEPS, memories: int = 3, form: str = "tf(V, Q)", size: int = 100
) -> Engine:
    engine = Engine(StreamClock(1000 * SECOND), None, Reports())
    engine.load(rules=rules)
    for number in range(memories):
        engine.call(f"memorize(tf({number}, V, Q), [], {form}, m{number}, {size})")
    return engine


def engine_with_transforms(transforms: Any, **options: Any) -> Any:
    """Return an engine with transforms: number of the memory, instant in milliseconds, position and rotation."""
    engine = engine_with(**options)
    for number, milliseconds, position, rotation in sorted(transforms, key=lambda transform: transform[1]):
        engine.event(f"tf({number}, {list(position)}, {list(rotation)})", milliseconds / 1000)
    return engine


def solutions(engine: Engine, goal: str) -> List[Any]:
    return [engine.show(solutions_or_error["P"]) for solutions_or_error in engine.query(goal)]


def numbers(text: Any) -> List[Any]:
    return [value for part in eval(text) for value in part]  # noqa: S307 - a list of lists of numbers


COORDINATES = st.tuples(*[st.floats(-10, 10)] * 3)
ROTATIONS = st.tuples(*[st.one_of(st.floats(-1, 1), st.integers(-1, 1))] * 4).filter(
    lambda rotation: math.hypot(*rotation) > 0.01
)
TRANSFORMS = st.lists(
    st.tuples(st.integers(0, 2), st.integers(0, 20).map(lambda n: 100 * n), COORDINATES, ROTATIONS),
    max_size=30,
)


@settings(max_examples=12)
@given(TRANSFORMS, st.integers(0, 20).map(lambda n: 50 * n))
def test_chain_equals_single_steps(transforms: Any, milliseconds: Any) -> None:
    engine = engine_with_transforms(transforms)
    steps = solutions(engine, f"one_by_one({milliseconds / 1000}, {LAST_POSE}, P)")
    chain = solutions(engine, f"pose_chain([m0, m1, m2, {LAST_POSE}], {milliseconds / 1000}, P)")
    assert len(chain) == len(steps)
    for pose, expected in zip(chain, steps):
        assert numbers(pose) == pytest.approx(numbers(expected), abs=1e-12)


def random_rotation(generator: Any) -> List[Any]:
    values = [generator.gauss(0, 1) for _ in range(4)]
    return [value / math.hypot(*values) for value in values]


def samples() -> Tuple[Any, ...]:
    """Return transforms of three joints, some with large distances and rotations, and instants between them."""
    generator = random.Random(5)
    rows = [
        (
            joint,
            10 * milliseconds + joint,
            [generator.uniform(-3, 3) for _ in range(3)],
            random_rotation(generator),
        )
        for joint in range(3)
        for milliseconds in range(0, 40, 1 + joint)
    ]
    return rows, [generator.randrange(20, 350) for _ in range(40)] + [20, 23, 102]


def poses(rows: Any, instants: Any) -> List[Any]:
    engine = engine_with_transforms(rows)
    return [
        numbers(solutions(engine, f"pose_chain([m0, m1, m2], {milliseconds / 1000}, P)")[0])
        for milliseconds in instants
    ]


@pytest.mark.slow
def test_poses_equal_tf2() -> None:
    reference = pytest.importorskip("tf2_reference")
    rows, instants = samples()
    buffer = reference.Reference()
    for joint, milliseconds, position, rotation in rows:
        buffer.add(CHAIN[joint], CHAIN[joint + 1], milliseconds * 10**6, position, rotation)
    for pose, milliseconds in zip(poses(rows, instants), instants):
        position, rotation = buffer.pose(CHAIN[0], CHAIN[-1], milliseconds * 10**6)
        assert reference.distance(pose[:3], position) < 1e-6
        assert reference.angle(pose[3:], rotation) < 1e-6


def test_poses_are_products_of_matrices() -> None:
    np = pytest.importorskip("numpy")
    rows, instants = samples()

    def turn(a: Any, b: Any, part: Any) -> Any:
        a, b = np.array(a), np.array(b)
        b = b if a @ b >= 0 else -b
        angle = math.acos(min(1.0, a @ b))
        return (a * math.sin((1 - part) * angle) + b * math.sin(part * angle)) / math.sin(angle)

    def matrix(position: Any, rotation: Any) -> Any:
        x, y, z, w = rotation
        u = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        transform = np.eye(4)
        transform[:3, :3] = np.eye(3) + 2 * w * u + 2 * u @ u
        transform[:3, 3] = position
        return transform

    for pose, milliseconds in zip(poses(rows, instants), instants):
        expected = np.eye(4)
        for joint in range(3):
            rows_of_joint = [row for row in rows if row[0] == joint]
            _, t1, v1, q1 = max(
                (row for row in rows_of_joint if row[1] <= milliseconds), key=lambda row: row[1]
            )
            _, t2, v2, q2 = min(
                (row for row in rows_of_joint if row[1] >= milliseconds), key=lambda row: row[1]
            )
            part = (milliseconds - t1) / (t2 - t1) if t2 > t1 else 0
            rotation = turn(q1, q2, part) if part else q1
            expected = expected @ matrix((1 - part) * np.array(v1) + part * np.array(v2), rotation)
        assert np.allclose(matrix(pose[:3], pose[3:]), expected, atol=1e-9)


FIXED_ROTATION = (
    (0, 1000, (1.0, 2.0, 3.0), (0.0, 0.6, 0.0, 0.8)),
    (0, 2000, (3.0, 2.0, 3.0), (0.0, 0.6, 0.0, 0.8)),
)
FIRST, MIDDLE = "[[1.0,2.0,3.0],[0.0,0.6,0.0,0.8]]", "[[2.0,2.0,3.0],[0.0,0.6,0.0,0.8]]"


@pytest.mark.parametrize("form", ["tf(V, Q)", "[V, Q]", "o(V, Q)"])
def test_records_may_have_several_forms(form: str) -> None:
    assert solutions(engine_with_transforms(FIXED_ROTATION, form=form), "pose_chain([m0], 1.5, P)") == [
        MIDDLE
    ]


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ("pose_chain([m0], 1, P)", [FIRST]),
        ("pose_chain([m0], [1,0], P)", [FIRST]),
        ("pose_chain([m0], datime(1970,1,1,0,0,1,0), P)", [FIRST]),
        ("convert_to_datime([1,500000000], T), pose_chain([m0], T, P)", [MIDDLE]),
        ("pose_chain([m0], 0.999, P)", []),
        ("pose_chain([m0], 2.001, P)", []),
        ("pose_chain([m1], 1, P)", []),
        ("pose_chain([nothing], 1, P)", []),
        ("pose_chain([m0, m1], 1, P)", []),
        ("pose_chain([], 1, P)", ["[[0.0,0.0,0.0],[0.0,0.0,0.0,1.0]]"]),
        ("X = m0, pose_chain([X], 1, P)", [FIRST]),
        ("X = [[0,0,0],[0,0,0,1]], pose_chain([X, m0, X], 1, P)", [FIRST]),
        ("pose_chain([[[1,2,3],[0,0,0,1]]], 1, P)", ["[[1.0,2.0,3.0],[0.0,0.0,0.0,1.0]]"]),
        ("pose_chain([m0], 1, [[1.0|_]|_]), P = yes", ["yes"]),
        ("pose_chain([m0], 1, [[2.0|_]|_]), P = yes", []),
    ],
)
def test_chain_has_pose_at_instant(goal: str, expected: List[str]) -> None:
    assert solutions(engine_with_transforms(FIXED_ROTATION, memories=2), goal) == expected


@pytest.mark.parametrize(
    ("goal", "error"),
    [
        ("pose_chain(_, 1, P)", "instantiation_error"),
        ("pose_chain([m0|_], 1, P)", "type_error(list,[m0|_])"),
        ("pose_chain(m0, 1, P)", "type_error(list,m0)"),
        ("pose_chain([m0, _], 1, P)", "instantiation_error"),
        ("pose_chain([m0], _, P)", "instantiation_error"),
        ("pose_chain([m0], soon, P)", "type_error(datime,soon)"),
        ("pose_chain([m0, []], 1, P)", "type_error(pose,[])"),
        ("pose_chain([[[0,0],[0,0,0,1]]], 1, P)", "type_error(position,[0,0])"),
        ("pose_chain([[[0,0,a],[0,0,0,1]]], 1, P)", "type_error(number,a)"),
        ("pose_chain([[[0,0,0],[0,0,0,0]]], 1, P)", "domain_error(quaternion,[0,0,0,0])"),
        ("pose_chain([names], 1, P)", "type_error(pose,name(ann))"),
        ("pose_chain([partly], 1, P)", "instantiation_error"),
    ],
)
def test_invalid_chain_is_refused(goal: str, error: str) -> None:
    engine = engine_with_transforms(FIXED_ROTATION)
    engine.call("memorize(name(_), [], _, names, 9)")
    engine.call("memorize(part(V, Q), [], tf(V, [_|Q]), partly, 9)")
    engine.event("name(ann)", 1.0)
    engine.event("part([0,0,0], [0,0,1])", 1.0)
    with pytest.raises(PrologError) as raised:
        engine.query(goal)
    assert engine.show(compound(raised.value.term)[1]).replace("_G", "_").startswith(error.split("_]")[0])


def test_removed_record_is_not_used() -> None:
    rows = [(0, 1000 * second, (float(second), 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)) for second in range(1, 6)]
    engine = engine_with_transforms(rows, size=2)
    assert solutions(engine, "pose_chain([m0], 3.5, P)") == []
    assert solutions(engine, "pose_chain([m0], 4.5, P)") == ["[[4.5,0.0,0.0],[0.0,0.0,0.0,1.0]]"]


def test_wide_gap_has_no_pose() -> None:
    engine = engine_with_transforms(FIXED_ROTATION)
    assert engine.call("set_etalis_flag(max_gap, 0.5)")
    assert solutions(engine, "pose_chain([m0], 1.5, P)") == []
    assert solutions(engine, "pose_chain([m0], 1, P)") == [FIRST]
    assert engine.call("set_etalis_flag(max_gap, 1)")
    assert solutions(engine, "pose_chain([m0], 1.5, P)") == [MIDDLE]


ADJACENT_GOALS = """
joined(Id, T, P) :-
    prev(Id, {0}, T1, _, T), next_inf(Id, {1}, T2, _, T), datime_interpolate(T1, T2, T, F),
    interpolate_quaternion(V1, Q1, V2, Q2, [F], P).
single(Id, T, P) :-
    prev(Id, {0}, T1, _, T), next_inf(Id, {1}, T2, _, T), datime_interpolate(T1, T2, T, F), F = G,
    interpolate_quaternion(V1, Q1, V2, Q2, [G], P).
in_a_test(Id, T, P) :- ( joined(Id, T, P) -> true ; P = none ).
in_a_branch(Id, T, P) :-
    ( Id \\== none -> prev(Id, {0}, T1, _, T), next_inf(Id, {1}, T2, _, T), datime_interpolate(T1, T2, T, F),
        interpolate_quaternion(V1, Q1, V2, Q2, [F], P)
    ; P = none ).
by_frames(Id, T, P) :- member(I, [Id]), joined(I, T, P), P = [_|_].
"""


COMPILED = ("joined", "by_frames", "in_a_branch", "in_a_test")


def solutions_or_error(engine: Any, goal: str) -> Any:
    """Return the solutions of a goal, or the formal term of its error."""
    try:
        return solutions(engine, goal)
    except PrologError as error:
        return engine.show(compound(error.term)[1])


RECORDS = st.lists(
    st.tuples(
        st.integers(0, 6),
        st.integers(0, 3),
        st.sampled_from(
            ["a([1,2,3], x, [0,0,0,1])", "a([2.5,0,0], y, [0.0,0.6,0.0,-0.8])", "a([1,2,b], x, [0,0,0,1])"]
            + ["a([1,2,3], x, [0,0,0,0])", "b([1,2,3], x, [0,0,0,1])", "a([1.5,2.5,_], x, [0,0,0,1])", "a"]
        ),
    ),
    max_size=6,
)


@settings(max_examples=8)
@given(RECORDS, st.sampled_from([0, 1, 3]))
def test_fused_goals_equal_single_goals(records: Any, gap: Any) -> None:
    engine = Engine(StreamClock(1000 * SECOND), None, Reports())
    engine.load(
        rules=ADJACENT_GOALS.format("a(V1, _, Q1)", "a(V2, _, Q2)"), goals="memorize(r(X), [], X, m, 4)"
    )
    for name in COMPILED:
        engine.logic.database.predicate(functor(name, 3)).compile_after = 0
    engine.call(f"set_etalis_flag(max_gap, {gap})")
    for end, duration, record in records:
        engine.call(f"event(r({record}), [{end - duration},{end}])")
    for instant in (0, 1, 2.5, 3, 4.25, 6, 9, "'x'", "_"):
        expected = solutions_or_error(engine, f"single(m, {instant}, P)")
        for name in COMPILED:
            assert solutions_or_error(engine, f"{name}(m, {instant}, P)") == (
                expected or (["none"] if name == "in_a_test" else [])
            )


@pytest.mark.parametrize(
    ("first", "second", "joined"),
    [
        ("tf(V1, Q1)", "tf(V2, Q2)", True),
        ("tf(_, Q1, _, V1)", "tf(_, Q2, _, V2)", True),
        ("tf(V1, Q1)", "ft(V2, Q2)", False),
        ("tf(V1, Q1)", "tf(Q2, V2)", False),
        ("tf(V1, Q1, a)", "tf(V2, Q2, a)", False),
        ("tf(V1, Q1, X)", "tf(V2, Q2, X)", False),
        ("tf(V1, Q1, T1)", "tf(V2, Q2, _)", False),
        ("tf(V1, Q1, T)", "tf(V2, Q2, _)", False),
        ("tf(V1, [Q1])", "tf(V2, [Q2])", False),
        ("V1", "V2", False),
    ],
)
def test_similar_record_goals_are_fused(first: str, second: str, joined: bool) -> None:
    engine = Engine(StreamClock(1000 * SECOND), None, Reports())
    calls: List[Any] = []
    engine.load(rules=ADJACENT_GOALS.format(first, second))
    predicate = engine.logic.database.predicate(functor("prev", 5))
    modes = required(predicate.functional_modes)
    joins = required(modes.joins)

    def record(goals: Any, counts: Any) -> Any:
        calls.append(joins(goals, counts))
        return calls[-1]

    predicate.functional_modes = modes._replace(joins=record)
    for _ in range(30):
        assert not engine.call("joined(nothing, 1, _)")
    assert any(calls) == joined


def test_program_may_define_interpolation() -> None:
    engine = engine_with(SINGLE_STEPS + "\ninterpolate_quaternion(_, _, _, _, _, mine).\n")
    engine.event("tf(0, [1,2,3], [0,0,0,1])", 1.0)
    assert solutions(engine, "at(m0, 1, P)") == ["mine"]
