"""Snapshots as plain data: codec, schemas and the sections of a state."""
