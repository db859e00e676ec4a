"""Partial matches: buffers, consumption policies, negation and expiration."""
