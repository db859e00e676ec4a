"""ROS parameters that goals read: ``ros_param/2``.

An engine has no parameters itself: a node or a bag player sets the function that reads them. This function returns
the last known value at once, because a goal must not wait for another process while the engine works.
"""

from typing import Any, Callable

from ..foundation.errors import UsageError
from ..foundation.ros_name_checks import topic_fault
from ..messages.message_slots import SlotNames, scalar_term
from ..prolog.machine.errors import domain_error
from ..prolog.machine.machine import Machine
from ..prolog.system.prolog_system import PrologSystem
from ..prolog.terms.list_terms import make_list
from ..prolog.terms.types import MINUS, Term, atom, deref
from ..prolog.terms.unification import unify
from .event_input import get_text
from .runtime.problem_reports import Reports

MAX_PARAMETER_DEPTH = 50
"""Maximum depth of nested lists and dictionaries in a parameter."""

ReadParameter = Callable[[str], object]
"""A function that returns the value of a parameter by its name as written in the goal; it must not wait.

It raises `KeyError` if there is no such parameter.
"""


def no_parameters(name: str) -> object:
    """Read a parameter where there is none; a `ReadParameter`."""
    raise KeyError(name)


class RosParameters:
    """The ROS parameters that goals of a program read.

    Args:
        slots: has the program's form of strings.
        reports: receives a warning if there are no parameters.
    """

    def __init__(self, logic: PrologSystem, slots: SlotNames, reports: Reports):
        self._slots = slots
        self._reports = reports
        self._read: ReadParameter = self._warn_without_parameters
        logic.define("ros_param", 2, self._ros_param)

    def set_reader(self, read: ReadParameter) -> None:
        """Set the function that reads parameters."""
        self._read = read

    def read(self, name: str) -> object:
        """Return the value of a parameter; see `ReadParameter`."""
        return self._read(name)

    def _ros_param(self, machine: Machine, name: Term, value: Term) -> bool:
        """Execute the goal ``ros_param(Name, Value)``."""
        parameter = get_text(name)
        # Names of ROS 2 may have points.
        fault = topic_fault(parameter.replace(".", "/"))
        if fault is not None:
            raise domain_error("parameter", deref(name), fault)
        try:
            content = self.read(parameter)
        except KeyError:
            return False
        return unify(value, self._make_term(parameter, content, MAX_PARAMETER_DEPTH), machine.trail)

    def _make_term(self, name: str, value: Any, max_depth: int) -> Term:
        """Return a parameter as a term; texts in the program's form of strings, dictionaries as ``Key-Value``."""
        if isinstance(value, (bool, int, float, str)):
            return scalar_term(value, self._slots.strings)
        if not max_depth:
            raise UsageError(f"parameter {name}: it is nested more than {MAX_PARAMETER_DEPTH} deep")
        if isinstance(value, dict):
            # The keys of YAML may be of several types, which cannot be compared.
            items = sorted(value.items(), key=lambda pair: str(pair[0]))
            return make_list(
                [(MINUS, atom(str(key)), self._make_term(name, item, max_depth - 1)) for key, item in items]
            )
        if isinstance(value, (list, tuple)):
            return make_list([self._make_term(name, item, max_depth - 1) for item in value])
        raise UsageError(
            f"parameter {name}: a value of the type {type(value).__name__} cannot be converted to a term"
        )

    def _warn_without_parameters(self, name: str) -> object:
        self._reports.warning(
            f"ros_param: there is no parameter {name}: parameters are read only in a node: use --answers FILE, or "
            "the key parameters of a test case"
        )
        raise KeyError(name)
