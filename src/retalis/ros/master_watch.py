"""Registering again with a master that was started anew.

A master that ends takes with it who publishes, subscribes and offers what, and the parameters. rospy registers once,
and never looks again: connections that are there go on, but nobody new finds the node. So a thread asks the master
each second for one of the node's own services. Where the master answers, and does not know it, the node registers all
that it has, by the XML-RPC interface that masters and nodes are defined by.
"""

import sys
import threading
import time
from http.client import HTTPConnection, HTTPException
from typing import Any, Dict, List, Tuple, Union
from xmlrpc.client import Error, ServerProxy, Transport

import rosgraph
import rospy
from rospy.impl.registration import get_service_manager

PERIOD = 1.0
"""Seconds from one look to the next."""

TIMEOUT = 5.0
"""Seconds after which an answer is not waited for any longer."""

SIGN = "~get_loggers"
"""A service that rospy offers for each node. It is registered last, so that it stands for all the others."""

SIMULATED = "/use_sim_time"

_Pairs = List[Tuple[str, str]]


def wait_for_master() -> None:
    """Return when the master answers.

    rospy waits too where it registers, but ends with an error where it sets the parameters of the command line.
    """
    uri = rosgraph.get_master_uri()
    master, told = _proxy(uri), False
    while True:
        try:
            master.getPid("/retalis")
            return
        except (OSError, HTTPException, Error) as error:
            if not told:
                told = True
                text = f"no master answers at {uri} ({error}): waiting for it; roscore starts one"
                print(text, file=sys.stderr, flush=True)
        time.sleep(PERIOD / 5)


class MasterWatch:
    """Looks whether the master knows the node, and registers it again where it does not.

    The node's private parameters and ``/use_sim_time`` are given back to it as they were when this was made, but for
    what somebody else has set meanwhile.
    """

    def __init__(self) -> None:
        self._name = rospy.get_name()
        self._sign = rospy.resolve_name(SIGN)
        self._master = _proxy(rosgraph.get_master_uri())
        self._self = _proxy(rospy.get_node_uri())
        self._parameters = self._known_parameters()
        self._work = threading.Lock()
        self._ended = threading.Event()

    def start(self) -> None:
        """Look from now on, until the node is shut down."""
        if self._sign not in dict(_services()):
            rospy.logdebug("%s is not there: the master is not watched", self._sign)
            return
        rospy.on_shutdown(self._stop)
        threading.Thread(target=self._run, daemon=True, name="master watch").start()

    def look(self) -> None:
        """Look once.

        Raises:
            OSError, HTTPException, Error: where the master does not answer.
        """
        code, _, _ = self._master.lookupService(self._name, self._sign)
        if code == -1:
            self._register()

    def _run(self) -> None:
        while not self._ended.wait(PERIOD):
            with self._work:
                if self._ended.is_set():
                    return
                try:
                    self.look()
                except (OSError, HTTPException, Error) as error:
                    rospy.logdebug("the master does not answer: %s", error)

    def _stop(self) -> None:
        """Have nothing registered once rospy takes it back."""
        self._ended.set()
        if self._work.acquire(timeout=TIMEOUT):
            self._work.release()

    def _register(self) -> None:
        for name, value in self._parameters.items():
            if not self._master.hasParam(self._name, name)[2]:
                self._master.setParam(self._name, name, value)
        published, subscribed, services = self._publications(), self._subscriptions(), _services()
        refused = []
        for name, kind in published:
            refused += self._ask("registerPublisher", name, kind)
        for name, kind in subscribed:
            refused += self._subscribe(name, kind)
        for name, uri in sorted(services, key=lambda one: one[0] == self._sign):
            if not self._ended.is_set():
                refused += self._ask("registerService", name, uri)
        self._take_back(published, subscribed, services)
        rospy.logwarn(
            "the master was started anew: this node has registered again, with %d published and %d subscribed topics "
            "and %d services%s",
            len(published),
            len(subscribed),
            len(services),
            f"; refused: {', '.join(refused)}" if refused else "",
        )

    def _ask(self, method: str, name: str, what: str) -> List[str]:
        """Register one thing; return its name where the master refuses."""
        code, _, _ = getattr(self._master, method)(self._name, name, what, rospy.get_node_uri())
        return [] if code == 1 else [name]

    def _subscribe(self, name: str, kind: str) -> List[str]:
        """Register a subscription, and connect to those publishers that the master knows already."""
        code, _, publishers = self._master.registerSubscriber(self._name, name, kind, rospy.get_node_uri())
        if code != 1:
            return [name]
        self._self.publisherUpdate("/master", name, publishers)
        return []

    def _take_back(self, published: _Pairs, subscribed: _Pairs, services: _Pairs) -> None:
        """Unregister what the node has given up while it was being registered."""
        for name in _gone(published, self._publications()):
            self._master.unregisterPublisher(self._name, name, rospy.get_node_uri())
        for name in _gone(subscribed, self._subscriptions()):
            self._master.unregisterSubscriber(self._name, name, rospy.get_node_uri())
        kept = dict(_services())
        for name, uri in services:
            if name not in kept:
                self._master.unregisterService(self._name, name, uri)

    def _publications(self) -> _Pairs:
        return _pairs(self._self.getPublications(self._name)[2])

    def _subscriptions(self) -> _Pairs:
        return _pairs(self._self.getSubscriptions(self._name)[2])

    def _known_parameters(self) -> Dict[str, Any]:
        """Return the parameters that the node was started with, by their full names."""
        private = rospy.get_param("~", {})
        found = {rospy.resolve_name("~" + name): value for name, value in private.items()}
        simulated = rospy.get_param(SIMULATED, None)
        return found if simulated is None else {**found, SIMULATED: simulated}


class _Impatient(Transport):
    """Does not wait for an answer forever."""

    def make_connection(self, host: Union[str, Tuple[str, Dict[str, str]]]) -> HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = TIMEOUT
        return connection


def _proxy(uri: str) -> Any:
    return ServerProxy(uri, _Impatient())


def _services() -> _Pairs:
    """Return the node's services and their addresses, which no interface of rospy's tells."""
    manager = get_service_manager()
    return [] if manager is None else _pairs(manager.get_services())


def _pairs(found: Any) -> _Pairs:
    return [(name, what) for name, what in found]


def _gone(before: _Pairs, now: _Pairs) -> List[str]:
    kept = {name for name, _ in now}
    return [name for name, _ in before if name not in kept]
