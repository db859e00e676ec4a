"""Parameters of a node: defaults, validation and conversion."""

import logging
from pathlib import Path
from typing import Any, Callable, Mapping, NamedTuple, Optional, Tuple, Type

from ..dashboard.page_server import DASHBOARD_PORT
from ..engine.engine_settings import Settings
from ..events.knowledge.transform_buffer import DEFAULT_CACHE_SECONDS
from ..events.program.topic_configuration import AUTO, DirectTopics, read_direct, uses_texts
from ..forwarding.forwarding_options import (
    DEFAULT_QUEUE_MEGABYTES,
    ForwardingOptions,
    is_robot_name,
    read_broker,
)
from ..foundation.displayed_text import printable, shorten
from ..foundation.errors import UsageError
from ..foundation.ros_name_checks import topic_fault
from ..foundation.similar_names import closest_name
from ..messages.type_definition import MAX_EMPTY_ELEMENTS
from ..prolog.machine.resource_limits import Limits, Number, validate_limit
from .diagnostics import DEFAULT_HARDWARE_ID

log = logging.getLogger("retalis")

DEFAULT_LIMITS = Limits(seconds=10.0, megabytes=500)
"""Default limits for an event, a service call or a query, including everything that it triggers."""

DEFAULT_WATCHDOG_SECONDS = 1.0
"""Default of ``~watchdog``: seconds after which work in progress is logged."""


PARAMETER_DESCRIPTIONS = {
    "program": "Folder of the program, an absolute path",
    "direct": "Topics that the node subscribes to itself: auto, true, false, or a list of topics and types",
    "embedded": "Whether this node offers all services, and no message passes as text",
    "queue": "Maximum length of each queue, in events or messages",
    "allow_goals": "Whether any goal that is received on retalisInputEvents is called",
    "allow_flags": "Whether goals of services and of the dashboard may change flags",
    "allow_foreign": "Whether programs may load Python modules",
    "allow_swi": "Whether programs may load files into SWI-Prolog",
    "allow_services": "Full names of the services that goals may call with ros_service; * stands for any text",
    "folders": "Folders in which goals of events, queries and services may read files, beside the program's folder",
    "write_folders": "Folders in which these goals may write and read files; the first has the persistent events",
    "max_file_megabytes": "Largest file that the program may read or write, in megabytes",
    "max_depth": "Maximum length of a chain of derived events",
    "max_elements": "Maximum number of array elements without bytes in a message",
    "max_seconds": "Time limit of an event, a query or a service call, in seconds; 0: no limit",
    "max_inferences": "Maximum number of inferences of an event, a query or a service call; 0: no limit",
    "max_megabytes": "Maximum growth of the process during such a call, in megabytes; 0: no limit",
    "max_output_megabytes": "Maximum text that the goals of such a call write, in megabytes; 0: no limit",
    "max_skew": "Maximum difference between a stamp and the expected time, in seconds; 0: no limit",
    "max_gap": "Maximum gap between records over which poses are interpolated, in seconds; 0: no limit",
    "watermark_delay": "Time to wait for late events, in seconds, or auto",
    "max_watermark_delay": "Upper bound of the automatic delay, in seconds",
    "tf_cache": "History of the transforms of each frame, in seconds",
    "watchdog": "Seconds after which a running event, query or call is logged; 0: never",
    "diagnostics": "Interval of messages on /diagnostics, in seconds; 0: no messages",
    "hardware_id": "Hardware id on /diagnostics",
    "dashboard": "Web page on the loopback address: true, false, or the number of a port",
    "dashboard_queries": "Whether users of the page may call goals",
    "explain": "Whether the origin of events is recorded for the service ~explain",
    "checkpoint": "File to which the node saves its state, and from which it continues after a restart",
    "forward": "Broker of MQTT to which outputs are sent: mqtt://HOST, mqtts://USER@HOST:PORT",
    "forward_topics": "Topics whose outputs are sent; * stands for any text",
    "forward_robot": "Name of the robot in these events",
    "forward_queue": "File in which these events wait for the network",
    "forward_megabytes": "Maximum size of this file, in megabytes; when it is full, the oldest events are dropped",
    "forward_password": "File with the password for the broker",
    "forward_ca": "File with the certificates of trusted authorities, in place of those of the system",
}
"""Names of the parameters, with a description for tools that list them."""

_LOADED = "the program is loaded at the start"
_PERMISSION = "permissions are those of the start"
_SIZE = "buffers have the size of the start"

FIXED_PARAMETERS = {
    "program": _LOADED,
    "direct": "the topics are opened at the start",
    "embedded": "the services are offered at the start",
    "queue": _SIZE,
    "allow_goals": _PERMISSION,
    "allow_flags": _PERMISSION,
    "allow_foreign": _PERMISSION,
    "allow_swi": _PERMISSION,
    "allow_services": _PERMISSION,
    "folders": _PERMISSION,
    "write_folders": _PERMISSION,
    "max_file_megabytes": _PERMISSION,
    "max_depth": "rules are compiled for it",
    "max_elements": "readers of messages are compiled for it",
    "tf_cache": _SIZE,
    "dashboard": "its port is opened at the start",
    "dashboard_queries": _PERMISSION,
    "explain": "origins are recorded from the start",
    "checkpoint": "the state is read from it at the start",
    **dict.fromkeys(
        (
            "forward",
            "forward_topics",
            "forward_robot",
            "forward_queue",
            "forward_megabytes",
            "forward_password",
            "forward_ca",
        ),
        "the queue is opened at the start",
    ),
}
"""Parameters that are fixed while the node runs, with the reason; the others can be changed on ROS 2."""


class AdjustableParameters(NamedTuple):
    """The parameters that can be changed while the node runs; see `Parameters` and `Settings`."""

    limits: Limits
    watchdog: Optional[float]
    max_gap: Optional[float]
    watermark_delay: Optional[float]
    max_watermark_delay: float
    max_skew: Optional[float]
    diagnostics: Optional[float]
    hardware_id: str


class Parameters(NamedTuple):
    """The parameters of a node.

    Attributes:
        program: folder with pub_sub.xml and goalPredicates.txt.
        direct: ``auto``, True, False, or the topics that node retalis subscribes to itself; see
            `uses_texts`.
        embedded: whether the ROS interface runs inside node retalis.
        queue: maximum length of each queue, in events or messages.
        settings: settings of the engine.
        max_empty_elements: limit for the elements of a message that occupy no bytes.
        explain: whether the causes of events are recorded.
        max_skew: largest difference in seconds between a stamp and the expected time of its topic and frame; None
            for no limit.
        diagnostics: seconds between two messages on ``/diagnostics``; None disables them.
        hardware_id: hardware id of the node's statuses on ``/diagnostics``.
        dashboard: port of the dashboard; None for no dashboard.
        dashboard_queries: whether users of the dashboard may ask goals.
        checkpoint: file for the engine's state; None if the state is not saved.
        allow_services: full names of the services that goals may call, in which ``*`` stands for any text.
        forwarding: outputs that are sent to a broker; None for none.
    """

    program: Path
    direct: DirectTopics
    embedded: bool
    queue: int
    settings: Settings
    max_empty_elements: int = MAX_EMPTY_ELEMENTS
    explain: bool = False
    max_skew: Optional[float] = None
    diagnostics: Optional[float] = 1.0
    hardware_id: str = DEFAULT_HARDWARE_ID
    dashboard: Optional[int] = None
    dashboard_queries: bool = False
    checkpoint: Optional[Path] = None
    allow_services: Tuple[str, ...] = ()
    forwarding: Optional[ForwardingOptions] = None

    @property
    def uses_texts(self) -> bool:
        """True if messages pass as text through the interface node.

        Otherwise node retalis itself subscribes to and publishes the topics of ``pub_sub.xml``.
        """
        return not self.embedded and uses_texts(self.direct)

    def adjust(self, adjusted: AdjustableParameters) -> "Parameters":
        """Return the parameters with other values of those that can be changed."""
        settings = self.settings._replace(
            limits=adjusted.limits,
            watchdog=adjusted.watchdog,
            max_gap=adjusted.max_gap,
            watermark_delay=adjusted.watermark_delay,
            max_watermark_delay=adjusted.max_watermark_delay,
        )
        return self._replace(
            settings=settings,
            max_skew=adjusted.max_skew,
            diagnostics=adjusted.diagnostics,
            hardware_id=adjusted.hardware_id,
        )


def read_parameters(values: Mapping[str, Any], find_program: Callable[[], Path]) -> Parameters:
    """Return the parameters of a node.

    Raises:
        UsageError: if a value is invalid; the message names the parameter.
    """
    _warn_about_unknown_parameters(values)
    given = _GivenParameters(values)
    depth = given.positive_number("max_depth", int)
    queue = given.positive_number("queue", int)
    settings = Settings(
        # The limits of an event do not apply to the goals of goalPredicates.txt.
        limit_start=False,
        allow_goals=given.flag("allow_goals"),
        allow_flags=given.flag("allow_flags"),
        allow_foreign=given.flag("allow_foreign"),
        allow_swi=given.flag("allow_swi"),
        folders=given.folders("folders"),
        write_folders=given.folders("write_folders"),
        tf_cache=given.positive_number("tf_cache", float) or DEFAULT_CACHE_SECONDS,
    )
    max_file_megabytes = given.positive_number("max_file_megabytes", int)
    if max_file_megabytes is not None:
        settings = settings._replace(max_file_megabytes=max_file_megabytes)
    if depth is not None:
        settings = settings._replace(max_depth=depth)
    if queue is not None:
        settings = settings._replace(queue=queue)
    parameters = Parameters(
        max_empty_elements=given.positive_number("max_elements", int) or MAX_EMPTY_ELEMENTS,
        program=_read_program_folder(given, find_program),
        direct=_read_direct_topics(values),
        embedded=given.flag("embedded"),
        queue=settings.queue,
        settings=settings,
        explain=given.flag("explain"),
        dashboard=given.port("dashboard"),
        dashboard_queries=given.flag("dashboard_queries"),
        checkpoint=given.path("checkpoint"),
        allow_services=given.service_patterns("allow_services"),
        forwarding=_read_forwarding(given),
    )
    return parameters.adjust(read_adjustable_parameters(values))


def read_adjustable_parameters(values: Mapping[str, Any]) -> AdjustableParameters:
    """Return the parameters that can be changed while the node runs; other ones are ignored.

    Raises:
        UsageError: if a value is invalid; the message names the parameter.
    """
    given = _GivenParameters(values)
    return AdjustableParameters(
        limits=Limits(
            given.limit("max_seconds", float, DEFAULT_LIMITS.seconds),
            given.limit("max_inferences", int, DEFAULT_LIMITS.inferences),
            given.limit("max_megabytes", float, DEFAULT_LIMITS.megabytes),
            given.limit("max_output_megabytes", float, DEFAULT_LIMITS.output_megabytes),
        ),
        watchdog=given.limit("watchdog", float, DEFAULT_WATCHDOG_SECONDS),
        max_gap=given.limit("max_gap", float, None),
        watermark_delay=given.delay("watermark_delay"),
        max_watermark_delay=validate_limit(
            "parameter ~max_watermark_delay", given.get("max_watermark_delay", 1.0), float
        ),
        max_skew=given.limit("max_skew", float, None),
        diagnostics=given.limit("diagnostics", float, 1.0),
        hardware_id=given.text("hardware_id", DEFAULT_HARDWARE_ID),
    )


def check_adjustable(name: str) -> None:
    """Check that a parameter can be changed while the node runs.

    Raises:
        UsageError: if it is fixed, or there is none of this name.
    """
    if name not in PARAMETER_DESCRIPTIONS:
        raise UsageError(_describe_unknown_parameter(name))
    if name in FIXED_PARAMETERS:
        raise UsageError(
            f"parameter ~{name}: it cannot be changed, because {FIXED_PARAMETERS[name]}: start the node with it"
        )


def _describe_unknown_parameter(name: str) -> str:
    closest = closest_name(name, PARAMETER_DESCRIPTIONS)
    hint = (
        f"did you mean ~{closest}?"
        if closest
        else f"the parameters are ~{', ~'.join(PARAMETER_DESCRIPTIONS)}"
    )
    return f"there is no parameter ~{printable(shorten(name))}; {hint}"


def _warn_about_unknown_parameters(values: Mapping[str, Any]) -> None:
    for name in values:
        # A misspelt parameter would otherwise be ignored without notice; others are those that goals read.
        if name not in PARAMETER_DESCRIPTIONS and closest_name(name, PARAMETER_DESCRIPTIONS):
            log.warning("%s", _describe_unknown_parameter(name))


def _read_program_folder(given: "_GivenParameters", find_program: Callable[[], Path]) -> Path:
    folder = given.get("program", "")
    if not isinstance(folder, str):
        raise UsageError(f"parameter ~program: expected the path of a folder, found {folder!r}")
    if folder:
        return _check_folder(Path(folder), "parameter ~program")
    return _check_folder(find_program(), "the program's folder")


def _check_folder(folder: Path, description: str) -> Path:
    if folder.is_dir():
        return folder
    problem = "is not a folder" if folder.exists() else "does not exist"
    folder_text = printable(shorten(str(folder)))
    raise UsageError(
        f"{description}: {folder_text} {problem}: give the absolute path of the folder with goalPredicates.txt "
        "and pub_sub.xml, as program:=/path of retalis.launch or as parameter ~program"
    )


def _read_direct_topics(values: Mapping[str, Any]) -> DirectTopics:
    try:
        return read_direct(values.get("direct", AUTO))
    except UsageError as error:
        raise UsageError(f"parameter ~direct: {error.message}") from None


def _read_forwarding(given: "_GivenParameters") -> Optional[ForwardingOptions]:
    """Return the options of forwarding; None if there is no broker.

    Raises:
        UsageError: if one is invalid or missing.
    """
    url = given.text("forward", "")
    if not url:
        for name in ("forward_topics", "forward_robot", "forward_queue"):
            if given.get(name, None):
                raise UsageError(
                    f"parameter ~{name}: nothing is forwarded without ~forward, the address of a broker"
                )
        return None
    try:
        broker = read_broker(url)
    except UsageError as error:
        raise UsageError(f"parameter ~forward: {error.message}") from None
    password, queue, ca_file = map(given.path, ("forward_password", "forward_queue", "forward_ca"))
    # Both would be ignored, the second one with events sent in clear.
    if password is not None and broker.user is None:
        raise UsageError("parameter ~forward_password: ~forward has no user: expected mqtt://USER@HOST")
    if ca_file is not None and not broker.uses_tls:
        raise UsageError("parameter ~forward_ca: ~forward has no TLS: expected mqtts://HOST")
    robot = given.text("forward_robot", "")
    if not is_robot_name(robot):
        raise UsageError(
            f"parameter ~forward_robot: expected the name of the robot, without spaces, '/', '+' and '#', "
            f"found {robot!r}"
        )
    if queue is None:
        raise UsageError("parameter ~forward_queue: expected the path of a file, found ''")
    return ForwardingOptions(
        broker=broker._replace(
            password=None if password is None else _read_password(password), ca_file=ca_file
        ),
        robot=robot,
        topics=given.topic_patterns("forward_topics"),
        queue=queue,
        max_bytes=1_000_000 * (given.positive_number("forward_megabytes", int) or DEFAULT_QUEUE_MEGABYTES),
    )


def _read_password(path: Path) -> str:
    """Return the first line of a file.

    Raises:
        UsageError: if it cannot be read.
    """
    try:
        with path.open(encoding="utf-8") as file:
            return file.readline(1000).rstrip("\r\n")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"parameter ~forward_password: {path} cannot be read: {error}") from None


class _GivenParameters:
    """Parameters by name, with a method for each kind of value."""

    def __init__(self, values: Mapping[str, Any]):
        self._values = values

    def get(self, name: str, default: Any) -> Any:
        """Return the value of a parameter."""
        return self._values.get(name, default)

    def _texts(self, name: str, description: str, needs_item: bool = False) -> Tuple[str, ...]:
        value = self.get(name, [])
        is_list = isinstance(value, list) and all(isinstance(item, str) for item in value)
        if not is_list or (needs_item and not value):
            raise UsageError(f"parameter ~{name}: expected a list of {description}, found {value!r}")
        return tuple(value)

    def folders(self, name: str) -> Tuple[str, ...]:
        """Return the folders that a parameter lists."""
        return self._texts(name, "folders")

    def service_patterns(self, name: str) -> Tuple[str, ...]:
        """Return the names of services that a parameter lists."""
        patterns = self._texts(name, "services")
        for item in patterns:
            if item[:1] not in ("/", "*") or topic_fault(item.replace("*", "a")) is not None:
                raise UsageError(
                    f"parameter ~{name}: expected full names of services, as /arm/* or /dock, found {item!r}"
                )
        return patterns

    def topic_patterns(self, name: str) -> Tuple[str, ...]:
        """Return the names of topics that a parameter lists, at least one."""
        patterns = self._texts(name, "topics", needs_item=True)
        for item in patterns:
            # A relative name is resolved in the namespace of the node, which a pattern cannot be.
            is_relative_pattern = "*" in item and item[:1] not in ("/", "*")
            if is_relative_pattern or topic_fault(item.replace("*", "a")) is not None:
                raise UsageError(
                    f"parameter ~{name}: expected names of topics, as alarm or /arm/*, found {item!r}"
                )
        return patterns

    def path(self, name: str) -> Optional[Path]:
        """Return the absolute path in a parameter; None if it is empty."""
        value = self.get(name, "")
        if not isinstance(value, str) or "\0" in value:
            raise UsageError(f"parameter ~{name}: expected the path of a file, found {value!r}")
        return Path(value).expanduser().absolute() if value else None

    def text(self, name: str, default: str) -> str:
        """Return the text of a parameter; ``default`` if it is empty."""
        value = self.get(name, default)
        if not isinstance(value, str):
            raise UsageError(f"parameter ~{name}: expected a text, found {value!r}")
        return value or default

    def flag(self, name: str) -> bool:
        """Return whether a parameter is true; false by default."""
        value = self.get(name, False)
        if not isinstance(value, bool):
            raise UsageError(f"parameter ~{name}: expected true or false, found {value!r}")
        return value

    def port(self, name: str) -> Optional[int]:
        """Return the port in a parameter: the default port for true, None for false."""
        value = self.get(name, False)
        if isinstance(value, bool):
            return DASHBOARD_PORT if value else None
        if not isinstance(value, int) or not 0 < value < 1 << 16:
            raise UsageError(
                f"parameter ~{name}: expected true, false or the number of a port, found {value!r}"
            )
        return value

    def limit(self, name: str, number_type: Type[Number], default: Optional[Number]) -> Optional[Number]:
        """Return the limit in a parameter; None for 0, which means no limit."""
        value = self.get(name, default or 0)
        return validate_limit(f"parameter ~{name} (0 means no limit)", value, number_type) or None

    def delay(self, name: str) -> Optional[float]:
        """Return the seconds in a parameter; None for ``auto``, the default."""
        value = self.get(name, "auto")
        if value == "auto":
            return None
        return validate_limit(f"parameter ~{name} (auto or a number of seconds)", value, float)

    def positive_number(self, name: str, number_type: Type[Number]) -> Optional[Number]:
        """Return the number in a parameter; None by default."""
        value = self.get(name, None)
        if value is None:
            return None
        number = validate_limit(f"parameter ~{name}", value, number_type)
        if number == 0:
            raise UsageError(f"parameter ~{name}: expected a positive number, found {value!r}")
        return number
