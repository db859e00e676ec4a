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
from typing import Any, Iterator

SECONDS = 1.0
"""CPU time of one input."""

GROWTH = 50 << 20
"""Growth of the resident memory while one input is worked on, in bytes."""

LOOKS = 0.1
"""Seconds of CPU time between two looks at an input that takes long."""

CODE_MAKERS = ("retalis.foundation.codegen",)
"""The modules that may compile and run source."""

FINDERS = ("retalis.messages.type_registry",)
"""The modules that look into the folders of ROS's packages for the names of message types."""

PARSERS = ("ast",)
"""Modules that compile without running."""

HARMLESS = frozenset(
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
    """Raised in the place of what an input may not do."""


class Late(BaseException):
    """An input has taken too long or too much; no handler in between may take it for an error of a goal."""


class FindingError(Exception):
    """Something that an input did, and that counts.

    Attributes:
        what: exception, action, time, growth, ...
        where: the place in the package, so that many inputs with one cause are one finding.
    """

    def __init__(self, what: Any, detail: Any, where: str = "") -> None:
        super().__init__(what, detail, where)
        self.what = what
        self.detail = detail
        self.where = where


class Watch:
    """Watches the work on one input at a time.

    Args:
        scratch: the folder that inputs may read from.
        reads: whether files anywhere may be read (programs that are loaded may name any).
        marked: whether inputs have a mark that must not come up in a source (`mark`).
        seconds: CPU time that one input may take.
        growth: bytes by which the resident memory may grow while one input is worked on.
    """

    def __init__(
        self, scratch: Any, reads: bool = False, seconds: Any = SECONDS, growth: Any = GROWTH
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
        self.actions = []
        self.slowest = 0.0

    def install(self) -> None:
        """Begin to watch; an audit hook stays for the life of the process."""
        sys.addaudithook(self._audit)
        signal.signal(signal.SIGPROF, self._look)
        self.start_timer()

    def start_timer(self) -> None:
        """Check the input periodically; a forked process needs its own timer."""
        signal.setitimer(signal.ITIMER_PROF, LOOKS, LOOKS)

    @contextmanager
    def input(self) -> Iterator[None]:
        """Watch the work on an input.

        Raises:
            FindingError: where it does what it must not.
        """
        del self.actions[:]
        self._before = self.resident()
        self._peak = _peak()
        self._start = time.process_time()
        self._armed = True
        late = raised = None
        try:
            yield
        except Late as error:
            late = error
        except Exception as error:  # what was forbidden goes before what came of it
            raised = error
        finally:
            self._armed = False
        taken = time.process_time() - self._start
        self.slowest = max(self.slowest, taken)
        if self.actions:
            raise FindingError("action", *self.actions[0])
        if late is not None:
            raise FindingError(*late.args)
        if raised is not None:
            raise raised
        if taken > self._seconds:
            raise FindingError("time", f"{taken:.1f} s", "in one step")
        peak = _peak()
        if peak > self._peak and peak - self._before > self._growth:
            raise FindingError("growth", f"{(peak - self._before) >> 20} MB", "in one step")

    def resident(self) -> Any:
        """Return the bytes in memory now."""
        return int(os.pread(self._statm, 100, 0).split()[1]) * _PAGE

    def _look(self, number: Any, frame: Any) -> None:
        if not self._armed:
            return
        taken = time.process_time() - self._start
        grown = self.resident() - self._before
        if taken > self._seconds:
            self._armed = False
            self.slowest = max(self.slowest, taken)
            raise Late("time", f"{taken:.1f} s", place(frame))
        if grown > self._growth:
            self._armed = False
            raise Late("growth", f"{grown >> 20} MB", place(frame))

    def _audit(self, event: Any, arguments: Any) -> None:
        if not self._armed or event in HARMLESS:
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

    def _may_run(self, event: Any, arguments: Any) -> Any:
        module = sys._getframe(2).f_globals.get("__name__", "")
        if self.mark and event == "compile" and self.mark in str(arguments[0]):
            return False
        return module in CODE_MAKERS or (event == "compile" and module in PARSERS)

    def _may_connect(self, name: Any) -> Any:
        """Tell whether a database may be opened: one in memory, or a file of the input's own that is only read."""
        name = os.fsdecode(name)  # Python 3.8 tells it as bytes
        own = name.startswith(f"file://{self._scratch}/")
        return name == ":memory:" or (own and name.partition("?")[2].split("&")[0] == "mode=ro")

    def _may_open(self, path: Any, mode: Any, flags: Any) -> Any:
        if (mode and set(mode) & set("wax+")) or (flags or 0) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
            return False
        path = os.fsdecode(path) if isinstance(path, (bytes, os.PathLike)) else str(path)
        path = os.path.normpath(os.path.join(self._scratch, path))
        return (
            self._reads
            or path.startswith((f"{self._scratch}/", *_READABLE))
            or _DEFINITION.fullmatch(path) is not None
        )


def place(frame: Any) -> Any:
    """Return the innermost place in the package of a frame or a traceback's frames."""
    while frame is not None:
        found = _place(frame.f_code.co_filename, frame.f_lineno, frame.f_code.co_name)
        if found:
            return found
        frame = frame.f_back
    return "outside the package"


def raised_at(trace: Any) -> Any:
    """Return the innermost place in the package at which an exception was raised."""
    found = ""
    while trace is not None:
        code = trace.tb_frame.f_code
        found = _place(code.co_filename, trace.tb_lineno, code.co_name) or found
        trace = trace.tb_next
    return found or "outside the package"


def _place(path: Any, line: Any, function: Any) -> str:
    if path.startswith(f"{_SOURCES}/"):
        return f"{path[len(str(_SOURCES)) + 1 :]}:{line or 0} {function}"
    return ""


def _peak() -> Any:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10


def _brief(arguments: Any) -> Any:
    return repr(arguments)[:300]
