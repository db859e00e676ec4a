"""Package in devel and install space: environment, launch files, programs."""

import os
import signal
from pathlib import Path
from typing import Any

SERVICES = {
    "add_input_subscription",
    "add_memory",
    "add_output_subscription",
    "delete_input_subscription",
    "delete_memory",
    "delete_output_subscription",
}
FILE_PATTERNS = ("*.py", "*.pl", "*.html", "*.css", "*.js", "*.svg")
IMPORTS = "import retalis.srv, retalis.msg, rosbags; print(retalis.srv.AddMemory, retalis.msg.Radar)"


def test_generated_modules_are_in_package(space: Any) -> None:
    assert space.run("/usr/bin/python3", "-c", IMPORTS)


def test_all_source_files_are_installed(space: Any) -> None:
    code = (
        "import pkgutil, retalis, pathlib\n"
        "for place in retalis.__path__:\n"
        "    for path in sorted(pathlib.Path(place).rglob('*')):\n"
        "        kinds = ('.py', '.pl', '.html', '.css', '.js', '.svg')\n"
        "        if path.suffix in kinds and path.parent.name not in ('srv', 'msg'):\n"
        "            print(path.relative_to(place))\n"
    )
    root = Path(__file__).resolve().parents[2] / "src" / "retalis"
    expected = {str(path.relative_to(root)) for pattern in FILE_PATTERNS for path in root.rglob(pattern)}
    assert len(expected) > 100
    assert expected <= set(space.run("/usr/bin/python3", "-c", code).split())


def test_roscd_finds_folder_of_package(space: Any) -> None:
    script = 'source "$0" && roscd retalis && pwd'
    folder = Path(space.run("bash", "-c", script, str(space.script)).strip())
    assert (folder / "package.xml").is_file()
    assert space.script.parents[1] in folder.parents


def test_launch_file_starts_nodes_and_services(space: Any) -> None:
    space.start_master()
    space.start("roslaunch", "-p", str(space.port), "retalis", "retalis.launch")
    expected = {"/" + name for name in SERVICES}
    expected_nodes = {"/retalis", "/retalis_ros_interface"}
    space.expect(lambda nodes, services: expected_nodes <= nodes and expected <= services)
    assert space.run("rosparam", "get", "/use_sim_time").strip() == "true"


def test_embedded_node_has_all_services(devel: Any) -> None:
    devel.start_master()
    devel.start("roslaunch", "-p", str(devel.port), "retalis", "retalis.launch", "embedded:=true")
    expected = {"/" + name for name in SERVICES}
    devel.expect(lambda nodes, services: "/retalis" in nodes and expected <= services)
    assert "/retalis_ros_interface" not in devel.state()[0]


def test_killed_nodes_are_respawned_on_request(devel: Any) -> None:
    devel.start_master()
    devel.start("roslaunch", "-p", str(devel.port), "retalis", "retalis.launch", "respawn:=true")
    expected = {"/retalis", "/retalis_ros_interface"}
    devel.expect(lambda nodes, services: expected <= nodes)
    before = {node: devel.pid(node) for node in expected}
    for pid in before.values():
        os.kill(pid, signal.SIGKILL)
    devel.expect(
        lambda nodes, services: all(devel.pid(node) not in (None, before[node]) for node in expected)
    )


def test_node_names_without_launch_file(space: Any) -> None:
    space.start_master()
    space.start("rosrun", "retalis", "retalis_node")
    space.start("rosrun", "retalis", "retalis_ros_converter.py")
    expected = {"/retalis", "/retalis_ros_converter"}
    space.expect(lambda nodes, services: expected <= nodes)


def test_launch_arguments_are_listed(space: Any) -> None:
    listed = space.run("roslaunch", "--ros-args", "retalis", "retalis.launch")
    for argument in (
        "use_sim_time",
        "program",
        "direct",
        "embedded",
        "allow_goals",
        "write_folders",
        "queue",
    ):
        assert argument in listed
    example = space.run("roslaunch", "--ros-args", "retalis", "nao.launch")
    assert "bag" in example
    assert "Required Arguments" not in listed + example


RULES = """
persistent_event(read(_)).
read(File) <- file(File) where catch(consult(File), _, fail).
refused(Kind) <- file(File) where catch((consult(File), fail), error(permission_error(Kind, _, _), _), true).
persistent_event(refused(_)).
"""


def test_goals_open_files_in_allowed_folders_only(devel: Any, tmp_path: Path) -> None:
    program, data, out, other = (tmp_path / name for name in ("program", "data", "out", "other"))
    for folder in (program, data, out, other):
        folder.mkdir()
        (folder / "some.pl").write_text("some(1).\n")
    (program / "pub_sub.xml").write_text("<publish_subscribe/>\n")
    (program / "goalPredicates.txt").write_text("compile_event_file('rules.txt')\nconsult('../other/some')\n")
    (program / "rules.txt").write_text(RULES)
    devel.env["ROS_HOME"] = str(tmp_path / "home")
    devel.start_master()
    devel.start(
        *("roslaunch", "-p", str(devel.port), "retalis", "retalis.launch", f"program:={program}"),
        *("use_sim_time:=false", f"folders:=[{data}]", f"write_folders:=[{out}]"),
    )
    devel.expect(lambda nodes, services: "/add_memory" in services)
    names = ["some", str(data / "some"), str(out / "some"), str(other / "some")]
    devel.post_events(*(f"file('{name}'),[1,1]" for name in names))
    event_file = out / "persistent.txt"
    expected = [
        *(f"event(read({name}),[1,1])." for name in ("some", *(f"'{name}'" for name in names[1:3]))),
        "event(refused(open),[1,1]).",
    ]
    devel.expect(
        lambda nodes, services: event_file.exists() and event_file.read_text().split("\n")[:-1] == expected
    )
    assert not list(tmp_path.glob("home/persistent.txt"))
    assert [path.name for path in other.iterdir()] == ["some.pl"]
