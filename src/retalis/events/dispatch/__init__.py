"""Dispatch of events to the listeners with matching patterns."""
