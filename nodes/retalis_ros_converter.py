#!/usr/bin/env python3
"""Node `retalis_ros_converter`."""

import signal

for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(
        number, signal.SIG_DFL
    )  # until all is imported: nothing is there yet that would have to be ended

from retalis.ros1.ros_interface_node import main  # noqa: E402

raise SystemExit(main())
