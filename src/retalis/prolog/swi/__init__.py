"""SWI-Prolog beside the built-in one, in the same process, for those who have it installed."""

from .using import SwiFile, define_use_swi, use_swi

__all__ = ["define_use_swi", "SwiFile", "use_swi"]
