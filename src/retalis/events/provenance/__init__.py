"""Provenance of events: lineage, event log and justification."""
