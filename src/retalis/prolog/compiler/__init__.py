"""Clauses to Python source: one function for each predicate, continuations as functions of their own."""

from .direct import Direct
from .facts import fact_search
from .goals import GoalGenerator
from .keys import key_of
from .known import JoinedGoals, Joins, KnownDatabase, KnownPredicate
from .nodes import (
    ARROW,
    BAR,
    CALL,
    COMPARISONS,
    CONTROL,
    EQUAL,
    FIXED,
    IGNORE,
    NOT,
    ONCE,
    ORDERS,
    SEMICOLON,
    SOFT_ARROW,
)
from .predicates import ClauseParts, Generator

__all__ = [
    "ARROW",
    "BAR",
    "CALL",
    "COMPARISONS",
    "CONTROL",
    "Direct",
    "EQUAL",
    "fact_search",
    "FIXED",
    "Generator",
    "GoalGenerator",
    "IGNORE",
    "JoinedGoals",
    "Joins",
    "key_of",
    "KnownDatabase",
    "KnownPredicate",
    "NOT",
    "ONCE",
    "ORDERS",
    "ClauseParts",
    "SEMICOLON",
    "SOFT_ARROW",
]
