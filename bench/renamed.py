"""The NAO's program and messages with other message types, functors and slot orders."""

from typing import Dict, List, Tuple

import retalis.events.language.event_operators  # noqa: F401 -- adds its operators to those of Prolog
from retalis import Operators, Term, deref, functor
from retalis.prolog.syntax.term_reader import read_program
from retalis.prolog.syntax.term_writer import write_term

NAMES: Dict[Tuple[str, int], Tuple[str, Tuple[int, ...]]] = {
    ("tf__0__tfMessage", 1): ("robot__0__Links", (1,)),
    ("geometry_msgs__0__TransformStamped", 3): ("robot__0__Link", (3, 1, 2)),
    ("geometry_msgs__0__Transform", 2): ("robot__0__Offset", (2, 1)),
    ("geometry_msgs__0__Vector3", 3): ("robot__0__Step", (3, 2, 1)),
    ("geometry_msgs__0__Quaternion", 4): ("robot__0__Turn", (4, 1, 2, 3)),
    ("ar_pose__0__ARMarkers", 2): ("shop__0__Tags", (2, 1)),
    ("ar_pose__0__ARMarker", 4): ("shop__0__Tag", (4, 3, 2, 1)),
    ("geometry_msgs__0__PoseWithCovariance", 2): ("shop__0__Guess", (2, 1)),
    ("geometry_msgs__0__Pose", 2): ("shop__0__Place", (2, 1)),
    ("geometry_msgs__0__Point", 3): ("shop__0__Spot", (2, 3, 1)),
    ("geometry_msgs__0__PoseStamped", 2): ("shop__0__Found", (2, 1)),
    ("std_msgs__0__Header", 3): ("shop__0__Top", (3, 1, 2)),
    ("tf", 4): ("edge", (4, 2, 1, 3)),
    ("tf", 2): ("offset", (2, 1)),
    ("ar_marker", 5): ("sighting", (5, 3, 2, 1, 4)),
}
"""New name by functor, and the old position of each new argument."""


def renamed(term: Term) -> Term:
    """Return a term with other names and orders of arguments."""
    term = deref(term)
    if term.__class__ is not tuple:
        return term
    return make_renamed(term[0].name, *map(renamed, term[1:]))


def make_renamed(name: str, *arguments: Term) -> Term:
    """Return a compound term with the other name and argument order."""
    found = NAMES.get((name, len(arguments)))
    if found is None:
        return functor(name, len(arguments))(*arguments)
    name, order = found
    return functor(name, len(order))(*[arguments[at - 1] for at in order])


def renamed_program(text: str) -> List[str]:
    """Return the clauses of a program with other names, as texts without full stop."""
    operators = Operators.prolog()
    return [
        write_term(
            renamed(read.term), operators, variable_names={var: name for name, var in read.names.items()}
        )
        for read in read_program(text, operators)
    ]
