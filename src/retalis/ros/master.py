"""Waiting for the master."""

import sys
import time
from http.client import HTTPConnection, HTTPException
from typing import Any, Dict, Tuple, Union
from xmlrpc.client import Error, ServerProxy, Transport

import rosgraph

PERIOD = 1.0
"""Seconds from one look to the next."""

TIMEOUT = 5.0
"""Seconds after which an answer is not waited for any longer."""


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


class _Impatient(Transport):
    """Does not wait for an answer forever."""

    def make_connection(self, host: Union[str, Tuple[str, Dict[str, str]]]) -> HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = TIMEOUT
        return connection


def _proxy(uri: str) -> Any:
    return ServerProxy(uri, _Impatient())
