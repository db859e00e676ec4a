"""Re-registration of a node after a restart of the master.

A restarted master has lost all registrations and parameters. rospy registers once and never checks again: existing
connections continue, but new nodes cannot find the node. A thread therefore asks the master each second for one of
the node's own services. If the master answers but does not know the service, the node registers its topics, services
and parameters again, with the XML-RPC API of master and nodes.

rospy may unregister a topic or service at the same time, so the node compares its registrations before and after, and
unregisters those that have ended meanwhile.
"""

import sys
import threading
import time
from http.client import HTTPConnection, HTTPException
from typing import Any, Dict, List, Tuple, Union
from xml.parsers.expat import ExpatError
from xmlrpc.client import Error, ServerProxy, Transport

import rosgraph
import rospy
from rospy.impl.registration import get_service_manager

MASTER_ERRORS = (
    OSError,
    Error,
    HTTPException,
    ExpatError,
    rosgraph.MasterException,
    rosgraph.MasterError,
)
"""Errors of a call of the master that does not answer, or not as expected: another server may have its port."""

CHECK_INTERVAL_SECONDS = 1.0
"""Seconds between two checks."""

CALL_TIMEOUT_SECONDS = 5.0
"""Timeout in seconds of a call."""

REGISTRATION_INDICATOR = "~get_loggers"
"""A service that rospy offers in each node. It is registered last, so that its presence implies all the others."""

SIM_TIME_PARAMETER = "/use_sim_time"

_Pairs = List[Tuple[str, str]]


def wait_for_master() -> None:
    """Wait until the master answers.

    rospy itself waits when it registers, but fails when it sets the parameters of the command line.
    """
    uri = rosgraph.get_master_uri()
    master, is_reported = _proxy(uri), False
    while True:
        try:
            master.getPid("/retalis")
            return
        except MASTER_ERRORS as error:
            if not is_reported:
                is_reported = True
                text = f"no master answers at {uri} ({error}): waiting for it; roscore starts one"
                print(text, file=sys.stderr, flush=True)
        time.sleep(CHECK_INTERVAL_SECONDS / 5)


class MasterWatch:
    """Periodic check that the master knows the node, with re-registration if it does not.

    The node's private parameters and ``/use_sim_time`` are restored to their values at construction, except those
    that have been set meanwhile.
    """

    def __init__(self) -> None:
        self._name = rospy.get_name()
        self._indicator = rospy.resolve_name(REGISTRATION_INDICATOR)
        self._master = _proxy(rosgraph.get_master_uri())
        self._own_node = _proxy(rospy.get_node_uri())
        self._parameters = self._known_parameters()
        self._registration_lock = threading.Lock()
        self._ended = threading.Event()

    def start(self) -> None:
        """Start the periodic check, which ends with the node."""
        # A rospy without this service: its absence in the master would not prove a restart.
        if self._indicator not in dict(_services()):
            rospy.logdebug("%s is not there: the master is not watched", self._indicator)
            return
        rospy.on_shutdown(self._stop)
        threading.Thread(target=self._run, daemon=True, name="master watch").start()

    def check(self) -> None:
        """Check once, and register again if necessary.

        Raises:
            MASTER_ERRORS: if the master does not answer.
        """
        code, _, _ = self._master.lookupService(self._name, self._indicator)
        if code == -1:
            self._register()

    def _run(self) -> None:
        while not self._ended.wait(CHECK_INTERVAL_SECONDS):
            with self._registration_lock:
                if self._ended.is_set():
                    return
                try:
                    self.check()
                except MASTER_ERRORS as error:
                    rospy.logdebug("the master does not answer: %s", error)

    def _stop(self) -> None:
        """Stop the checks, and wait for a registration in progress: rospy is about to unregister everything."""
        self._ended.set()
        if self._registration_lock.acquire(timeout=CALL_TIMEOUT_SECONDS):
            self._registration_lock.release()

    def _register(self) -> None:
        for name, value in self._parameters.items():
            # A launch file that restarted the master may have set other values.
            if not self._master.hasParam(self._name, name)[2]:
                self._master.setParam(self._name, name, value)
        published, subscribed, services = self._publications(), self._subscriptions(), _services()
        refused = []
        for name, topic_type in published:
            refused += self._register_one("registerPublisher", name, topic_type)
        for name, topic_type in subscribed:
            refused += self._subscribe(name, topic_type)
        for name, uri in sorted(services, key=lambda service: service[0] == self._indicator):
            if not self._ended.is_set():
                refused += self._register_one("registerService", name, uri)
        self._unregister_closed(published, subscribed, services)
        rospy.logwarn(
            "the master was started anew: this node has registered again, with %d published and %d subscribed topics "
            "and %d services%s",
            len(published),
            len(subscribed),
            len(services),
            f"; refused: {', '.join(refused)}" if refused else "",
        )

    def _register_one(self, method: str, name: str, value: str) -> List[str]:
        """Register a topic or service; return its name if the master refuses."""
        code, _, _ = getattr(self._master, method)(self._name, name, value, rospy.get_node_uri())
        return [] if code == 1 else [name]

    def _subscribe(self, name: str, topic_type: str) -> List[str]:
        """Register a subscription, and connect to the publishers that the master knows already."""
        code, _, publishers = self._master.registerSubscriber(
            self._name, name, topic_type, rospy.get_node_uri()
        )
        if code != 1:
            return [name]
        # The master informs only later subscribers about new publishers; this call stands for its first
        # notification.
        self._own_node.publisherUpdate("/master", name, publishers)
        return []

    def _unregister_closed(self, published: _Pairs, subscribed: _Pairs, services: _Pairs) -> None:
        """Unregister topics and services that the node has closed during the registration."""
        for name in _removed_names(published, self._publications()):
            self._master.unregisterPublisher(self._name, name, rospy.get_node_uri())
        for name in _removed_names(subscribed, self._subscriptions()):
            self._master.unregisterSubscriber(self._name, name, rospy.get_node_uri())
        remaining = dict(_services())
        for name, uri in services:
            if name not in remaining:
                self._master.unregisterService(self._name, name, uri)

    def _publications(self) -> _Pairs:
        return _pairs(self._own_node.getPublications(self._name)[2])

    def _subscriptions(self) -> _Pairs:
        return _pairs(self._own_node.getSubscriptions(self._name)[2])

    def _known_parameters(self) -> Dict[str, Any]:
        """Return the node's parameters at its start, by full name."""
        private = rospy.get_param("~", {})
        parameters = {rospy.resolve_name("~" + name): value for name, value in private.items()}
        sim_time = rospy.get_param(SIM_TIME_PARAMETER, None)
        return parameters if sim_time is None else {**parameters, SIM_TIME_PARAMETER: sim_time}


class _TimeoutTransport(Transport):
    """Transport with a timeout: a master that hangs must not block the thread forever."""

    def make_connection(self, host: Union[str, Tuple[str, Dict[str, str]]]) -> HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = CALL_TIMEOUT_SECONDS
        return connection


def _proxy(uri: str) -> Any:
    return ServerProxy(uri, _TimeoutTransport())


def _services() -> _Pairs:
    """Return the node's services and their addresses, which rospy's node API does not contain."""
    manager = get_service_manager()
    return [] if manager is None else _pairs(manager.get_services())


def _pairs(entries: Any) -> _Pairs:
    return [(name, value) for name, value in entries]


def _removed_names(before: _Pairs, now: _Pairs) -> List[str]:
    remaining = {name for name, _ in now}
    return [name for name, _ in before if name not in remaining]
