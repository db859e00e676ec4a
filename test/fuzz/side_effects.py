"""Side effects that no input may have: a second, 50 MB, an open file, a process, executed or imported code."""

import os
import re
import resource
import signal
import sys
import sysconfig
import time
from contextlib import contextmanager
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, Iterator, List, Optional, Tuple, Union

MAX_CPU_SECONDS = 1.0
"""Maximum CPU time of an input."""

MAX_GROWTH_BYTES = 50 << 20
"""Maximum growth of the resident memory during an input, in bytes."""

CHECK_INTERVAL_SECONDS = 0.1
"""Seconds of CPU time between two checks of an input that takes long."""

CODE_MAKERS = ("retalis.foundation.codegen",)
"""Modules that may compile and run source."""

FINDERS = ("retalis.messages.type_registry",)
"""Modules that list the folders of ROS packages to find message types."""

PARSERS = ("ast",)
"""Modules that compile without running."""

ALLOWED_EVENTS = frozenset(
    (
        "builtins.id",
        "array.__new__",
        "object.__getattr__",
        "sys._getframe",
        "gc.get_objects",
        "gc.get_referrers",
        "gc.get_referents",
        "signal.setitimer",
    )
)

_SOURCES = Path(__file__).resolve().parents[2] / "src"
_READABLE = tuple(
    f"{folder}/" for folder in {str(_SOURCES), sysconfig.get_path("stdlib"), sysconfig.get_path("platstdlib")}
) + ("/proc/self/statm",)
_DEFINITION = re.compile(r"(/[\w.+-]+)*/msg/\w+\.msg", re.ASCII)
_PAGE = os.sysconf("SC_PAGE_SIZE")


class ForbiddenActError(RuntimeError):
    """Raised instead of a forbidden act."""


class UsageExceeded(BaseException):
    """An input exceeds a limit of time or memory. No handler of errors catches it."""


class FindingError(Exception):
    """A finding: an error or a forbidden side effect of an input.

    Attributes:
        category: exception, action, time, growth, ...
        detail: description of this finding.
        place: the place in the package; inputs with the same place are one finding.
    """

    def __init__(self, category: str, detail: str, place: str = "") -> None:
        super().__init__(category, detail, place)
        self.category = category
        self.detail = detail
        self.place = place


class Watch:
    """Check of the side effects of one input at a time.

    Args:
        scratch: folder from which inputs may read.
        reads: whether inputs may read any file, because programs may name any.
        seconds: maximum CPU time of an input.
        growth: maximum growth of the resident memory during an input, in bytes.
    """

    def __init__(
        self,
        scratch: Union[str, Path],
        reads: bool = False,
        seconds: float = MAX_CPU_SECONDS,
        growth: int = MAX_GROWTH_BYTES,
    ) -> None:
        self._scratch = str(scratch)
        self._reads = reads
        self._seconds = seconds
        self._growth = growth
        self._armed = False
        self._start = 0.0
        self._before = self._peak = 0
        self._statm = os.open("/proc/self/statm", os.O_RDONLY)
        self.mark = ""
        self.actions: List[Tuple[str, str]] = []
        """Forbidden acts of the input, each with its place."""
        self.slowest = 0.0

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Check inputs within the context; an audit hook, which then does nothing, remains in the process."""
        sys.addaudithook(self._audit)
        handler = signal.signal(signal.SIGPROF, self._check_usage)
        timer = signal.getitimer(signal.ITIMER_PROF)
        self.start_timer()
        try:
            yield
        finally:
            # First the timer: the default handler of its signal ends the process.
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.signal(signal.SIGPROF, handler)
            signal.setitimer(signal.ITIMER_PROF, *timer)

    def start_timer(self) -> None:
        """Check the input periodically; a forked process needs its own timer."""
        signal.setitimer(signal.ITIMER_PROF, CHECK_INTERVAL_SECONDS, CHECK_INTERVAL_SECONDS)

    @contextmanager
    def input(self) -> Iterator[None]:
        """Check the processing of an input.

        Raises:
            FindingError: if it has a forbidden side effect.
        """
        del self.actions[:]
        self._before = self.resident()
        self._peak = _peak()
        self._start = time.process_time()
        self._armed = True
        usage_error = error_of_input = None
        try:
            yield
        except UsageExceeded as error:
            usage_error = error
        except Exception as error:  # a forbidden act has precedence over its consequences
            error_of_input = error
        finally:
            self._armed = False
        cpu_seconds = time.process_time() - self._start
        self.slowest = max(self.slowest, cpu_seconds)
        if self.actions:
            raise FindingError("action", *self.actions[0])
        if usage_error is not None:
            raise FindingError(*usage_error.args)
        if error_of_input is not None:
            raise error_of_input
        if cpu_seconds > self._seconds:
            raise FindingError("time", f"{cpu_seconds:.1f} s", "in one step")
        peak = _peak()
        if peak > self._peak and peak - self._before > self._growth:
            raise FindingError("growth", f"{(peak - self._before) >> 20} MB", "in one step")

    def resident(self) -> int:
        """Return the size of the resident memory in bytes."""
        return int(os.pread(self._statm, 100, 0).split()[1]) * _PAGE

    def _check_usage(self, number: int, frame: Optional[FrameType]) -> None:
        if not self._armed:
            return
        cpu_seconds = time.process_time() - self._start
        growth = self.resident() - self._before
        if cpu_seconds > self._seconds:
            self._armed = False
            self.slowest = max(self.slowest, cpu_seconds)
            raise UsageExceeded("time", f"{cpu_seconds:.1f} s", place(frame))
        if growth > self._growth:
            self._armed = False
            raise UsageExceeded("growth", f"{growth >> 20} MB", place(frame))

    def _audit(self, event: str, arguments: Tuple[Any, ...]) -> None:
        if not self._armed or event in ALLOWED_EVENTS:
            return
        if event in ("exec", "compile"):
            allowed = self._may_run(event, arguments)
        elif event in ("sqlite3.connect", "sqlite3.connect/handle"):
            allowed = event.endswith("handle") or self._may_connect(arguments[0])
        elif event == "open":
            allowed = self._may_open(*arguments[:3])
        else:
            allowed = (
                event in ("os.scandir", "os.listdir")
                and sys._getframe(1).f_globals.get("__name__") in FINDERS
            )
        if not allowed:
            self.actions.append((f"{event} {_brief(arguments)}", place(sys._getframe(1))))
            raise ForbiddenActError(f"{event} {_brief(arguments)}")

    def _may_run(self, event: str, arguments: Tuple[Any, ...]) -> bool:
        module = sys._getframe(2).f_globals.get("__name__", "")
        if self.mark and event == "compile" and self.mark in str(arguments[0]):
            return False
        return module in CODE_MAKERS or (event == "compile" and module in PARSERS)

    def _may_connect(self, name: Union[str, bytes]) -> bool:
        """Return whether a database may be opened: one in memory, or a file of the input that is only read."""
        name = os.fsdecode(name)  # Python 3.8 passes bytes
        own = name.startswith(f"file://{self._scratch}/")
        return name == ":memory:" or (own and name.partition("?")[2].split("&")[0] == "mode=ro")

    def _may_open(self, path: object, mode: Optional[str], flags: Optional[int]) -> bool:
        if (mode and set(mode) & set("wax+")) or (flags or 0) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
            return False
        name = os.fsdecode(path) if isinstance(path, (bytes, os.PathLike)) else str(path)
        name = os.path.normpath(os.path.join(self._scratch, name))
        return (
            self._reads
            or name.startswith((f"{self._scratch}/", *_READABLE))
            or _DEFINITION.fullmatch(name) is not None
        )


def place(frame: Optional[FrameType]) -> str:
    """Return the innermost place in the package of a frame or a traceback's frames."""
    while frame is not None:
        location = _place(frame.f_code.co_filename, frame.f_lineno, frame.f_code.co_name)
        if location:
            return location
        frame = frame.f_back
    return "outside the package"


def raised_at(trace: Optional[TracebackType]) -> str:
    """Return the innermost place in the package at which an exception was raised."""
    location = ""
    while trace is not None:
        code = trace.tb_frame.f_code
        location = _place(code.co_filename, trace.tb_lineno, code.co_name) or location
        trace = trace.tb_next
    return location or "outside the package"


def _place(path: str, line: Optional[int], function: str) -> str:
    if path.startswith(f"{_SOURCES}/"):
        return f"{path[len(str(_SOURCES)) + 1 :]}:{line or 0} {function}"
    return ""


def _peak() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10


def _brief(arguments: Tuple[Any, ...]) -> str:
    return repr(arguments)[:300]
