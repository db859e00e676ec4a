"""Fixture of the tests on ROS: the devel space of the workspace."""

from pathlib import Path

from script_modules import load_script

spaces = load_script(Path(__file__).parents[1] / "ros1" / "conftest.py", "spaces_of_ros_tests")
devel = spaces.devel
