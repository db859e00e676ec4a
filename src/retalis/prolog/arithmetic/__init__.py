"""Arithmetic: the evaluable functions, and the evaluation of expressions."""

from . import bits, functions, rounding  # noqa: F401  (they register evaluable functions)
from .evaluation import EVALUABLE, LARGEST, LEAST, Number, add, bounded, checked, evaluate, multiply, subtract

__all__ = [
    "add",
    "bounded",
    "checked",
    "EVALUABLE",
    "evaluate",
    "LARGEST",
    "LEAST",
    "multiply",
    "Number",
    "subtract",
]
