"""Event rules and a Prolog knowledge base for robots, on ROS 1 and without it."""

from pkgutil import extend_path
from typing import Any

# catkin puts the generated retalis.msg and retalis.srv into a folder of their own, in devel space: both are `retalis`
__path__ = extend_path(__path__, __name__)

__all__ = ["Compound", "Engine", "foreign"]


def __getattr__(name: str) -> Any:
    """Import the engine when it is asked for: who wants only ``retalis.srv`` does not pay for it."""
    if name == "Engine":
        from .engine import Engine

        return Engine
    if name in ("Compound", "foreign"):
        from . import _foreign

        return getattr(_foreign, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
