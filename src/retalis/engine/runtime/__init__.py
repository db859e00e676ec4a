"""What keeps an engine running: its queue, clock and reports, who holds it up, and mending after interrupts."""

from .clock import Alarm, Clock, StreamClock
from .collector import relax, tighten
from .recovery import EngineRecovery
from .reports import Reports
from .runner import Runner
from .runs import ClockRuns
from .skew import Early, Refused, Skew
from .watchdog import Watchdog, at_work, watch

__all__ = [
    "Alarm",
    "at_work",
    "Clock",
    "Early",
    "EngineRecovery",
    "relax",
    "Refused",
    "Reports",
    "Runner",
    "ClockRuns",
    "Skew",
    "StreamClock",
    "tighten",
    "Watchdog",
    "watch",
]
