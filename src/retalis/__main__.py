"""``python3 -m retalis``, and the command ``retalis`` of an installation."""

import gc
import os
import signal
import sys
import threading

_INTERRUPTED = 130
"""Exit status after ctrl-C."""

_MAX_WRITE_SECONDS = 0.1
"""Time that the reader of a full pipe has to read the rest of the output after ctrl-C."""


def main() -> int:
    """Run a command; return its exit status."""
    _open_closed_streams()
    # Before and after the command there is nothing to clean up after ctrl-C. A process that ignores it, as one in the
    # background of a script, continues to ignore it.
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, _exit_at_once)
    # While modules are imported, there is no garbage to collect.
    gc.disable()
    from .cli.command_line import import_commands  # noqa: PLC0415
    from .cli.command_line import main as command_line  # noqa: PLC0415
    from .foundation.garbage_collection import stop_collecting  # noqa: PLC0415
    from .foundation.interrupts import deferred_interrupts  # noqa: PLC0415

    import_commands(sys.argv[1:])
    stop_collecting()  # modules stay: later collections, and those at the exit, do not visit them
    gc.enable()
    try:
        with deferred_interrupts():
            status = command_line()
    except KeyboardInterrupt:
        status = _INTERRUPTED
    stop_collecting()
    if status == _INTERRUPTED:
        _write_buffered_output()
    return status


def _write_buffered_output() -> None:
    """Write the buffered output after ctrl-C, or end the process if nobody reads it."""
    writer = threading.Thread(target=sys.stdout.flush, daemon=True)
    writer.start()
    writer.join(_MAX_WRITE_SECONDS)
    if writer.is_alive():
        os._exit(_INTERRUPTED)


def _exit_at_once(*signal_arguments: object) -> None:
    os._exit(_INTERRUPTED)


def _open_closed_streams() -> None:
    """Replace standard streams that are closed by the null device.

    Otherwise the next file that is opened would get the number of the stream.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115 - stays open until the process ends


if __name__ == "__main__":
    raise SystemExit(main())
