"""Fixtures of the tests on ROS: a port and the devel space of the workspace."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

spec = spec_from_file_location("spaces_of_ros_tests", Path(__file__).parents[1] / "ros1" / "conftest.py")
spaces = module_from_spec(spec)
spec.loader.exec_module(spaces)
port, devel = spaces.port, spaces.devel
