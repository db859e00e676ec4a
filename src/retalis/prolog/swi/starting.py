"""The start of SWI-Prolog in this process, once for all programs."""

from functools import lru_cache, partial
from pathlib import Path
from threading import Lock
from typing import Any, List, MutableMapping, NamedTuple, Tuple
from weakref import WeakValueDictionary

from ...foundation import UsageError
from ..terms import SLASH, Var, atom, functor
from .answering import Answerers, AskedBack
from .binding import Answering, SwiLibrary, find_library
from .interrupter import Interrupter
from .signalstack import steps_of_keeping
from .values import SwiTerms

BRIDGE = "retalis_bridge"
_FILE = Path(__file__).resolve().parent / "bridge.pl"
"""What is loaded into SWI-Prolog at its start."""

_LOCK = Lock()


class Started(NamedTuple):
    """SWI-Prolog as it runs in this process.

    Attributes:
        swi: its functions.
        interrupter: ends goals that are past a limit.
        engines: by their numbers.
        callbacks: what it calls of ours; they must not be forgotten.
    """

    swi: SwiLibrary
    interrupter: Interrupter
    engines: "MutableMapping[int, Any]"
    callbacks: object


def start() -> Started:
    """Return SWI-Prolog, started if need be.

    Raises:
        UsageError: where it is not installed, or does not start.
    """
    with _LOCK:
        return _started()


@lru_cache(maxsize=1)
def _started() -> Started:
    swi = find_library()
    swi.start()
    engines: MutableMapping[int, AskedBack] = WeakValueDictionary()

    answerers: Any = Answerers(engines, swi.thread_self, partial(_refuse, swi))
    callbacks: List[Tuple[str, int, Any]] = [("$retalis_ask", 1, Answering(answerers))]
    callbacks += [(name, 0, step) for name, step in steps_of_keeping()]
    for name, arity, callback in callbacks:
        swi.register(BRIDGE.encode(), name.encode(), arity, callback, 0)
    ref = swi.new_refs(1)
    SwiTerms(swi).put(ref, atom(str(_FILE)), {})
    if not swi.call_predicate(None, 0, swi.predicate(b"consult", 1, b"user"), ref):
        raise UsageError(f"SWI-Prolog does not load {_FILE}")
    swi.leave()
    return Started(swi, Interrupter(swi), engines, callbacks)


def _refuse(swi: SwiLibrary) -> None:
    """Throw the error for a thread of SWI-Prolog's own, which belongs to no program."""
    ref = swi.new_refs(1)
    what = (functor("existence_error", 2), atom("retalis_engine"), (SLASH, atom("retalis"), 1))
    SwiTerms(swi).put(ref, (functor("error", 2), what, Var()), {})
    swi.raise_exception(ref)
