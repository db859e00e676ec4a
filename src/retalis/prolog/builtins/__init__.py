"""Built-in predicates by theme; importing this package registers all of them."""

from . import (  # noqa: F401  (imported for what they register)
    assoc,
    atoms,
    calling,
    chance,
    checking,
    clauses,
    cleanup,
    comparing,
    coroutines,
    datimes,
    directives,
    filenames,
    input,
    lambdas,
    lists,
    modules,
    numbering,
    output,
    poses,
    putting,
    reading,
    recorded,
    reports,
    sets,
    singlesided,
    solutions,
    state,
    streamproperties,
    strings,
    surroundings,
    tabled,
    taking_apart,
    testing,
    timing,
)
from .arguments import callable_of, integer
from .datimes import instant_of
from .dcg import translate_rule
from .poses import Pose, compose, interpolate, pose, pose_of, shown_pose
from .program import StreamFiles
from .recorded import records_of
from .registry import ENTRIES, control
from .singlesided import SINGLE_SIDED, is_behind, translate_single_sided
from .state import default_flags, flags_from
from .streams import end_captures
from .tabled import declare_as
from .tabling import tables_of

__all__ = [
    "callable_of",
    "compose",
    "control",
    "declare_as",
    "is_behind",
    "SINGLE_SIDED",
    "translate_single_sided",
    "default_flags",
    "flags_from",
    "end_captures",
    "ENTRIES",
    "instant_of",
    "integer",
    "interpolate",
    "Pose",
    "pose",
    "pose_of",
    "records_of",
    "shown_pose",
    "StreamFiles",
    "tables_of",
    "translate_rule",
]
