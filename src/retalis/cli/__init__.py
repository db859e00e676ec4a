"""The command line: ``retalis COMMAND``."""
