"""The state of an engine as data: what it says, what it knows, what waits in it."""

from .coding import from_bytes, to_bytes
from .container import FORMAT, LAYOUT, check_version, pack, unpack
from .holdings import (
    NewRecords,
    keep_memories,
    keep_records,
    keep_sent,
    keep_subscriptions,
    new_records,
    restore_memories,
    restore_records,
    restore_subscriptions,
)
from .network import keep_matches, keep_rules, restore_matches, restore_rules
from .schema import anything, dict_of, text
from .sections import SECTIONS, about, read_records, read_section

__all__ = [
    "about",
    "read_records",
    "read_section",
    "anything",
    "dict_of",
    "SECTIONS",
    "text",
    "check_version",
    "FORMAT",
    "LAYOUT",
    "from_bytes",
    "keep_matches",
    "keep_memories",
    "keep_records",
    "keep_rules",
    "keep_sent",
    "keep_subscriptions",
    "NewRecords",
    "new_records",
    "pack",
    "restore_matches",
    "restore_memories",
    "restore_records",
    "restore_rules",
    "restore_subscriptions",
    "to_bytes",
    "unpack",
]
