"""``python3 -m retalis``, and the command ``retalis`` of an installation."""

import signal


def main() -> int:
    """Run a command; return its exit status."""
    default = signal.signal(
        signal.SIGINT, signal.SIG_DFL
    )  # while it imports there is nothing to be ended well
    from .cli import main as command_line  # noqa: PLC0415
    from .foundation import stop_collecting  # noqa: PLC0415

    signal.signal(signal.SIGINT, default)
    try:
        return command_line()
    finally:
        stop_collecting()  # or Python walks all that was imported as it exits: 60 ms


if __name__ == "__main__":
    raise SystemExit(main())
