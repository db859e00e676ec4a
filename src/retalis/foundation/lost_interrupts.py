"""Interrupts that Python ignores.

The handler of a signal runs between two steps of the main thread, whatever it executes. If that is a callback of a
weak reference or of the garbage collector, or a ``__del__`` method, Python reports the `KeyboardInterrupt` to
`sys.unraisablehook` and continues: the interrupt is lost. Such callbacks run at any time, also in the standard
library.
"""

import _thread
import signal
import sys
import threading
import time
from contextlib import contextmanager
from typing import Any, Iterator

REPEAT_SECONDS = 0.05
"""Seconds after which a lost interrupt is sent again; callbacks take less time."""


@contextmanager
def repeat_lost_interrupts() -> Iterator[None]:
    """Send SIGINT again whenever Python has ignored the `KeyboardInterrupt` of a signal in the main thread."""
    previous_hook = sys.unraisablehook

    def report(unraisable: Any) -> None:
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            # Not `threading.Thread`, which takes locks that the interrupted code may hold.
            _thread.start_new_thread(_interrupt_later, ())
        else:
            previous_hook(unraisable)

    sys.unraisablehook = report
    try:
        yield
    finally:
        sys.unraisablehook = previous_hook


def _interrupt_later() -> None:
    """Send SIGINT to the main thread when the callback has probably ended; if not, the next one is sent as well."""
    time.sleep(REPEAT_SECONDS)
    main = threading.main_thread().ident
    if main is not None:
        signal.pthread_kill(main, signal.SIGINT)
