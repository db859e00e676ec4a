"""Messages of the topics of an action ``lab/Dock``, in ROS 1 and in ROS 2."""

from typing import Any, Dict, List, Tuple

from messages.ros2_types import find_text
from retalis import Definition, Definitions
from retalis.messages.action_events import ActionEvent
from retalis.messages.message_dictionaries import make_message_term
from retalis.messages.type_definition import SerializationFormat
from retalis.messages.type_registry import parse_ros2_type

ROS1, ROS2 = SerializationFormat.ROS1, SerializationFormat.CDR

GOAL, RESULT, FEEDBACK = "string station\n", "float64 seconds\n", "float64 distance\nint32[] steps\n"
DOCK = f"{GOAL}---\n{RESULT}---\n{FEEDBACK}"

_ACTIONLIB = {
    "Goal": "Header header\nactionlib_msgs/GoalID goal_id\nDockGoal goal\n",
    "Feedback": "Header header\nactionlib_msgs/GoalStatus status\nDockFeedback feedback\n",
    "Result": "Header header\nactionlib_msgs/GoalStatus status\nDockResult result\n",
}
_PARTS = {"Goal": GOAL, "Feedback": FEEDBACK, "Result": RESULT}

ROS1_STATUSES = {"pending": 0, "executing": 1, "canceled": 2, "succeeded": 3, "aborted": 4, "canceling": 6}
ROS2_STATUSES = {"accepted": 1, "executing": 2, "canceling": 3, "succeeded": 4, "canceled": 5, "aborted": 6}

Message = Tuple[str, Definition, bytes]
"""Topic without the name of the action, type and bytes of a message."""


def uuid(goal: str) -> Dict[str, Any]:
    """Return the id of a goal in ROS 2: up to 16 characters."""
    return {"uuid": goal.encode().ljust(16, b"\0")}


def goal_text(goal: str, message_format: SerializationFormat) -> str:
    """Return the id of a goal as events have it."""
    return goal if message_format is ROS1 else goal.encode().ljust(16, b"\0").hex()


class DockServer:
    """Creates the messages of the server of an action.

    Args:
        message_format: that of ROS 1 or of ROS 2.
    """

    def __init__(self, message_format: SerializationFormat):
        self.format = message_format
        self._definitions = Definitions()

    def definition(self, kind: str) -> Definition:
        """Return the type of the messages of an event."""
        name = ActionEvent("lab/Dock", kind).endpoint("", self.format)[1]
        if self.format is ROS1:
            part = kind.capitalize()
            if part not in _ACTIONLIB:
                return self._definitions.find(name)
            nested = f"{'=' * 80}\nMSG: lab/Dock{part}\n{_PARTS[part]}"
            return self._definitions.add(name, f"{_ACTIONLIB[part]}{nested}")
        text = DOCK if name.startswith("lab/") else ""
        package, _, type_name = name.partition("/")
        folder = "action" if package == "lab" else "srv" if type_name.endswith("_Event") else "msg"
        if not text:
            text = CANCEL_GOAL if folder == "srv" else find_text(name) or ""
        return parse_ros2_type(f"{package}/{folder}/{type_name}", text, find_text)

    def message(self, kind: str, **fields: Any) -> Message:
        """Return a message of an event's topic."""
        definition = self.definition(kind)
        data = self._definitions.encoder(definition, self.format).encode(
            make_message_term(definition, fields)
        )
        return ActionEvent("lab/Dock", kind).endpoint("", self.format)[0], definition, data

    def feedback(self, goal: str, distance: float) -> Message:
        feedback = {"distance": distance, "steps": [1, 2]}
        if self.format is ROS1:
            return self.message("feedback", status={"goal_id": {"id": goal}}, feedback=feedback)
        return self.message("feedback", goal_id=uuid(goal), feedback=feedback)

    def status(self, **statuses: str) -> Message:
        """Return an array with the states of all goals."""
        if self.format is ROS1:
            items: List[Any] = [
                {"goal_id": {"id": goal}, "status": ROS1_STATUSES[status]}
                for goal, status in statuses.items()
            ]
        else:
            items = [
                {"goal_info": {"goal_id": uuid(goal)}, "status": ROS2_STATUSES[status]}
                for goal, status in statuses.items()
            ]
        return self.message("status", status_list=items)

    def goal(self, goal: str, station: str) -> Message:
        if self.format is ROS1:
            return self.message("goal", goal_id={"id": goal}, goal={"station": station})
        request = {"goal_id": uuid(goal), "goal": {"station": station}}
        return self.message("goal", info={"event_type": 1}, request=[request])

    def cancel(self, goal: str) -> Message:
        if self.format is ROS1:
            return self.message("cancel", id=goal)
        request = {"goal_info": {"goal_id": uuid(goal)}}
        return self.message("cancel", info={"event_type": 1}, request=[request])

    def result_request(self, goal: str, number: int = 7) -> Message:
        """Return the request for a result, which only ROS 2 has."""
        info = {"event_type": 1, "sequence_number": number}
        return self.message("result", info=info, request=[{"goal_id": uuid(goal)}])

    def result(self, goal: str, status: str, seconds: float, number: int = 7) -> Message:
        result = {"seconds": seconds}
        if self.format is ROS1:
            state = {"goal_id": {"id": goal}, "status": ROS1_STATUSES[status]}
            return self.message("result", status=state, result=result)
        info = {"event_type": 2, "sequence_number": number}
        response = {"status": ROS2_STATUSES[status], "result": result}
        return self.message("result", info=info, response=[response])


CANCEL_GOAL = "GoalInfo goal_info\n---\nint8 return_code\nGoalInfo[] goals_canceling\n"
