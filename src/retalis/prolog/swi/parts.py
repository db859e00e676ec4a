"""Compound terms of SWI-Prolog's that are being read, part by part."""

from typing import List, Optional

from ..machine import resource_error
from ..terms import Functor, Term, Var, make_list
from .binding import SwiLibrary


class TermParts:
    """What is being read of a compound term.

    Attributes:
        values: of the parts that have been read.
    """

    __slots__ = ("values",)

    def __init__(self) -> None:
        self.values: List[Term] = []

    def following(self) -> Optional[int]:
        """Return where the next part is, or None after the last."""
        raise NotImplementedError

    def made(self) -> Term:
        """Return the term of all parts."""
        raise NotImplementedError


class ListParts(TermParts):
    """A list, whose tail is read as what follows the last item.

    Attributes:
        pending: whether an item has been taken off it that is to be read.
    """

    __slots__ = ("_swi", "_item", "_ended", "pending")

    def __init__(self, swi: SwiLibrary, item: int):
        super().__init__()
        self._swi = swi
        self._item = item
        self._ended = False
        self.pending = False

    def following(self) -> Optional[int]:
        """Return where the next part is, see `TermParts`."""
        item = self._item
        if self._ended:
            return None
        if self.pending:
            self.pending = False
            return item
        if self._swi.get_list(item + 1, item, item + 1):
            return item
        self._ended = True
        return item + 1

    def made(self) -> Term:
        """Return the term of all parts, see `TermParts`."""
        return make_list(self.values[:-1], self.values[-1])


class ArgumentParts(TermParts):
    """Another compound term."""

    __slots__ = ("_swi", "_ref", "_argument", "_key")

    def __init__(self, swi: SwiLibrary, ref: int, argument: int, key: Functor):
        super().__init__()
        self._swi = swi
        self._ref = ref
        self._argument = argument
        self._key = key

    def following(self) -> Optional[int]:
        """Return where the next part is, see `TermParts`."""
        number = len(self.values) + 1
        if number > self._key.arity:
            return None
        self._swi.get_argument(number, self._ref, self._argument)
        return self._argument

    def made(self) -> Term:
        """Return the term of all parts, see `TermParts`."""
        return (self._key, *self.values)


class SeenVariable(TermParts):
    """A variable that has been read before."""

    __slots__ = ("_var",)

    def __init__(self, var: Var):
        super().__init__()
        self._var = var

    def following(self) -> Optional[int]:
        """Return where the next part is, see `TermParts`."""
        return None

    def made(self) -> Term:
        """Return the term of all parts, see `TermParts`."""
        return self._var


def require(done: int) -> int:
    """Return what a function has returned: 0 means that there is no room."""
    if not done:
        raise resource_error("memory")
    return done
