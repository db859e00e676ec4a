"""The start of SWI-Prolog in this process, once for all programs."""

from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any, MutableMapping, NamedTuple, Protocol
from weakref import WeakValueDictionary

from ...foundation import UsageError
from ..terms import SLASH, Var, atom, functor
from .binding import Answering, SwiLibrary, find_library
from .interrupter import Interrupter
from .values import SwiTerms

BRIDGE = "retalis_bridge"
_FILE = Path(__file__).resolve().parent / "bridge.pl"
"""What is loaded into SWI-Prolog at its start."""

_LOCK = Lock()


class AskedBack(Protocol):
    """Whose program SWI-Prolog's clauses may ask."""

    def answer(self, goal_ref: int, ref: int) -> bool:
        """Have a variable be the list of a goal's solutions; tell whether it is."""


class Started(NamedTuple):
    """SWI-Prolog as it runs in this process.

    Attributes:
        swi: its functions.
        interrupter: ends goals that are past a limit.
        engines: by their numbers.
        callback: what it asks back by; it must not be forgotten.
    """

    swi: SwiLibrary
    interrupter: Interrupter
    engines: "MutableMapping[int, Any]"
    callback: object


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

    def answer(goal_ref: int, ref: int) -> int:
        asked = engines.get(swi.thread_self())
        if asked is None:
            return _refuse(swi)
        return int(asked.answer(goal_ref, ref))

    callback = Answering(answer)
    swi.register(BRIDGE.encode(), b"$retalis_ask", 2, callback, 0)
    ref = swi.new_refs(1)
    SwiTerms(swi).put(ref, atom(str(_FILE)), {})
    if not swi.call_predicate(None, 0, swi.predicate(b"consult", 1, b"user"), ref):
        raise UsageError(f"SWI-Prolog does not load {_FILE}")
    swi.leave()
    return Started(swi, Interrupter(swi), engines, callback)


def _refuse(swi: SwiLibrary) -> int:
    """Throw the error for a thread of SWI-Prolog's own, which belongs to no program."""
    ref = swi.new_refs(1)
    what = (functor("existence_error", 2), atom("retalis_engine"), (SLASH, atom("retalis"), 1))
    SwiTerms(swi).put(ref, (functor("error", 2), what, Var()), {})
    swi.raise_exception(ref)
    return 0
