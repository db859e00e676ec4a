"""Predicates, clauses, indexes and modules."""
