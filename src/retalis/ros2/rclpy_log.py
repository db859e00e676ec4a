"""Log of a node: forwarding of the package's records to ROS 2, for the screen and ``/rosout``."""

import logging

from rclpy.node import Node

from ..foundation.displayed_text import printable
from ..node.goal_output import log_counts
from ..prolog.builtins.listing_and_messages import goal_log


class _NodeHandler(logging.Handler):
    def __init__(self, node: Node):
        super().__init__()
        self._log = node.get_logger()

    def emit(self, record: logging.LogRecord) -> None:
        try:
            self._forward(record)
        except Exception:
            self.handleError(record)

    def _forward(self, record: logging.LogRecord) -> None:
        # Records contain text from outside, which must not look like another record.
        text = printable(self.format(record)).replace("\n", "\n    ")
        # rclpy requires that a place in the code always logs with one severity.
        if record.levelno >= logging.CRITICAL:
            self._log.fatal(text)
        elif record.levelno >= logging.ERROR:
            self._log.error(text)
        elif record.levelno >= logging.WARNING:
            self._log.warning(text)
        elif record.levelno >= logging.INFO:
            self._log.info(text)
        else:
            self._log.debug(text)


def forward_log(logger: logging.Logger, node: Node) -> None:
    """Forward the records of a logger to the log of a node, and count them in `log_counts`."""
    for handler in list(logger.handlers):
        logger.removeHandler(handler)
    logger.addHandler(log_counts)
    logger.addHandler(_NodeHandler(node))
    logger.setLevel(logging.INFO)
    logger.propagate = False
    # Rules may log for debugging: the node drops these records unless its level is lower.
    goal_log.setLevel(logging.DEBUG)
