"""What a program may learn of the process it runs in."""

from ..machine import permission_error
from ..terms import Term, atom, unify
from .program import Machine
from .registry import deterministic
from .text import text_of


@deterministic("getenv/2")
def getenv(machine: Machine, name: Term, value: Term) -> bool:
    """Give the value of an environment variable, where the program may know it."""
    wanted = text_of(name)
    environment = machine.logic.environment
    if environment is None:
        raise permission_error(
            "access", "environment_variable", atom(wanted), "the setting allow_foreign is off"
        )
    return wanted in environment and unify(value, atom(environment[wanted]), machine.trail)
