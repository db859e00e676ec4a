"""Foreign predicates: Python functions that a program calls as predicates."""

from .functions import define_foreign
from .modules import define_use_foreign

__all__ = [
    "define_foreign",
    "define_use_foreign",
]
