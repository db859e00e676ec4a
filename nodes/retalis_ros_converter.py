#!/usr/bin/env python3
"""Node `retalis_ros_converter`."""

from retalis.ros.converter import main

raise SystemExit(main())
