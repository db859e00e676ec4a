"""How an engine behaves."""

from typing import NamedTuple, Optional, Tuple

from ..prolog.machine.resource_limits import Limits


class Settings(NamedTuple):
    """How an engine behaves.

    >>> engine = Engine(settings=Settings(limits=Limits(seconds=0.5), queue=100))
    >>> engine.settings.queue, engine.settings.max_depth
    (100, 1000)

    Attributes:
        limits: what an event, a query or any other call may use with all that it starts: seconds, inferences,
            memory, and output (1 MB by default). Past that its goals end with a resource error; it is one of the
            others that may still be caught once.
        limit_start: whether the goals of a goal file (`Engine.call_goals`) have these limits too.
        watchdog: seconds after which a warning names what is at work; None for never.
        max_depth: longest chain of events derived one from another.
        queue: how many events may wait for the one that is being worked on.
        allow_goals: whether any goal is taken as input, not only events.
        allow_flags: whether goals of others than the program (of services and the dashboard) may change flags.
        allow_foreign: whether programs may load Python modules with ``use_foreign/1``.
        allow_swi: whether programs may have SWI-Prolog load files with ``use_swi/1``.
        folders: where goals of events, queries and services may read files, besides the program's own folders;
            None means anywhere. What a program does while it is loaded (`Engine.load` and its sisters) is free.
        patience: how many seconds a call from another thread waits for one callback, see `Engine`.
        write_folders: where goals may write files, and read them; None means anywhere. Files whose place nobody
            names, as that of persistent events, are written in the first of them.
        max_gap: the value of flag ``max_gap`` as long as the program sets no other: how many seconds apart two
            instants may be for ``datime_interpolate/4``.
        max_file_megabytes: how large a file may be that a program reads or writes.
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
    allow_flags: bool = False
