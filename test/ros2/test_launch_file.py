"""The launch file of ROS 2, with stand-ins for the packages `launch` and `launch_ros`, which are not on PyPI."""

import runpy
import sys
from types import ModuleType, SimpleNamespace
from typing import Any, Dict

import pytest
from parsed_sources import ROOT

from retalis.node.parameters import PARAMETER_DESCRIPTIONS

LAUNCH_FILE = ROOT / "launch" / "retalis.launch.py"


class Argument(SimpleNamespace):
    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name=name, **options)


class Configuration:
    def __init__(self, name: str) -> None:
        self.name = name

    def perform(self, context: Dict[str, str]) -> str:
        return context[self.name]


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> Dict[str, Any]:
    pytest.importorskip("yaml")
    stand_ins: Dict[str, Dict[str, Any]] = {
        "launch": {"LaunchContext": dict, "LaunchDescription": list},
        "launch.actions": {"DeclareLaunchArgument": Argument, "OpaqueFunction": SimpleNamespace},
        "launch.substitutions": {"LaunchConfiguration": Configuration},
        "launch_ros": {},
        "launch_ros.actions": {"LifecycleNode": SimpleNamespace},
    }
    for name, members in stand_ins.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    return runpy.run_path(str(LAUNCH_FILE))


def launch(launch_file: Dict[str, Any], **given: str) -> Any:
    """Return the node that is started with arguments."""
    *arguments, function = launch_file["generate_launch_description"]()
    context = {argument.name: argument.default_value for argument in arguments}
    assert set(given) <= set(context)
    (node,) = function.function({**context, **given})
    return node


def test_each_parameter_is_argument(launch_file: Dict[str, Any]) -> None:
    *arguments, _ = launch_file["generate_launch_description"]()
    assert set(PARAMETER_DESCRIPTIONS) <= {argument.name for argument in arguments}


def test_node_of_package_is_started(launch_file: Dict[str, Any]) -> None:
    node = launch(launch_file)
    assert (node.package, node.executable, node.name) == ("retalis", "retalis_node", "retalis")
    assert node.parameters == [{"autostart": True, "use_sim_time": False}]


def test_given_arguments_become_parameters(launch_file: Dict[str, Any]) -> None:
    node = launch(
        launch_file, program="/p", queue="10", max_seconds="0.5", use_sim_time="true", direct="[tf, a/B]"
    )
    assert node.parameters == [
        {
            "autostart": True,
            "use_sim_time": True,
            "program": "/p",
            "queue": 10,
            "max_seconds": 0.5,
            "direct": ["tf", "a/B"],
        }
    ]


def test_file_of_parameters_precedes_arguments(launch_file: Dict[str, Any]) -> None:
    node = launch(launch_file, params_file="/p.yaml", queue="10")
    assert node.parameters == ["/p.yaml", {"autostart": True, "use_sim_time": False, "queue": 10}]
