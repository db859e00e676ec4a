"""A page that shows a running program: rates, memories, rules, the last events, and all of it as a graph."""

from .server import DASHBOARD_PORT, Dashboard
from .snapshot import DashboardSource, TopicLook

__all__ = ["Dashboard", "DASHBOARD_PORT", "DashboardSource", "TopicLook"]
