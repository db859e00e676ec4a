"""A running program as a node, independent of any middleware."""
