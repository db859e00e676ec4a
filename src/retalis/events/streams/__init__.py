"""Operators on streams of matches: windows and what they measure, and what lets some matches through only."""

from .awaiting import Agreement, Awaiting
from .items import KnownState, StreamItem, StreamOperator, StreamOutput
from .measures import MEASURES
from .shapes import Changing, Settled, Spaced
from .stepping import MOST_WAYS, SteppedWindow
from .steps import StepMark, StepPlan, StepTest, WindowStep
from .windows import Batches, FromFirst, Hopping, Newest, RunningWindow, Sliding

__all__ = [
    "MEASURES",
    "MOST_WAYS",
    "Agreement",
    "Awaiting",
    "Batches",
    "Changing",
    "FromFirst",
    "Hopping",
    "StreamItem",
    "KnownState",
    "StepMark",
    "Newest",
    "StreamOutput",
    "RunningWindow",
    "Settled",
    "Sliding",
    "Spaced",
    "WindowStep",
    "StepPlan",
    "StepTest",
    "SteppedWindow",
    "StreamOperator",
]
