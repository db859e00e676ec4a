"""Products and interpolation of poses."""

import math
import random
from typing import Any, List

import pytest
from prolog.goal_answers import answers, first, prolog


def quaternion_about(axis: Any, angle: float) -> Any:
    size = math.sqrt(sum(value * value for value in axis))
    return [value / size * math.sin(angle / 2) for value in axis] + [math.cos(angle / 2)]


def rotation(q: Any) -> List[List[Any]]:
    x, y, z, w = q
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]


def numbers(text: str) -> Any:
    return eval(text)  # a list of lists of floats, as Python writes it too


def test_pose_product_rotates_second_translation() -> None:
    rng = random.Random(1)
    logic = prolog()
    for _ in range(20):
        v1, v2 = ([rng.uniform(-1, 1) for _ in range(3)] for _ in range(2))
        q1, q2 = (
            quaternion_about([rng.uniform(-1, 1) for _ in range(3)], rng.uniform(0, 6)) for _ in range(2)
        )
        position, quaternion = numbers(first(logic, f"mul_quaternion({v1},{q1},{v2},{q2},X)"))
        expected = [a + sum(r * b for r, b in zip(row, v2)) for a, row in zip(v1, rotation(q1))]
        assert position == pytest.approx(expected)
        chained = numbers(first(logic, f"transform_quaternion([[{v1},{q1}],[{v2},{q2}]],X)"))
        assert chained == [position, quaternion]
        tag, matrix = numbers(
            first(logic, f"transform([['Q',[{v1},{q1}]],[{v2},{q2}]],X)").replace("'M'", "0")
        )
        assert tag == 0
        assert [row[3] for row in matrix[:3]] == pytest.approx(position)
        moved = numbers(first(logic, f"tf_point({v1},['Q',[{position},{quaternion}]],X)"))
        assert moved == pytest.approx(numbers(first(logic, f"transform_point({v1},{matrix},X)")))


def test_interpolation_of_poses_is_spherical() -> None:
    logic = prolog()
    axis = [1, 2, 3]
    for fraction in (0, 0.25, 0.5, 1):
        q1, q2 = quaternion_about(axis, 0.2), [-value for value in quaternion_about(axis, 1.2)]
        position, quaternion = numbers(
            first(logic, f"interpolate_quaternion([0,0,0],{q1},[4,8,12],{q2},[{fraction}],X)")
        )
        assert position == pytest.approx([4 * (1 - fraction), 8 * (1 - fraction), 12 * (1 - fraction)])
        assert quaternion == pytest.approx(quaternion_about(axis, 0.2 + (1 - fraction)))
    q = quaternion_about(axis, 0.3)
    assert numbers(first(logic, f"interpolate_quaternion([1,1,1],{q},[1,1,1],{q},[0.3],X)"))[1] == q


@pytest.mark.parametrize("angle", [1e-12, 1e-9, 1e-8, 2e-8, 1e-7, 1e-5, 1e-3, 3.0, 3.14159])
def test_interpolation_is_exact_for_any_angle(angle: float) -> None:
    q1, q2 = quaternion_about([1, -2, 0.5], 0.2), quaternion_about([1, -2, 0.5], 0.2 + angle)
    goal = f"interpolate_quaternion([0,0,0],{q1},[0,0,0],{q2},[0.25],X)"
    expected = quaternion_about([1, -2, 0.5], 0.2 + 0.75 * angle)
    assert numbers(first(prolog(), goal))[1] == pytest.approx(expected, abs=3e-16)


@pytest.mark.parametrize(
    ("goal", "error"),
    [
        ("transform_quaternion([[a]], X)", "type_error(pose,[a])"),
        ("transform_quaternion(_, X)", "instantiation_error"),
        ("mul_quaternion([1,2], [0,0,0,1], [0,0,0], [0,0,0,1], X)", "type_error(position,[1,2])"),
        ("mul_quaternion([1,2,a], [0,0,0,1], [0,0,0], [0,0,0,1], X)", "type_error(number,a)"),
        ("mul_quaternion([1,2,3], [0,0,0,0], [0,0,0], [0,0,0,1], X)", "domain_error(quaternion,[0,0,0,0])"),
        ("tf_point([0,0,0], ['X',1], X)", "domain_error(transform,['X',1])"),
    ],
)
def test_malformed_pose_is_an_error(goal: str, error: str) -> None:
    assert answers(prolog(), goal) == [error]


def test_empty_pose_product_is_identity() -> None:
    assert first(prolog(), "transform_quaternion([], X)") == "[[0.0,0.0,0.0],[0.0,0.0,0.0,1.0]]"
