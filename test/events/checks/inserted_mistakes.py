"""A small program into which a test inserts mistakes, and the findings of a check of it."""

from pathlib import Path
from typing import List, NamedTuple

from retalis import Definitions
from retalis.engine.program_check import check_program

TOPICS = """\
<publish_subscribe>
  <subscribe_to name="heat" msg_type="sensor_msgs/Temperature"/>
  <subscribe_to name="bumper" msg_type="std_msgs/Bool"/>
  <subscribe_to name="said" msg_type="std_msgs/String"/>
  <publish_to name="alarms" msg_type="std_msgs/String"/>
"""

GOALS = """\
compile_event_file('eventRules.txt')
memorize(hit, [], _, hits, 10)
subscribe(alarm(Text), [], std_msgs__0__String(Text), alarms, a)
"""

RULES = """\
hit <- std_msgs__0__Bool(true).
alarm('"hit"') <- hit where access_mem(hits, _, _).
"""


class FoundMistake(NamedTuple):
    """A finding of `check_program`.

    Attributes:
        code: its code.
        place: file, line and column; "" without a place.
        message: its text.
    """

    code: str
    place: str
    message: str


def write_program(folder: Path, rule: str = "", goal: str = "", topic: str = "", findings: str = "") -> None:
    """Write the program with additions to its files."""
    (folder / "pub_sub.xml").write_text(f"{TOPICS}{topic}\n</publish_subscribe>\n")
    (folder / "goalPredicates.txt").write_text(f"{GOALS}{goal}\n")
    (folder / "eventRules.txt").write_text(f"{RULES}{rule}\n")


def find_mistakes(folder: Path, definitions: Definitions) -> List[FoundMistake]:
    """Return the findings of a check."""
    mistakes = []
    for finding in check_program(folder, definitions):
        place = finding.problem.place
        place_text = "" if place is None else f"{Path(place.source).name}:{place.line}:{place.column}"
        mistakes.append(FoundMistake(finding.problem.code, place_text, finding.problem.message))
    return mistakes
