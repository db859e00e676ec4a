"""Settings of an engine: resource limits, sizes and permissions."""

from typing import Callable, NamedTuple, Optional, Tuple

from ..events.knowledge.transform_buffer import DEFAULT_CACHE_SECONDS, TransformBuffer
from ..foundation.displayed_text import quote_shortened
from ..foundation.errors import UsageError
from ..messages.type_definition import QUOTED_STRINGS, STRING_FORMS
from ..prolog.machine.resource_limits import Limits, validate_limit


class Settings(NamedTuple):
    """Limits, sizes and permissions of an engine.

    >>> engine = Engine(settings=Settings(limits=Limits(seconds=0.5), queue=100))
    >>> engine.settings.queue, engine.settings.max_depth
    (100, 1000)

    Attributes:
        limits: resources of an event, query or other call, including all consequences: seconds, inferences, memory,
            and output (1 MB by default). If one is exceeded, the goals end with a resource error. A goal can catch
            one such error; the next one is final.
        limit_start: whether these limits also apply to the goals of a goal file (`Engine.call_goals`).
        watchdog: seconds after which a warning names the work that is in progress; None for no warning.
        max_depth: maximum length of a chain of derived events.
        queue: maximum number of queued events.
        allow_goals: whether input may be any goal, not only events.
        allow_flags: whether goals of services and of the dashboard may change flags.
        allow_foreign: whether programs may load Python modules with ``use_foreign/1``.
        allow_swi: whether programs may make SWI-Prolog load files with ``use_swi/1``.
        folders: folders in which goals of events, queries and services may read files, in addition to the program's
            own folders; None for all. Not applied to a program while it is loaded (`Engine.load` and similar
            methods).
        patience: maximum time in seconds that a call from another thread waits for one callback; see `Engine`.
        write_folders: folders in which goals may write and read files; None for all. Files without a given location,
            such as those of persistent events, are written to the first one.
        max_gap: initial value of flag ``max_gap``: the longest time in seconds between two records for
            ``datime_interpolate/4``.
        watermark_delay: initial value of flag ``watermark_delay``: time in seconds by which alarms wait for late
            events; None for ``auto``, the recent lag of the topics of a pattern.
        max_watermark_delay: initial value of flag ``max_watermark_delay``: upper bound of ``auto`` in seconds.
        max_file_megabytes: maximum size of a file that a program reads or writes.
        tf_cache: history of transforms in seconds.
        counts_uses: whether rules count the outcomes of their conditions and the matches of their branches, and
            clauses their calls, for the coverage of a program by tests. Clauses are then interpreted: slower.
        strings: form of strings in messages of programs without ``pub_sub.xml``: ``"quoted"``, atoms with double
            quotes inside, or ``"plain"``, atoms without them.
        transform_buffer: creates the buffer of transforms, given ``tf_cache``. Nodes use tf2.
    """

    limits: Limits = Limits()
    limit_start: bool = True
    watchdog: Optional[float] = None
    max_depth: int = 1000
    queue: int = 5000
    allow_goals: bool = False
    allow_foreign: bool = False
    allow_swi: bool = False
    folders: Optional[Tuple[str, ...]] = ()
    patience: float = 10.0
    write_folders: Optional[Tuple[str, ...]] = ()
    max_file_megabytes: int = 100
    max_gap: Optional[float] = None
    watermark_delay: Optional[float] = None
    max_watermark_delay: float = 1
    allow_flags: bool = False
    tf_cache: float = DEFAULT_CACHE_SECONDS
    counts_uses: bool = False
    strings: str = QUOTED_STRINGS
    transform_buffer: Callable[[float], TransformBuffer] = TransformBuffer

    def check(self) -> None:
        """Check the numbers and texts.

        >>> Settings(queue=-1).check()
        Traceback (most recent call last):
        ...
        retalis.foundation.errors.UsageError: settings: queue: expected a whole number from 0 to 1e+20, found -1

        Raises:
            UsageError: if a number is negative, not finite or too large, or ``strings`` is another text.
        """
        for name in ("watchdog", "patience", "max_gap", "watermark_delay", "max_watermark_delay", "tf_cache"):
            value = getattr(self, name)
            if value is not None:
                validate_limit(f"settings: {name}", value, float)
        for name in ("max_depth", "queue", "max_file_megabytes"):
            validate_limit(f"settings: {name}", getattr(self, name), int)
        if self.strings not in STRING_FORMS:
            raise UsageError(
                f"settings: strings: expected {' or '.join(STRING_FORMS)}, found {quote_shortened(str(self.strings))}"
            )


CHANGEABLE_SETTINGS = ("limits", "watchdog", "max_gap", "watermark_delay", "max_watermark_delay")
"""Settings that `Engine.change_settings` may change."""
