"""The assembled Prolog system, and its interface to Python."""
