"""Fused paths: generated functions that do in one call what the plain way of an event does in several.

Each of them does the same as the plain way, by the same protocol: an action takes an event, the values of its
pattern's variables, start, end and the next frame, and returns the frame to go on with.
"""

from .actions import Completion, firing_action, goal_action, question_action
from .sides import SPARE, FusedPair, PartnerChoice, fused_absence, fused_side
from .windows import FusedWindow, fused_window, has_fused_measures

__all__ = [
    "Completion",
    "firing_action",
    "fused_absence",
    "fused_side",
    "fused_window",
    "FusedPair",
    "FusedWindow",
    "goal_action",
    "has_fused_measures",
    "PartnerChoice",
    "question_action",
    "SPARE",
]
