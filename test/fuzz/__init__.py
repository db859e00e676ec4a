"""Inputs that nobody would write, against every place where the package takes some; see README.md."""
