"""Explanations of why an event happened or did not happen."""
