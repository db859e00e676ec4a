"""Tutorial about a live robot: its commands print the output on the page."""

import re
from pathlib import Path
from typing import Any

TUTORIALS = Path(__file__).resolve().parents[2] / "docs" / "tutorials"
FILE = re.compile(r"^<!-- (corner/\S+) -->\n```\w*\n(.*?)^```", re.DOTALL | re.MULTILINE)
FENCE = re.compile(r"^```(\w+)\n(.*?)^```", re.DOTALL | re.MULTILINE)
COMMAND = re.compile(r"^\$ (.*)\n((?:(?!\$ ).*\n)*)", re.MULTILINE)
VARYING = ((re.compile(r"datime\([\d,]*\)"), "datime(...)"), (re.compile(r"/\S*/corner/"), ".../corner/"))
"""Patterns of output that differs between readers, with the text on the page."""


def test_commands_print_output_of_page(devel: Any, tmp_path: Path) -> None:
    (tmp_path / "corner").mkdir()
    # A later version of a file replaces an earlier one, as for a reader.
    for name, text in FILE.findall((TUTORIALS / "robot-program.md").read_text(encoding="utf-8")):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    rules = tmp_path / "corner" / "eventRules.txt"
    rules.write_text(rules.read_text(encoding="utf-8").replace("within 10", "within 60"), encoding="utf-8")
    devel.start_master()
    launch = ("roslaunch", "-p", str(devel.port), "retalis", "retalis.launch", "use_sim_time:=false")
    devel.start(*launch, f"program:={tmp_path / 'corner'}", "explain:=true")
    devel.expect_printed("corner: 4 event rules, 1 memory, 1 subscription")
    devel.expect(lambda nodes, services: "/add_input_subscription" in services)
    devel.start("rostopic", "echo", "/turn")
    command_count = 0
    for language, text in FENCE.findall((TUTORIALS / "live-robot.md").read_text(encoding="utf-8")):
        if language == "prolog":
            with rules.open("a", encoding="utf-8") as file:
                file.write(text)
        for command, expected in COMMAND.findall(text) if language == "console" else ():
            command_count += 1
            output = devel.run("bash", "-c", f'source "$0"; {command}', str(devel.script))
            for pattern, replacement in VARYING:
                output = pattern.sub(replacement, output)
            assert output == expected, command
    assert command_count > 5
    devel.expect_printed("data: 0.0")
