"""``python3 -m retalis``, and the command ``retalis`` of an installation."""

import gc
import signal
import sys


def main() -> int:
    """Run a command; return its exit status."""
    # While modules are imported, ctrl-C ends the process at once, and there is no garbage to collect.
    default = signal.signal(signal.SIGINT, signal.SIG_DFL)
    gc.disable()
    from .cli.command_line import import_commands  # noqa: PLC0415
    from .cli.command_line import main as command_line  # noqa: PLC0415
    from .foundation.cpython_and_pypy import stop_collecting  # noqa: PLC0415

    import_commands(sys.argv[1:])
    stop_collecting()  # modules stay: later collections, and those at the exit, do not visit them
    gc.enable()
    signal.signal(signal.SIGINT, default)
    try:
        return command_line()
    finally:
        stop_collecting()


if __name__ == "__main__":
    raise SystemExit(main())
