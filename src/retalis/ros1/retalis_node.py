"""Node ``retalis``: a `ProgramHost` on rospy.

By default this node itself subscribes to and publishes all topics of the program. The interface node then only offers
the services for input topics; with parameter ``~embedded`` this node offers them, too. If parameter ``~direct`` is
false or a list, messages of the other topics pass as text through the interface node.
"""

from typing import Any, Callable, List

from ..engine.engine import Engine
from ..engine.event_input import TopicRequest
from ..engine.runtime.problem_reports import Reports
from ..node.parameters import Parameters
from ..node.program_host import ProgramHost
from ..node.program_host_context import HostContext
from ..node.subscribed_topics import SubscribedTopics
from .internode_control_topics import InputTopicChangesReceiver, ProjectionPublisher, SubscriptionPublisher
from .node_lifecycle import run_node
from .rospy_transport import RospyTransport
from .text_topics import RospyTextExchange


class InterfaceLink:
    """The exchange with the node ``retalis_ros_interface``.

    Args:
        reports: receives a warning for each malformed message.
    """

    def __init__(self, parameters: Parameters, reports: Reports):
        self._parameters = parameters
        self._reports = reports
        self._parts: List[Any] = []

    def connect(self, engine: Engine, subscribed: SubscribedTopics) -> List[Callable[[TopicRequest], object]]:
        """Start the exchange; see `ConnectInterface`."""
        publisher = SubscriptionPublisher()
        if self._parameters.uses_texts:
            self._parts.append(ProjectionPublisher(engine))
            executors: List[Callable[[TopicRequest], object]] = [publisher.publish_added]
            changed_topics = None
        else:
            executors = [subscribed.try_to_subscribe, publisher.publish_added]
            changed_topics = subscribed
        self._parts.append(InputTopicChangesReceiver(changed_topics, self._parameters.direct, self._reports))
        return executors


def create_node(parameters: Parameters) -> ProgramHost:
    """Return the running node."""
    reports = Reports()
    context = HostContext(RospyTransport(reports), parameters, reports)
    connect_interface = None if parameters.embedded else InterfaceLink(parameters, reports).connect
    return ProgramHost(context, RospyTextExchange(context), connect_interface)


def main() -> int:
    """Run the node until it is shut down; return its exit status."""
    return run_node("retalis", create_node)
