"""What keeps an engine running: its queue, clock and reports, who holds it up, and mending after interrupts."""

from .clock import Alarm, Clock, StreamClock
from .collector import collect_when_idle, count_records_of, limit_gc_pauses, restore_gc
from .recovery import EngineRecovery
from .reports import COUNTED, Reports
from .runner import Runner
from .runs import ClockRuns
from .skew import Early, Refused, Skew
from .watchdog import Watchdog, at_work, watch

__all__ = [
    "Alarm",
    "at_work",
    "Clock",
    "COUNTED",
    "Early",
    "EngineRecovery",
    "limit_gc_pauses",
    "Refused",
    "Reports",
    "restore_gc",
    "Runner",
    "ClockRuns",
    "collect_when_idle",
    "count_records_of",
    "Skew",
    "StreamClock",
    "Watchdog",
    "watch",
]
