"""Calls of services through rospy's protocol, with serialized requests and responses.

`rospy.ServiceProxy` waits for the response without a limit. Here the connection of a call is closed when the call
ends otherwise, which ends the wait. Each call has a thread, because it waits for the master, the server and the
response.
"""

from typing import Type

import rosgraph
import rospy
from rospy.exceptions import TransportException
from rospy.impl.tcpros_base import TCPROSTransport
from rospy.impl.tcpros_service import TCPROSServiceClient

from ..engine.service_calls import ServiceCall
from ..foundation.displayed_text import shorten
from ..messages.type_definition import service_checksum
from .connection_writer import serialized_class
from .topic_names import MASTER_ERRORS

_SOCKET_MARGIN_SECONDS = 1.0
"""Seconds by which the timeout of the socket exceeds the limit of the call, which reports it."""


_NO_PROVIDER = "no provider"
"""Error of the master for a service that no node offers."""


def call_service(name: str, call: ServiceCall) -> None:
    """Call a service and wait for its response, or for the end of the call; see `Transport.call_service`."""
    try:
        uri = rosgraph.Master(rospy.get_name()).lookupService(name)
        address, port = rospy.core.parse_rosrpc_uri(uri)
    except rosgraph.MasterError as error:
        if _NO_PROVIDER in str(error):
            call.fail("no node offers it")
        else:
            call.fail(f"the master reports an error: {shorten(str(error))}")
        return
    except (*MASTER_ERRORS, rospy.exceptions.ROSException) as error:
        call.fail(f"the master does not answer: {shorten(str(error))}")
        return
    # The master may have answered after the time limit: the program no longer expects the service to act.
    if call.is_ended:
        return
    connection = TCPROSTransport(TCPROSServiceClient(name, _make_service_class(call)), name)
    call.on_end(connection.close)
    try:
        connection.connect(address, port, uri, call.request.seconds + _SOCKET_MARGIN_SECONDS)
        request = serialized_class(call.request.request)()
        request._buff = call.request.data
        if call.is_ended:
            # `on_end` may have closed it before it was open.
            connection.close()
            return
        connection.send_message(request, 1)
        call.reply(connection.receive_once()[0]._buff)
    except rospy.ServiceException as error:
        _, _, text = str(error).partition("responded with an error: ")
        call.fail(f"its node reports an error: {shorten(_decode(text or str(error)))}")
    except TransportException as error:
        if "md5sum" in str(error):
            call.fail(f"it has another type than {call.request.type}")
        else:
            call.fail(f"the connection to its node ends: {shorten(str(error))}")
    except (OSError, AttributeError) as error:
        # `close` of a call that has ended sets the attributes of the connection to None.
        call.fail(f"the connection to its node ends: {shorten(str(error))}")


def _decode(text: str) -> str:
    """Return the text of an error, which rospy shows as bytes."""
    return text[2:-1] if text[:2] in ("b'", 'b"') else text


def _make_service_class(call: ServiceCall) -> Type[object]:
    """Return a class with which rospy passes serialized requests and responses of a service."""
    request_class, response_class = map(serialized_class, (call.request.request, call.request.response))
    members = {
        "_type": call.request.type,
        "_md5sum": service_checksum(call.request.request, call.request.response),
        "_request_class": request_class,
        "_response_class": response_class,
    }
    return type("SerializedService", (), members)
