"""The package as users find it: sourced, launched, run, in devel and install space."""

from pathlib import Path

SERVICES = {
    "add_input_subscription",
    "add_memory",
    "add_output_subscription",
    "delete_input_subscription",
    "delete_memory",
    "delete_output_subscription",
}
IMPORTS = "import retalis.srv, retalis.msg, rosbags, lark; print(retalis.srv.AddMemory, retalis.msg.Radar)"


def test_generated_and_written_modules_are_one_package(space):
    assert space.run("/usr/bin/python3", "-c", IMPORTS)


def test_everything_in_the_sources_is_there(space):
    code = (
        "import pkgutil, retalis, pathlib\n"
        "for place in retalis.__path__:\n"
        "    for path in sorted(pathlib.Path(place).rglob('*')):\n"
        "        if path.suffix in ('.py', '.lark', '.pl') and path.parent.name not in ('srv', 'msg'):\n"
        "            print(path.relative_to(place))\n"
    )
    root = Path(__file__).resolve().parents[2] / "src" / "retalis"
    wanted = {str(path.relative_to(root)) for kind in ("*.py", "*.lark", "*.pl") for path in root.rglob(kind)}
    assert wanted <= set(space.run("/usr/bin/python3", "-c", code).split())


def test_launch_file_starts_both_nodes_and_six_services(space):
    space.start("roslaunch", "-p", str(space.port), "retalis", "retalis.launch")
    wanted = {"/" + name for name in SERVICES}
    nodes = {"/retalis", "/retalis_ros_interface"}
    space.expect(lambda found, services: nodes <= found and wanted <= services)
    assert space.run("rosparam", "get", "/use_sim_time").strip() == "true"


def test_embedded_is_one_process_with_six_services(space):
    space.start("roslaunch", "-p", str(space.port), "retalis", "retalis.launch", "embedded:=true")
    wanted = {"/" + name for name in SERVICES}
    space.expect(lambda found, services: "/retalis" in found and wanted <= services)
    assert "/retalis_ros_interface" not in space.state()[0]


def test_node_names_without_a_launch_file(space):
    space.start("roscore", "-p", str(space.port))
    space.expect(lambda found, services: "/rosout" in found)
    space.start("rosrun", "retalis", "retalis_node")
    space.start("rosrun", "retalis", "retalis_ros_converter.py")
    wanted = {"/retalis", "/retalis_ros_converter"}
    space.expect(lambda found, services: wanted <= found)


def test_launch_arguments_are_listed(space):
    listed = space.run("roslaunch", "--ros-args", "retalis", "retalis.launch")
    for argument in ("use_sim_time", "program", "direct", "embedded", "allow_goals", "queue"):
        assert argument in listed
    assert "bag" in space.run("roslaunch", "--ros-args", "retalis", "nao.launch")
