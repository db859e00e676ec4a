"""Arithmetic: the evaluable functions, and the evaluation of expressions."""

from . import bits, functions, rounding  # noqa: F401  (they register evaluable functions)
from .evaluation import (
    EVALUABLE,
    LARGEST,
    LEAST,
    Number,
    add,
    bounded,
    checked,
    evaluate,
    measure,
    multiply,
    subtract,
)
from .instants import plain

__all__ = [
    "add",
    "bounded",
    "checked",
    "EVALUABLE",
    "evaluate",
    "LARGEST",
    "LEAST",
    "measure",
    "multiply",
    "Number",
    "plain",
    "subtract",
]
