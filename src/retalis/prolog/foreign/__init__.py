"""Foreign predicates: Python functions that a program calls as predicates."""

from .functions import define_foreign, foreign
from .jsonvalues import to_json
from .modules import NamedFiles, define_use_foreign, load_module
from .values import Compound, to_python, to_term

__all__ = [
    "Compound",
    "define_foreign",
    "define_use_foreign",
    "load_module",
    "foreign",
    "NamedFiles",
    "to_json",
    "to_python",
    "to_term",
]
