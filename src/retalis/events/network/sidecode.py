"""How the lines that serve an event become two functions: an action, and the lane that does the same."""

from typing import Any, Callable, Dict, List, Optional, Tuple

from ...foundation import shared_function
from ...prolog.terms import EventAction
from ..dispatch import Lane, MakeLane

Body = Tuple[str, Dict[str, Any]]
"""The lines of a function, and what they name."""

_HEAD = "def made(term, values, s, e, after):"
_LANE = """
def made(term, s, e):
    dispatcher.current = (term, s, e, None)
    frame = after = done
    for _ in ONCE:
{body}
    if frame is not after:
        run(frame)
    dispatcher.current = None
    return True
"""


def made_of(
    body: Body, whole: bool, of_lane: Callable[[], Body], title: str
) -> Tuple[EventAction, Optional[MakeLane]]:
    """Return the action of a body, and what makes its lane where the values are arguments.

    Args:
        body: no loop in it returns.
        whole: whether the values are arguments.
        of_lane: writes the body of the lane, which does the same.
        title: what it is.
    """
    lines, names = body
    action: EventAction = shared_function("\n".join([_HEAD, *_lines(lines, whole), ""]), names, title)
    return action, (lambda: _lane(of_lane(), title)) if whole else None


def _lines(body: str, whole: bool) -> List[str]:
    filled = body.replace("{values}", "term[1:]" if whole else "values")
    return [line for line in filled.splitlines() if line.strip()]


def _lane(body: Body, title: str) -> Lane:
    """Return the lane of a body: frames are not returned but run."""
    lines, names = body
    served = []
    for line in _lines(lines, True):
        steps, returns, frame = line.partition("return ")
        if returns and frame != "after":
            served.append(f"    {steps}frame = {frame}")
        served.append(f"    {steps}break" if returns else f"    {line}")
    lane: Lane = shared_function(_LANE.format(body="\n".join(served)), names, title)
    return lane
