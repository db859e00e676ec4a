"""Start node `retalis` of ROS 2: `ros2 launch retalis retalis.launch.py program:=/path/of/the/folder`.

Each parameter of the node is an argument; those that are not given keep the node's defaults, or the values of
`params_file`.
"""

from typing import Any, Dict, List

import yaml
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode

from retalis.node.parameters import PARAMETER_DESCRIPTIONS

ARGUMENTS = {
    "name": ("retalis", "Name of the node"),
    "namespace": ("", "Namespace of the node"),
    "autostart": ("true", "Configure and activate the node when it starts"),
    "use_sim_time": ("false", "Use the time on the topic /clock, which a bag or a simulator publishes"),
    "params_file": ("", "YAML file with parameters; an absolute path"),
    "respawn": ("false", "Start the node again when it ends"),
    "log_level": ("info", "Least severity of messages that are logged: debug, info, warn, error or fatal"),
}
"""Defaults and descriptions of the arguments that are not parameters of the node alone."""


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the node."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    declared += [
        DeclareLaunchArgument(name, default_value="", description=description)
        for name, description in PARAMETER_DESCRIPTIONS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=create_node)])


def create_node(context: LaunchContext) -> List[LifecycleNode]:
    """Return the node with the parameters that are given."""

    def read(name: str) -> str:
        return str(LaunchConfiguration(name).perform(context))

    parameters: List[Any] = [read("params_file")] if read("params_file") else []
    given: Dict[str, Any] = {
        name: yaml.safe_load(read(name)) for name in PARAMETER_DESCRIPTIONS if read(name)
    }
    own = {name: yaml.safe_load(read(name)) for name in ("autostart", "use_sim_time")}
    parameters.append({**own, **given})
    return [
        LifecycleNode(
            package="retalis",
            executable="retalis_node",
            name=read("name"),
            namespace=read("namespace"),
            parameters=parameters,
            respawn=yaml.safe_load(read("respawn")),
            arguments=["--ros-args", "--log-level", read("log_level")],
            output="screen",
        )
    ]
