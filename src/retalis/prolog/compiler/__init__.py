"""Compiler from clauses to Python functions."""
