"""Fused paths: generated functions that do the work of several listeners."""
