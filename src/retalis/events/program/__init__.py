"""A program as files: its folder, topics, goals and rules, read, checked and loaded."""

from .clauses import FileChecker, nowhere
from .door import MEGABYTE
from .files import Files
from .folder import (
    ATTRIBUTES,
    DIRECT,
    GOALS,
    RULES,
    TOPICS,
    TopicEvent,
    Topics,
    TopicType,
    event_types,
    read_text,
    read_topics,
    topic_type,
)
from .goals import FileGoal, errors_in, goal_of, goals_of, read_goals
from .loading import Loader

__all__ = [
    "ATTRIBUTES",
    "DIRECT",
    "event_types",
    "FileChecker",
    "errors_in",
    "Files",
    "FileGoal",
    "goal_of",
    "GOALS",
    "goals_of",
    "Loader",
    "MEGABYTE",
    "nowhere",
    "read_goals",
    "read_text",
    "read_topics",
    "RULES",
    "topic_type",
    "TOPICS",
    "TopicEvent",
    "Topics",
    "TopicType",
]
