"""A program as files: its folder, topics, goals and rules, read, checked and loaded."""

from .clauses import FileChecker, nowhere, reread_rule
from .files import Files
from .folder import (
    ATTRIBUTES,
    AUTO,
    GOALS,
    RULES,
    TOPICS,
    DirectTopics,
    TopicEvent,
    Topics,
    TopicType,
    direct_topics,
    event_types,
    read_direct,
    read_text,
    read_topics,
    topic_type,
)
from .goals import FileGoal, errors_in, goal_of, goals_of, read_goals
from .loading import Loader

__all__ = [
    "ATTRIBUTES",
    "AUTO",
    "direct_topics",
    "DirectTopics",
    "event_types",
    "FileChecker",
    "errors_in",
    "Files",
    "FileGoal",
    "goal_of",
    "GOALS",
    "goals_of",
    "Loader",
    "nowhere",
    "read_direct",
    "read_goals",
    "read_text",
    "read_topics",
    "reread_rule",
    "RULES",
    "topic_type",
    "TOPICS",
    "TopicEvent",
    "Topics",
    "TopicType",
]
