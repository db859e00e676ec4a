"""Dispatch of events to the listeners whose patterns can match them."""
