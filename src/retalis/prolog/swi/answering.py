"""What SWI-Prolog calls to ask back, in a way that a signal's handler may raise what it likes meanwhile.

An exception must not get out of a function that C has called: it would be forgotten, and C go on with an answer that
nobody has given. A signal that has come while SWI-Prolog ran is handled where code in Python begins, which is before
any ``try`` of a function. In a generator that goes on it is inside one. So generators that wait are kept ready, and
C calls what gets one of them without any code in Python.
"""

from contextlib import suppress
from operator import methodcaller
from typing import Any, Callable, Generator, List, Mapping, Protocol

_READY = 64
"""Generators that wait: as many threads may ask before one of them goes on."""

_Waiting = Generator[int, int, None]


class AskedBack(Protocol):
    """Whose program SWI-Prolog's clauses may ask."""

    def answer(self, ref: int) -> bool:
        """Have a variable be the list of a goal's solutions; tell whether it is."""

    def fail(self, error: BaseException) -> None:
        """Have the goal that asks end with an error."""


class Answerers(List[Callable[[int], int]]):
    """Called with a reference, it has one of its items answer.

    Args:
        asked: by the numbers of SWI-Prolog's engines.
        number: returns that of the engine that asks.
        refuse: has a goal end that belongs to no program.
    """

    __call__ = property(methodcaller("pop"))  # what it returns is called then

    def __init__(
        self, asked: Mapping[int, AskedBack], number: Callable[[], int], refuse: Callable[[], object]
    ):
        super().__init__()
        self._asked = asked
        self._number = number
        self._refuse = refuse
        self._over: List[_Waiting] = []
        self.fill()

    def fill(self) -> None:
        """Have enough ready."""
        with suppress(IndexError):  # no more, or taken by another thread
            while True:
                one: Any = self._over.pop()
                if one.gi_running:  # in another thread, for a moment
                    self._over.append(one)
                    break
                one.close()
        while len(self) < _READY:
            found: List[_Waiting] = []
            found.append(self._answering(found))
            next(found[0])
            self.append(found[0].send)

    def _answering(self, found: List[_Waiting]) -> _Waiting:
        """Wait for a reference, answer, and wait to be closed: else that would be done in Python as C goes on.

        Args:
            found: this generator.
        """
        asked: Any = None
        told, over = 0, False
        try:
            ref = yield 0
            self.fill()
            asked = self._asked.get(self._number())
            if asked is None:
                self._refuse()
            else:
                told = int(asked.answer(ref))
            self._over += found
            over = True  # nothing is called from here on: Python looks for signals behind calls
            yield told
        except GeneratorExit:
            return
        except BaseException as error:  # whatever it is: C waits
            if over:  # it does not: who closes this waits
                raise
            self._over += found
            asked = self._asked.get(self._number())
            if asked is not None:
                asked.fail(error)
            yield 0
        finally:
            del found[:]
