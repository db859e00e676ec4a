"""Errors, caches, code generation and other utilities without dependencies."""
