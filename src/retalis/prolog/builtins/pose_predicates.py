"""Predicates on poses, quaternions and homogeneous transformation matrices.

A pose is ``[[X,Y,Z],[QX,QY,QZ,QW]]`` with a position in metres and a rotation as quaternion, in the order of ROS
messages. A matrix is a list of four rows of four numbers, and a transform is ``['Q',Pose]`` or ``['M',Matrix]``.

The mathematics is that of tf2: the product of two poses rotates the second translation by the first rotation, and
rotations are interpolated spherically (slerp) along the shorter arc. Quaternions are not normalised, as in tf2.
"""

from math import acos, sin, sqrt
from typing import List, Optional, Sequence, Tuple

from ..machine.errors import domain_error, instantiation_error, type_error
from ..terms.list_terms import list_items, make_list
from ..terms.types import CONS, NIL, Atom, Lazy, Term, Var, atom, deref
from .builtin_registry import ProgramMachine, deterministic, function

Vector = Sequence[float]
Pose = Tuple[Vector, Vector]
Matrix = List[List[float]]

_M, _Q = atom("M"), atom("Q")


def parse_numbers(term: Term, count: int, type_name: str) -> Vector:
    """Return the values of a list of ``count`` numbers.

    Raises:
        PrologError: an instantiation or type error for any other term.
    """
    values = []
    item = deref(term)
    while item.__class__ is tuple and item[0] is CONS:
        value = item[1]
        # Most items are floats and need no dereferencing.
        if value.__class__ is not float:
            value = deref(value)
            if value.__class__ is not float and value.__class__ is not int:
                raise instantiation_error() if value.__class__ is Var else type_error("number", value)
        values.append(value)
        item = item[2]
        if item.__class__ is not tuple:
            item = deref(item)
    if item.__class__ is Var:
        raise instantiation_error()
    if item is not NIL or len(values) != count:
        raise type_error(type_name, term)
    return values


def parse_vector(term: Term) -> Vector:
    """Return the coordinates of a position ``[X,Y,Z]``."""
    return parse_numbers(term, 3, "position")


def parse_quaternion(term: Term) -> Vector:
    """Return the components of a rotation ``[QX,QY,QZ,QW]``; a zero quaternion is a domain error."""
    components = parse_numbers(term, 4, "quaternion")
    if not any(components):
        raise domain_error("quaternion", term)
    return components


def parse_pose_parts(position: Term, rotation: Term) -> Pose:
    """Return the values of a position and a rotation."""
    # Fast path for the most common case, seven floats without variables in between. Without it a query that
    # multiplies five poses takes 50 % longer.
    try:
        cons1, x, (cons2, y, (cons3, z, end1)) = position  # type: ignore[misc]
        cons4, i, (cons5, j, (cons6, k, (cons7, w, end2))) = rotation  # type: ignore[misc]
    except (TypeError, ValueError):
        return parse_vector(position), parse_quaternion(rotation)
    if not (cons1 is cons2 is cons3 is cons4 is cons5 is cons6 is cons7 is CONS and end1 is end2 is NIL):
        return parse_vector(position), parse_quaternion(rotation)
    is_nonzero_rotation = i.__class__ is j.__class__ is k.__class__ is w.__class__ is float and (
        w or i or j or k
    )
    if is_nonzero_rotation and x.__class__ is y.__class__ is z.__class__ is float:
        return (x, y, z), (i, j, k, w)
    return parse_vector(position), parse_quaternion(rotation)


def parse_pose(term: Term) -> Pose:
    """Return the position and the rotation of a pose."""
    if term.__class__ is Var:
        term = deref(term)
    if term.__class__ is Lazy and term.decoder is pose_term:
        source: Optional[Pose] = term.source
        if source is not None:  # the term has not been built yet
            return source
    try:
        cons1, position, (cons2, rotation, end) = term  # type: ignore[misc]
    except (TypeError, ValueError):
        pass
    else:
        if cons1 is cons2 is CONS and end is NIL:
            return parse_pose_parts(position, rotation)
    fields = list_items(term)
    if fields is None or len(fields) != 2:
        raise instantiation_error() if deref(term).__class__ is Var else type_error("pose", term)
    return parse_pose_parts(fields[0], fields[1])


def parse_matrix(term: Term) -> Matrix:
    """Return the rows of a matrix."""
    rows = list_items(term)
    if rows is None or len(rows) != 4:
        raise instantiation_error() if deref(term).__class__ is Var else type_error("matrix", term)
    return [list(parse_numbers(row, 4, "matrix_row")) for row in rows]


# Mathematics


def compose(first: Pose, second: Pose) -> Pose:
    """Return the pose that ``second``, given relative to ``first``, has in the frame of ``first``.

    The position is rotated by ``q p q*``, where ``q`` is not normalised, as by tf2's ``quatRotate``.
    """
    (x, y, z), (i, j, k, w) = first
    (px, py, pz), (pi, pj, pk, pw) = second
    ti = w * px + j * pz - k * py
    tj = w * py + k * px - i * pz
    tk = w * pz + i * py - j * px
    tw = i * px + j * py + k * pz
    position = (
        x + (tw * i + ti * w - tj * k + tk * j),
        y + (tw * j + tj * w - tk * i + ti * k),
        z + (tw * k + tk * w - ti * j + tj * i),
    )
    rotation = (
        w * pi + i * pw + j * pk - k * pj,
        w * pj + j * pw + k * pi - i * pk,
        w * pk + k * pw + i * pj - j * pi,
        w * pw - i * pi - j * pj - k * pk,
    )
    return position, rotation


def interpolate(first: Pose, second: Pose, fraction: float) -> Pose:
    """Return an interpolated pose.

    The rotation follows the shorter arc, as in tf2's ``Quaternion::slerp``. The cosine of a small angle is inexact,
    but the weights, which are ratios of the sines of its parts and of the whole angle, hardly depend on it.

    Args:
        first: the first pose.
        second: the second pose.
        fraction: the weight of the first pose: 1 returns the first pose, 0 the second one.
    """
    (ax, ay, az), (ai, aj, ak, aw) = first
    (bx, by, bz), (bi, bj, bk, bw) = second
    first_weight, second_weight = fraction, 1 - fraction
    position = (
        ax * first_weight + bx * second_weight,
        ay * first_weight + by * second_weight,
        az * first_weight + bz * second_weight,
    )
    lengths = sqrt(ai * ai + aj * aj + ak * ak + aw * aw) * sqrt(bi * bi + bj * bj + bk * bk + bw * bw)
    cosine = (ai * bi + aj * bj + ak * bk + aw * bw) / lengths
    # q and -q are the same rotation; a negative cosine means that the arc to -q is the shorter one.
    if cosine < 0:
        bi, bj, bk, bw, cosine = -bi, -bj, -bk, -bw, -cosine
    # Equal rotations, up to rounding: the sine would be zero.
    if cosine >= 1:
        return position, (
            ai + second_weight * (bi - ai),
            aj + second_weight * (bj - aj),
            ak + second_weight * (bk - ak),
            aw + second_weight * (bw - aw),
        )
    angle = acos(cosine)
    sine = sin(angle)
    first_weight, second_weight = sin(first_weight * angle) / sine, sin(second_weight * angle) / sine
    return position, (
        ai * first_weight + bi * second_weight,
        aj * first_weight + bj * second_weight,
        ak * first_weight + bk * second_weight,
        aw * first_weight + bw * second_weight,
    )


def to_matrix(value: Pose) -> Matrix:
    """Return the homogeneous matrix of a pose; the quaternion need not be normalised."""
    (px, py, pz), (x, y, z, w) = value
    s = 2.0 / (x * x + y * y + z * z + w * w)
    return [
        [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w), float(px)],
        [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w), float(py)],
        [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y), float(pz)],
        [0.0, 0.0, 0.0, 1.0],
    ]


def multiply_matrices(left: Matrix, right: Matrix) -> Matrix:
    """Return the product of two matrices."""
    columns = list(zip(*right))
    return [[sum(a * b for a, b in zip(row, column)) for column in columns] for row in left]


def transform_vector(value: Matrix, point: Vector) -> Vector:
    """Return a point transformed by a homogeneous matrix."""
    x, y, z = point
    return [row[0] * x + row[1] * y + row[2] * z + row[3] for row in value[:3]]


# Terms


def float_list_term(values: Sequence[float]) -> Term:
    """Return a list of floats as a term."""
    return make_list([float(value) for value in values])


def pose_term(value: Pose) -> Term:
    """Return the term of a pose."""
    # Built without `float_list_term`, with which a query that multiplies five poses takes 20 % longer, and the
    # benchmark of the NAO robot 1.4 %.
    (px, py, pz), (x, y, z, w) = value
    position = (CONS, float(px), (CONS, float(py), (CONS, float(pz), NIL)))
    rotation = (CONS, float(x), (CONS, float(y), (CONS, float(z), (CONS, float(w), NIL))))
    return (CONS, position, (CONS, rotation, NIL))


def lazy_pose_term(value: Pose) -> Term:
    """Return a lazy term of a pose of floats: most poses are only multiplied with others, so no term is needed."""
    return Lazy(CONS, pose_term, value)


def matrix_term(value: Matrix) -> Term:
    """Return the term of a matrix."""
    return make_list([float_list_term(row) for row in value])


def parse_transform(term: Term) -> Matrix:
    """Return the matrix of a transform ``['M',Matrix]`` or ``['Q',Pose]``, a pose, or a matrix."""
    fields = list_items(term)
    if fields is None:
        raise instantiation_error() if deref(term).__class__ is Var else type_error("transform", term)
    if len(fields) == 2:
        tag = deref(fields[0])
        if tag is _M:
            return parse_matrix(fields[1])
        if tag is _Q:
            return to_matrix(parse_pose(fields[1]))
        if tag.__class__ is Atom:
            raise domain_error("transform", term)
        return to_matrix(parse_pose(term))
    return parse_matrix(term)


# Predicates


def _parse_fraction(term: Term) -> float:
    if term.__class__ is tuple and term[0] is CONS and term[1].__class__ is float and term[2] is NIL:
        return term[1]
    return float(parse_numbers(term, 1, "[Fraction]")[0])


@function("interpolate_quaternion/6")
def interpolate_quaternion(v1: Term, q1: Term, v2: Term, q2: Term, fraction: Term) -> Term:
    """Return an interpolated pose; fraction 1 returns the first pose, 0 the second one."""
    return lazy_pose_term(
        interpolate(parse_pose_parts(v1, q1), parse_pose_parts(v2, q2), _parse_fraction(fraction))
    )


@function("quaternion_interpolate/6")
def quaternion_interpolate(v1: Term, q1: Term, v2: Term, q2: Term, fraction: Term) -> Term:
    """Return the matrix of an interpolated pose."""
    value = interpolate(parse_pose_parts(v1, q1), parse_pose_parts(v2, q2), _parse_fraction(fraction))
    return matrix_term(to_matrix(value))


@function("transform_quaternion/2")
def transform_quaternion(poses: Term) -> Term:
    """Return the product of poses, from left to right."""
    items = list_items(poses)
    if items is None:
        raise instantiation_error() if deref(poses).__class__ is Var else type_error("list", poses)
    value: Pose = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    if items:
        value = parse_pose(items[0])
    for item in items[1:]:
        value = compose(value, parse_pose(item))
    return pose_term(value)


@function("mul_quaternion/5")
def mul_quaternion(v1: Term, q1: Term, v2: Term, q2: Term) -> Term:
    """Return the product of two poses."""
    return pose_term(compose(parse_pose_parts(v1, q1), parse_pose_parts(v2, q2)))


@function("transform/2")
def transform(transforms: Term) -> Term:
    """Return the product of poses and matrices, from left to right, as ``['M',Matrix]``."""
    items = list_items(transforms)
    if items is None:
        raise instantiation_error() if deref(transforms).__class__ is Var else type_error("list", transforms)
    value = to_matrix(((0, 0, 0), (0, 0, 0, 1)))
    for item in items:
        value = multiply_matrices(value, parse_transform(item))
    return (CONS, _M, (CONS, matrix_term(value), NIL))


@function("transform/3")
def transform_two(first: Term, second: Term) -> Term:
    """Return the product of two poses or matrices as ``['M',Matrix]``."""
    return transform(make_list([first, second]))


@function("tf_point/3")
def tf_point(point: Term, transform_term: Term) -> Term:
    """Return a point transformed by a transform."""
    return float_list_term(transform_vector(parse_transform(transform_term), parse_vector(point)))


@function("transform_point/3")
def transform_point(point: Term, transform_term: Term) -> Term:
    """Return a point transformed by a matrix."""
    return float_list_term(transform_vector(parse_transform(transform_term), parse_vector(point)))


@function("mul_matrix/3")
def mul_matrix(left: Term, right: Term) -> Term:
    """Return the product of two matrices."""
    return matrix_term(multiply_matrices(parse_matrix(left), parse_matrix(right)))


@function("convert_to_mat/3")
def convert_to_mat(position: Term, rotation: Term) -> Term:
    """Return the matrix of a pose."""
    value = to_matrix(parse_pose_parts(position, rotation))
    return matrix_term(value)


@deterministic("print_matrix/1")
def print_matrix(machine: ProgramMachine, term: Term) -> bool:
    """Print a matrix, one row per line."""
    rows = parse_transform(term)
    machine.logic.output("".join(" ".join(f"{value:12.6f}" for value in row) + "\n" for row in rows))
    return True
