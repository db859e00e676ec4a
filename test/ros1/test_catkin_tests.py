"""``catkin_add_retalis_test``: test cases as tests of a package, and their results."""

from pathlib import Path
from typing import Any

PACKAGE = """\
<package format="3">
  <name>robot</name><version>1.0.0</version><description>A program.</description>
  <maintainer email="me@example.org">me</maintainer><license>MIT</license>
  <buildtool_depend>catkin</buildtool_depend><test_depend>retalis</test_depend>
</package>
"""

CMAKE = """\
cmake_minimum_required(VERSION 3.0.2)
project(robot)
find_package(catkin REQUIRED COMPONENTS retalis)
catkin_package()
if(CATKIN_ENABLE_TESTING)
  catkin_add_retalis_test(tests)
endif()
"""

CASES = """\
rules: hot <- heat(T) where T > 40.
cases:
  - {name: hot, input: [{at: 1, event: heat(41)}], expect: {events: [hot]}}
  - {name: cold, input: [{at: 1, event: heat(39)}], expect: {events: [hot]}}
"""

RUN_TESTS = """\
source "$0"
mkdir "$1/build" && cd "$1/build"
cmake "$1" -DCATKIN_ENABLE_TESTING=ON -DPYTHON_EXECUTABLE=/usr/bin/python3 > cmake.log 2>&1
make run_tests > make.log 2>&1
catkin_test_results --verbose .
true
"""


def test_result_command_lists_cases(devel: Any, tmp_path: Path) -> None:
    (tmp_path / "package.xml").write_text(PACKAGE)
    (tmp_path / "CMakeLists.txt").write_text(CMAKE)
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "heat.yaml").write_text(CASES)
    text = devel.run("bash", "-c", RUN_TESTS, str(devel.script), str(tmp_path))
    assert "Summary: 2 tests, 0 errors, 1 failures, 0 skipped" in text
    assert "retalis-tests.xml" in text
