"""What every room stands on: errors with places, bounded caches, generated code, checked names, watched work."""

from . import codegen
from .caches import Cache, Texts
from .codegen import LARGEST, shared_function
from .errors import (
    LONGEST,
    SHOWN,
    Errors,
    MessageError,
    Place,
    ProgramErrors,
    RetalisError,
    RuleError,
    SyntaxFault,
    TermTooLarge,
    UsageError,
    beginning,
    counted,
    place_at,
    place_in,
    place_on,
    printable,
    shortened,
    undecodable,
)
from .rosnames import plain_fault, topic_fault, type_fault
from .watching import BULK, WATCH, look, unwatched, watch_for, watched_by

__all__ = [
    "beginning",
    "BULK",
    "Cache",
    "codegen",
    "counted",
    "Errors",
    "LARGEST",
    "LONGEST",
    "look",
    "MessageError",
    "Place",
    "place_at",
    "place_in",
    "place_on",
    "plain_fault",
    "printable",
    "ProgramErrors",
    "RetalisError",
    "RuleError",
    "shared_function",
    "shortened",
    "SHOWN",
    "SyntaxFault",
    "TermTooLarge",
    "Texts",
    "topic_fault",
    "type_fault",
    "undecodable",
    "unwatched",
    "UsageError",
    "WATCH",
    "watch_for",
    "watched_by",
]
