"""Provenance of events: lineage and justification."""
