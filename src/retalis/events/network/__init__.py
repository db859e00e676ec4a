"""The pattern network: nodes that build matches from events."""
