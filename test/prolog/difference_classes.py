"""Classes of differences from SWI-Prolog by goal and answers; docs/explanation/compatibility.md explains them."""

import re
from typing import Callable, List, NamedTuple, Optional

_LACKING = "succ|plus|cot|acot|log2|log|max_tagged_integer|min_tagged_integer|max_integer|min_integer|rdiv"


class Reason(NamedTuple):
    """A class of differences.

    Attributes:
        name: its name in docs/explanation/compatibility.md.
        applies: returns whether a difference belongs to the class, for the goal, our answer and SWI-Prolog's.
    """

    name: str
    applies: Callable[[str, str, str], bool]


def _goal(pattern: str) -> Callable[[str, str, str], bool]:
    expression = re.compile(pattern)
    return lambda goal, ours, theirs: expression.search(goal) is not None


def _theirs(pattern: str) -> Callable[[str, str, str], bool]:
    expression = re.compile(pattern)
    return lambda goal, ours, theirs: expression.search(theirs) is not None


def _ours(pattern: str) -> Callable[[str, str, str], bool]:
    expression = re.compile(pattern)
    return lambda goal, ours, theirs: expression.search(ours) is not None


def _printed(goal: str, ours: str, theirs: str) -> bool:
    return ours.startswith("error(") and theirs.partition(" printed ")[0] == ours.partition(" printed ")[0]


def _contexts(goal: str, ours: str, theirs: str) -> bool:
    return "context(" in ours and "context(" in theirs


def _cut_short(goal: str, ours: str, theirs: str) -> bool:
    return "limit" in (ours, theirs) or theirs == "lost" or "cyclic" in ours + theirs


REASONS: List[Reason] = [
    Reason("function", _theirs(rf"type_error\(evaluable,/\(({_LACKING}),")),
    Reason(
        "predicate", _theirs(r"existence_error\(procedure,/\((text_concat|subseq|ord_insert|\^|sformat|foo),")
    ),
    Reason("setarg", _goal(r"^(nb_)?setarg")),
    Reason("hash", _goal(r"^term_hash")),
    Reason("consult", _ours(r"existence_error\(procedure,/\('\[\|\]',")),
    Reason("empty list", _goal(r"\[\]|'\[\]'|\"\"")),
    Reason("logarithm of 0", lambda goal, ours, theirs: "undefined" in ours and "float_overflow" in theirs),
    Reason("libm", _goal(r"lgamma|erf")),
    Reason("float power", _goal(r"\^|\*\*")),
    Reason("infinity", _goal(r"inf|nan|atanh|nexttoward")),
    Reason("context", _contexts),
    Reason("printed", _printed),
    Reason("limits", _cut_short),
    Reason(
        "flags and operators",
        _goal(r"^(current_op|op|flag|current_prolog_flag|current_predicate|nb_current)\b"),
    ),
    Reason("types", _goal(r"^(must_be|is_of_type)\b")),
    Reason("library", _theirs(r"static_procedure,:\(")),
    Reason("declarations", _goal(r"^(dynamic|discontiguous)\b")),
    Reason("dates", _goal(r"^(format_time|stamp_date_time|date_time_|parse_time|day_of_the_week)")),
    Reason("characters", _goal(r"^(char_type|code_type)\b")),
    Reason("reading", _goal(r"^(term_to_atom|term_string|atom_to_term|read_term_from_atom|atom_number)\b")),
    Reason("cleanup", _goal(r"cleanup")),
    Reason("bodies", _goal(r"^(ignore|once|phrase|forall|call|findall|'[,;]'|'\*?->')")),
    Reason("association lists", _goal(r"assoc")),
    Reason("ordered sets", _goal(r"^ord_")),
    Reason("write options", _goal(r"^(write_term|portray_clause|write|print)")),
    Reason(
        "order of checks",
        lambda goal, ours, theirs: ours.startswith("error(") and theirs.startswith("error("),
    ),
]


def reason(goal: str, ours: str, theirs: str) -> Optional[str]:
    """Return the name of the first class of a difference, or None if it belongs to none."""
    return next((difference.name for difference in REASONS if difference.applies(goal, ours, theirs)), None)
