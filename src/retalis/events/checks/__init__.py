"""What a program says that was probably not meant: found when it has been loaded, before anything happens.

Each check looks at an `Overview` of the program, and yields what is wrong, each thing with its place; `CHECKS` in
`findings.py` lists them.
"""

from .findings import ERROR, INFO, WARNING, Finding, look_through
from .made import without_maker
from .outputs import output_fault
from .overview import Overview

__all__ = [
    "ERROR",
    "Finding",
    "INFO",
    "look_through",
    "output_fault",
    "Overview",
    "WARNING",
    "without_maker",
]
