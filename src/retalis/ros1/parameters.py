"""Private parameters of the two nodes: defaults, validation and conversion."""

import sys
from difflib import get_close_matches
from pathlib import Path
from typing import List, NamedTuple, Optional, Tuple, Type

import rospkg
import rospy

from ..dashboard.page_server import DASHBOARD_PORT
from ..engine.engine_settings import Settings
from ..events.knowledge.transform_buffer import DEFAULT_CACHE_SECONDS
from ..events.program.topic_configuration import AUTO, DirectTopics, read_direct, uses_texts
from ..foundation.errors import UsageError, printable, shorten
from ..messages.type_definition import MAX_EMPTY_ELEMENTS
from ..prolog.machine.resource_limits import Limits, Number, validate_limit
from .diagnostics import DEFAULT_HARDWARE_ID

DEFAULT_LIMITS = Limits(seconds=10.0, megabytes=500)
"""Default limits for an event, a service call or a query, including everything that it triggers."""

DEFAULT_WATCHDOG_SECONDS = 1.0
"""Default of ``~watchdog``: seconds after which work in progress is logged."""


PARAMETER_NAMES = (
    "program",
    "direct",
    "embedded",
    "queue",
    "allow_goals",
    "allow_flags",
    "allow_foreign",
    "allow_swi",
    "folders",
    "write_folders",
    "max_file_megabytes",
    "max_depth",
    "max_elements",
    "max_seconds",
    "max_inferences",
    "max_megabytes",
    "max_output_megabytes",
    "max_skew",
    "max_gap",
    "watermark_delay",
    "max_watermark_delay",
    "tf_cache",
    "watchdog",
    "diagnostics",
    "hardware_id",
    "dashboard",
    "dashboard_queries",
    "explain",
    "checkpoint",
)


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

    @property
    def uses_texts(self) -> bool:
        """True if messages pass as text through the interface node.

        Otherwise node retalis itself subscribes to and publishes the topics of ``pub_sub.xml``.
        """
        return not self.embedded and uses_texts(self.direct)


def read_parameters(arguments: Optional[List[str]] = None) -> Parameters:
    """Return the private parameters of this node.

    Raises:
        UsageError: if a value is invalid; the message names the parameter.
    """
    argv = rospy.myargv(sys.argv if arguments is None else arguments)
    _warn_about_unknown_parameters()
    limits = Limits(
        _read_limit("~max_seconds", float, DEFAULT_LIMITS.seconds),
        _read_limit("~max_inferences", int, DEFAULT_LIMITS.inferences),
        _read_limit("~max_megabytes", float, DEFAULT_LIMITS.megabytes),
        _read_limit("~max_output_megabytes", float, DEFAULT_LIMITS.output_megabytes),
    )
    depth = _read_positive_number("~max_depth", int)
    queue = _read_positive_number("~queue", int)
    settings = Settings(
        limits=limits,
        # The limits of an event do not apply to the goals of goalPredicates.txt.
        limit_start=False,
        watchdog=_read_limit("~watchdog", float, DEFAULT_WATCHDOG_SECONDS),
        allow_goals=_read_flag("~allow_goals"),
        allow_flags=_read_flag("~allow_flags"),
        allow_foreign=_read_flag("~allow_foreign"),
        allow_swi=_read_flag("~allow_swi"),
        folders=_read_folders("~folders"),
        write_folders=_read_folders("~write_folders"),
        max_gap=_read_limit("~max_gap", float, None),
        watermark_delay=_read_delay("~watermark_delay"),
        max_watermark_delay=validate_limit(
            "parameter ~max_watermark_delay", rospy.get_param("~max_watermark_delay", 1.0), float
        ),
        tf_cache=_read_positive_number("~tf_cache", float) or DEFAULT_CACHE_SECONDS,
    )
    max_file_megabytes = _read_positive_number("~max_file_megabytes", int)
    if max_file_megabytes is not None:
        settings = settings._replace(max_file_megabytes=max_file_megabytes)
    if depth is not None:
        settings = settings._replace(max_depth=depth)
    if queue is not None:
        settings = settings._replace(queue=queue)
    return Parameters(
        max_empty_elements=_read_positive_number("~max_elements", int) or MAX_EMPTY_ELEMENTS,
        program=_read_program_folder(argv),
        direct=_read_direct_topics(),
        embedded=_read_flag("~embedded"),
        queue=settings.queue,
        settings=settings,
        explain=_read_flag("~explain"),
        max_skew=_read_limit("~max_skew", float, None),
        diagnostics=_read_limit("~diagnostics", float, 1.0),
        hardware_id=_read_text("~hardware_id", DEFAULT_HARDWARE_ID),
        dashboard=_read_port("~dashboard"),
        dashboard_queries=_read_flag("~dashboard_queries"),
        checkpoint=_read_path("~checkpoint"),
    )


def _warn_about_unknown_parameters() -> None:
    for name in rospy.get_param("~", {}):
        # A misspelt parameter would otherwise be ignored without notice.
        if name not in PARAMETER_NAMES:
            matches = get_close_matches(name, PARAMETER_NAMES, 1)
            hint = (
                f"did you mean ~{matches[0]}?"
                if matches
                else f"the parameters are ~{', ~'.join(PARAMETER_NAMES)}"
            )
            rospy.logwarn("there is no parameter ~%s; %s", printable(shorten(name)), hint)


def _read_program_folder(argv: List[str]) -> Path:
    folder = rospy.get_param("~program", "")
    if not isinstance(folder, str):
        raise UsageError(f"parameter ~program: expected the path of a folder, found {folder!r}")
    if folder:
        return _check_folder(Path(folder), "parameter ~program")
    # The argument is the folder of a package, with the program in its folder `application_source`.
    if len(argv) > 1:
        return _check_folder(Path(argv[1]) / "application_source", "the program's folder")
    return _check_folder(Path(_find_package_folder()) / "application_source", "the program's folder")


def _check_folder(folder: Path, description: str) -> Path:
    if folder.is_dir():
        return folder
    problem = "is not a folder" if folder.exists() else "does not exist"
    folder_text = printable(shorten(str(folder)))
    raise UsageError(
        f"{description}: {folder_text} {problem}: give the absolute path of the folder with goalPredicates.txt "
        "and pub_sub.xml, as program:=/path of retalis.launch or as parameter ~program"
    )


def _find_package_folder() -> str:
    try:
        return str(rospkg.RosPack().get_path("retalis"))
    except rospkg.ResourceNotFound:
        raise UsageError(
            "package retalis is not on ROS_PACKAGE_PATH: give its folder as argument, or the program's as ~program"
        ) from None


def _read_direct_topics() -> DirectTopics:
    try:
        return read_direct(rospy.get_param("~direct", AUTO))
    except UsageError as error:
        raise UsageError(f"parameter ~direct: {error.message}") from None


def _read_folders(name: str) -> Tuple[str, ...]:
    """Return the folders that a parameter lists."""
    value = rospy.get_param(name, [])
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise UsageError(f"parameter {name}: expected a list of folders, found {value!r}")
    return tuple(value)


def _read_path(name: str) -> Optional[Path]:
    """Return the absolute path in a parameter; None if it is empty."""
    value = rospy.get_param(name, "")
    if not isinstance(value, str) or "\0" in value:
        raise UsageError(f"parameter {name}: expected the path of a file, found {value!r}")
    return Path(value).expanduser().absolute() if value else None


def _read_text(name: str, default: str) -> str:
    """Return the text of a parameter; ``default`` if it is empty."""
    value = rospy.get_param(name, default)
    if not isinstance(value, str):
        raise UsageError(f"parameter {name}: expected a text, found {value!r}")
    return value or default


def _read_flag(name: str) -> bool:
    value = rospy.get_param(name, False)
    if not isinstance(value, bool):
        raise UsageError(f"parameter {name}: expected true or false, found {value!r}")
    return value


def _read_port(name: str) -> Optional[int]:
    """Return the port in a parameter: the default port for true, None for false."""
    value = rospy.get_param(name, False)
    if isinstance(value, bool):
        return DASHBOARD_PORT if value else None
    if not isinstance(value, int) or not 0 < value < 1 << 16:
        raise UsageError(f"parameter {name}: expected true, false or the number of a port, found {value!r}")
    return value


def _read_limit(name: str, number_type: Type[Number], default: Optional[Number]) -> Optional[Number]:
    """Return the limit in a parameter; None for 0, which means no limit."""
    return (
        validate_limit(
            f"parameter {name} (0 means no limit)", rospy.get_param(name, default or 0), number_type
        )
        or None
    )


def _read_delay(name: str) -> Optional[float]:
    """Return the seconds in a parameter; None for ``auto``, the default."""
    value = rospy.get_param(name, "auto")
    if value == "auto":
        return None
    return validate_limit(f"parameter {name} (auto or a number of seconds)", value, float)


def _read_positive_number(name: str, number_type: Type[Number]) -> Optional[Number]:
    value = rospy.get_param(name, None)
    if value is None:
        return None
    number = validate_limit(f"parameter {name}", value, number_type)
    if number == 0:
        raise UsageError(f"parameter {name}: expected a positive number, found {value!r}")
    return number
