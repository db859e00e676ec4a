"""Full names of topics in ROS 1, and the errors of the master that knows them."""

from http.client import HTTPException
from xml.parsers.expat import ExpatError
from xmlrpc.client import Error

import rosgraph
import rospy

from ..foundation.errors import UsageError
from ..foundation.ros_name_checks import topic_fault

MASTER_ERRORS = (
    OSError,
    Error,
    HTTPException,
    ExpatError,
    rosgraph.MasterException,
    rosgraph.MasterError,
)
"""Errors of a call of the master that does not answer, or not as expected: another server may have its port."""


def resolve(topic: str) -> str:
    """Return the full name of a topic, after remapping and in its namespace.

    Raises:
        UsageError: if the name is invalid.
    """
    # rospy accepts names that the master or other clients reject, so the package's own check comes first.
    fault = topic_fault(topic.strip())
    if fault is not None or not topic.strip(" /"):
        raise UsageError(fault or f'"{topic}" is not a topic name')
    try:
        return str(rospy.resolve_name(topic.strip()))
    except (ValueError, rospy.ROSException) as error:
        raise UsageError(f'"{topic}" is not a topic name: {error}') from error
