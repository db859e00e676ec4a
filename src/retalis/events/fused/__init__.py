"""Fused paths: generated functions that each do the work of several network nodes."""
