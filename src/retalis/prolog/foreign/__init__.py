"""Foreign predicates: Python functions that a program calls as predicates."""

from .functions import define_foreign, foreign
from .modules import define_use_foreign
from .values import Compound

__all__ = [
    "Compound",
    "define_foreign",
    "define_use_foreign",
    "foreign",
]
