"""The package in devel and install space: environment, launch files, programs."""

import os
import signal
from pathlib import Path

SERVICES = {
    "add_input_subscription",
    "add_memory",
    "add_output_subscription",
    "delete_input_subscription",
    "delete_memory",
    "delete_output_subscription",
}
KINDS = ("*.py", "*.pl", "*.html", "*.css", "*.js", "*.svg")
IMPORTS = "import retalis.srv, retalis.msg, rosbags; print(retalis.srv.AddMemory, retalis.msg.Radar)"


def test_generated_and_written_modules_are_one_package(space):
    assert space.run("/usr/bin/python3", "-c", IMPORTS)


def test_everything_in_the_sources_is_there(space):
    code = (
        "import pkgutil, retalis, pathlib\n"
        "for place in retalis.__path__:\n"
        "    for path in sorted(pathlib.Path(place).rglob('*')):\n"
        "        kinds = ('.py', '.pl', '.html', '.css', '.js', '.svg')\n"
        "        if path.suffix in kinds and path.parent.name not in ('srv', 'msg'):\n"
        "            print(path.relative_to(place))\n"
    )
    root = Path(__file__).resolve().parents[2] / "src" / "retalis"
    wanted = {str(path.relative_to(root)) for kind in KINDS for path in root.rglob(kind)}
    assert wanted <= set(space.run("/usr/bin/python3", "-c", code).split())


def test_a_shell_that_has_sourced_it_goes_to_its_folder(space):
    script = 'source "$0" && roscd retalis && pwd'
    folder = Path(space.run("bash", "-c", script, str(space.script)).strip())
    assert (folder / "package.xml").is_file() and space.script.parents[1] in folder.parents


def test_launch_file_starts_both_nodes_and_six_services(space):
    space.start_master()
    space.start("roslaunch", "-p", str(space.port), "retalis", "retalis.launch")
    wanted = {"/" + name for name in SERVICES}
    nodes = {"/retalis", "/retalis_ros_interface"}
    space.expect(lambda found, services: nodes <= found and wanted <= services)
    assert space.run("rosparam", "get", "/use_sim_time").strip() == "true"


def test_embedded_is_one_process_with_six_services(space):
    space.start_master()
    space.start("roslaunch", "-p", str(space.port), "retalis", "retalis.launch", "embedded:=true")
    wanted = {"/" + name for name in SERVICES}
    space.expect(lambda found, services: "/retalis" in found and wanted <= services)
    assert "/retalis_ros_interface" not in space.state()[0]


def test_nodes_that_end_are_started_again_where_that_is_wanted(space):
    space.start_master()
    space.start("roslaunch", "-p", str(space.port), "retalis", "retalis.launch", "respawn:=true")
    nodes = {"/retalis", "/retalis_ros_interface"}
    space.expect(lambda found, services: nodes <= found)
    before = {node: space.pid(node) for node in nodes}
    for pid in before.values():
        os.kill(pid, signal.SIGKILL)
    space.expect(lambda found, services: all(space.pid(node) not in (None, before[node]) for node in nodes))


def test_node_names_without_a_launch_file(space):
    space.start_master()
    space.start("rosrun", "retalis", "retalis_node")
    space.start("rosrun", "retalis", "retalis_ros_converter.py")
    wanted = {"/retalis", "/retalis_ros_converter"}
    space.expect(lambda found, services: wanted <= found)


def test_launch_arguments_are_listed(space):
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


def test_goals_of_a_node_open_files_in_the_folders_of_its_parameters_only(space, tmp_path):
    program, data, out, other = (tmp_path / name for name in ("program", "data", "out", "other"))
    for folder in (program, data, out, other):
        folder.mkdir()
        (folder / "some.pl").write_text("some(1).\n")
    (program / "pub_sub.xml").write_text("<publish_subscribe/>\n")
    (program / "goalPredicates.txt").write_text("compile_event_file('rules.txt')\nconsult('../other/some')\n")
    (program / "rules.txt").write_text(RULES)
    space.env["ROS_HOME"] = str(tmp_path / "home")
    space.start_master()
    space.start(
        *("roslaunch", "-p", str(space.port), "retalis", "retalis.launch", f"program:={program}"),
        *("use_sim_time:=false", f"folders:=[{data}]", f"write_folders:=[{out}]"),
    )
    space.expect(lambda found, services: "/add_memory" in services)
    names = ["some", str(data / "some"), str(out / "some"), str(other / "some")]
    space.post_events(*(f"file('{name}'),[1,1]" for name in names))
    written = out / "persistent.txt"
    wanted = [
        *(f"event(read({name}),[1,1])." for name in ("some", *(f"'{name}'" for name in names[1:3]))),
        "event(refused(open),[1,1]).",
    ]
    space.expect(lambda found, services: written.exists() and written.read_text().split("\n")[:-1] == wanted)
    assert not list(tmp_path.glob("home/persistent.txt"))
    assert [path.name for path in other.iterdir()] == ["some.pl"]
