"""Operators on streams of matches: windows and what they measure, and what lets some matches through only."""

from .awaiting import Agreement, Awaiting
from .groups import WindowGroup
from .items import KeyBounds, KnownState, StreamItem, StreamOperator, StreamOutput
from .measures import MEASURES
from .numbers import ADDING, check_finite, check_ordered, is_number, is_number_expression, unfit
from .shapes import Changing, Settled, Spaced
from .stepping import MAX_WAYS_PER_START, SteppedWindow
from .steps import StepMark, StepPlan, StepTest, WindowStep
from .timewindows import FromFirst, Hopping, RunningWindow
from .windows import Batches, Newest, Sliding

__all__ = [
    "ADDING",
    "MEASURES",
    "MAX_WAYS_PER_START",
    "Agreement",
    "Awaiting",
    "Batches",
    "Changing",
    "FromFirst",
    "Hopping",
    "StreamItem",
    "KeyBounds",
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
    "WindowGroup",
    "check_finite",
    "check_ordered",
    "is_number",
    "is_number_expression",
    "unfit",
]
