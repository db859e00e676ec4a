"""The thread that runs the callbacks of a node: events, parameters, services and states of the life cycle."""

import threading
from typing import Callable

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

MAX_WAIT_SECONDS = 1.0
"""Longest wait for each thread when the node ends."""


class NodeExecutor:
    """A running executor of rclpy with one node.

    Args:
        node: the node.
        on_error: receives exceptions of callbacks.

    Attributes:
        executor: the executor.
    """

    def __init__(self, node: Node, on_error: Callable[[Exception], object]):
        self.executor = SingleThreadedExecutor(context=node.context)
        self.executor.add_node(node)
        self._context = node.context
        self._on_error = on_error
        self._is_stopped = False
        self._thread = threading.Thread(target=self._run, daemon=True, name="executor")
        self._thread.start()

    def stop(self) -> None:
        """Run no more callbacks."""
        self._is_stopped = True
        self.executor.shutdown(timeout_sec=MAX_WAIT_SECONDS)
        self._thread.join(timeout=MAX_WAIT_SECONDS)

    def _run(self) -> None:
        while not self._is_stopped and self._context.ok():
            try:
                self.executor.spin()
            except ExternalShutdownException:
                return
            except Exception as error:
                # The failure of one callback must not end the others.
                if not self._is_stopped:
                    self._on_error(error)
