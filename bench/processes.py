"""Processes for the benchmarks of nodes: start, measurement from ``/proc``, and end."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from typing import Dict, Iterator, List, Optional

TOPICS = ("tf", "ar_pose_marker", "face_recognition/feedback")

ROSPY_IDLE = f"""
import rospy
rospy.init_node("idle")
for topic in {TOPICS}:
    rospy.Subscriber(topic, rospy.AnyMsg, lambda message: None, queue_size=5000)
rospy.spin()
"""

ROSCPP_IDLE = """
#include <ros/ros.h>
#include <topic_tools/shape_shifter.h>
void nothing(const topic_tools::ShapeShifter::ConstPtr&) {}
int main(int argc, char** argv) {
  ros::init(argc, argv, "idle");
  ros::NodeHandle node;
  ros::Subscriber first = node.subscribe("tf", 5000, nothing);
  ros::Subscriber second = node.subscribe("ar_pose_marker", 5000, nothing);
  ros::Subscriber third = node.subscribe("face_recognition/feedback", 5000, nothing);
  ros::spin();
}
"""


class Started:
    """Group of processes that are ended together."""

    def __init__(self) -> None:
        self.processes: List[subprocess.Popen] = []

    def __call__(self, command: List[str]) -> subprocess.Popen:
        """Start a process without output."""
        quiet = subprocess.DEVNULL
        process = subprocess.Popen(command, stdout=quiet, stderr=quiet, start_new_session=True)
        self.processes.append(process)
        return process

    def end(self) -> None:
        """Interrupt all processes, the newest first, and wait for them."""
        for process in reversed(self.processes):
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGINT)
        for process in self.processes:
            try:
                process.wait(15)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
        self.processes.clear()


def free_port() -> int:
    """Return an unused port."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


@contextmanager
def own_master(node: str) -> Iterator[None]:
    """Run a master on a free port, with this process as a node.

    Args:
        node: the name of the node.

    Raises:
        SystemExit: if ROS or the built package is not on the path.
    """
    try:
        import rosgraph
        import rospy

        import retalis.srv  # noqa: F401
    except ImportError as error:
        raise SystemExit(f"needs ROS and the built package (source devel/setup.bash): {error}") from error
    port = free_port()
    os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{port}"
    os.environ["ROS_HOSTNAME"] = "127.0.0.1"
    started = Started()
    started(["roscore", "-p", str(port)])
    try:
        while not rosgraph.is_master_online():
            time.sleep(0.1)
        rospy.init_node(node, disable_signals=True)
        yield
    finally:
        started.end()


def cpu(pid: int) -> float:
    """Return the used CPU seconds of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident(pid: int) -> float:
    """Return the resident memory of a process in MB."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def machine() -> Dict[str, str]:
    """Return the CPU, its number of cores, and the version of Python."""
    names = [
        line.partition(":")[2].strip()
        for line in Path("/proc/cpuinfo").read_text().splitlines()
        if line.startswith("model name")
    ]
    implementation = "CPython " + sys.version.split()[0]
    return {"cpu": names[0] if names else "unknown", "cores": str(os.cpu_count()), "python": implementation}


def build_roscpp(folder: Path) -> Optional[str]:
    """Build a roscpp subscriber that does nothing; return its path, or None if it cannot be built."""
    if not (shutil.which("g++") and shutil.which("pkg-config")):
        return None
    libraries = ["pkg-config", "--cflags", "--libs", "roscpp", "topic_tools"]
    found = subprocess.run(libraries, capture_output=True, text=True)
    if found.returncode:
        return None
    source, program = folder / "idle.cpp", folder / "idle"
    source.write_text(ROSCPP_IDLE)
    built = subprocess.run(["g++", "-O2", "-o", str(program), str(source), *found.stdout.split()])
    return None if built.returncode else str(program)
