"""Clauses to Python source: one function for each predicate, continuations as functions of their own."""

from .nodes import CONTROL
from .predicates import Generator, Rule

__all__ = ["CONTROL", "Generator", "Rule"]
