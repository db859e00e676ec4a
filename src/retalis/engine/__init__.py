"""The engine: a program, the events that it takes, and what its subscribers get."""

from .asking import ask, await_memories, do_for_others
from .callbacks import OnEvent, OnOutput
from .checking import check_program, never_comes, never_sent
from .checkpointing import Checkpoints, resume
from .checkpoints import Checkpoint, CheckpointFile, ProgramFiles, put_aside
from .core import parts_of
from .engine import Engine
from .inputtopics import MOST_TOPICS, AskedTopic, InputTopics, by_name
from .rulechanges import add_rule, delete_rule
from .settings import Settings
from .status import (
    AwaitedMemory,
    LeftOut,
    MemoryStatus,
    RuleStatus,
    Status,
    SubscriptionStatus,
    WaitingStatus,
    Work,
)

__all__ = [
    "add_rule",
    "ask",
    "AskedTopic",
    "await_memories",
    "by_name",
    "check_program",
    "Checkpoint",
    "CheckpointFile",
    "Checkpoints",
    "delete_rule",
    "do_for_others",
    "AwaitedMemory",
    "Engine",
    "InputTopics",
    "LeftOut",
    "MOST_TOPICS",
    "MemoryStatus",
    "OnEvent",
    "OnOutput",
    "never_comes",
    "never_sent",
    "parts_of",
    "ProgramFiles",
    "put_aside",
    "resume",
    "RuleStatus",
    "Settings",
    "Status",
    "SubscriptionStatus",
    "WaitingStatus",
    "Work",
]
