"""Calls to SWI-Prolog through its C library."""
