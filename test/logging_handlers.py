"""Handlers of loggers for tests."""

import logging
from typing import List


class RecordingHandler(logging.Handler):
    """A handler that appends the messages of records to a list."""

    def __init__(self, messages: List[str]) -> None:
        super().__init__()
        self.messages = messages

    def emit(self, record: logging.LogRecord) -> None:
        self.messages.append(record.getMessage())
