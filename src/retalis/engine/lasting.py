"""What an engine knows, kept as data and taken up again."""

from pathlib import Path
from typing import Dict, List, Optional, Tuple, Type, TypeVar

from ..messages import Definitions
from ..prolog.foreign import define_foreign
from ..prolog.terms import Functor
from .holdings import Holdings
from .keeping import pack, read_records, unpack
from .ownfiles import REQUEST
from .runtime import Clock, Reports
from .settings import Settings
from .states import StateKeeper, checked, clock_for, coded, decoded

Made = TypeVar("Made", bound="Lasting")


class Lasting(Holdings):
    """What an engine lets others do with its state; see `Engine`."""

    def snapshot(self) -> bytes:
        """Return all that the engine knows and that waits in it, as bytes: see docs/state.md.

        >>> engine = Engine()
        >>> engine.load(rules="alarm(X) <- smoke(X) seq heat(X).")
        >>> engine.event("smoke(kitchen)", 1)
        >>> other = Engine.restore(engine.snapshot())
        >>> other.on_event(lambda term, start, end: print(other.show(term), end))
        >>> other.event("heat(kitchen)", 2)
        heat(kitchen) 2000000000
        alarm(kitchen) 2000000000

        Raises:
            UsageError: where a goal or callback of this engine calls it.
        """

        def work() -> Dict[str, bytes]:
            # To bytes while nothing else is done: what is asked binds variables of rules for a while.
            keeper = StateKeeper(self)
            return coded(keeper.take(), keeper.records())

        return pack(self._runner.call(lambda: self._dispatcher.undisturbed(work), (REQUEST,)))

    @classmethod
    def restore(
        cls: Type[Made],
        data: bytes,
        clock: Optional[Clock] = None,
        settings: Optional[Settings] = None,
        reports: Optional[Reports] = None,
        definitions: Optional[Definitions] = None,
        foreign: Tuple[object, ...] = (),
        folder: Optional[Path] = None,
    ) -> Made:
        """Return a new engine that goes on where the one was whose `snapshot` this is.

        It has the program, memories, partial matches, waiting queries, alarms and counters. Callbacks have to be
        given again, as all that is not of the program.

        >>> engine = Engine()
        >>> engine.load(goals="memorize(fire(_), [], _, fires, 10)")
        >>> engine.event("fire(hall)", 1)
        >>> Engine.restore(engine.snapshot()).query("memory_size(fires, N), memory_counter(fires, C)")
        [{'N': 10, 'C': 1}]

        Args:
            data: from `snapshot`.
            clock: as for a new engine; by default one that goes on from the instant of the other's.
            settings: as for a new engine; they are not part of the state.
            reports: as for a new engine.
            definitions: as for a new engine.
            foreign: what `add_foreign` was given.
            folder: the program's, from which Python modules may be loaded again that it had asked for.

        Raises:
            UsageError: for what is no state, is damaged, or comes from another version.
        """
        found = checked(lambda: unpack(data))
        sections = checked(lambda: decoded(found))

        def work() -> Made:
            engine = cls(clock or clock_for(sections["run"]), settings, reports, definitions)
            if foreign:
                engine.add_foreign(*foreign)
            records = [[read_records(data)] for name, data in found.items() if name.startswith("memory ")]
            StateKeeper(engine).take_up(sections, records, folder)
            return engine

        return checked(work)

    def add_foreign(self, *sources: object) -> List[Functor]:
        """Define Python functions that have the decorator `foreign`, and those of modules, as predicates.

        >>> @foreign
        ... def half(number: int) -> float:
        ...     return number / 2
        >>> Engine().add_foreign(half)
        [functor('half', 2)]

        Returns:
            The functors of the predicates.

        Raises:
            UsageError: for a function without the decorator, or a module in which none has it.
            PrologError: where a predicate of the system has that name.
        """
        found = self._runner.call(lambda: define_foreign(self._logic, self._runner, *sources))
        self._foreign.append(sources)
        return found
