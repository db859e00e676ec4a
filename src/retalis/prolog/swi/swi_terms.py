"""What SWI-Prolog and this package know each other's atoms and functors by.

Compound terms of SWI-Prolog's that are being read, part by part.

Terms as SWI-Prolog has them, and back: part by part, never as text.
"""

from ctypes import byref, c_double, c_int, c_int64, c_size_t, c_void_p, string_at
from typing import Any, Callable, Dict, List, Optional, Tuple

from ...foundation.bounded_caches import Cache
from ...foundation.cancellation import BULK, look
from ...foundation.errors import TermTooLarge, beginning
from ..machine.errors import representation_error, resource_error
from ..syntax.literals import integer
from ..terms.list_terms import make_list
from ..terms.term_traversal import MAX_STEPS
from ..terms.types import CONS, NIL, Atom, Functor, String, Term, Var, atom, deref, functor
from .libswipl import ATOM_TEXT, INTEGER_TEXT, STRING_TEXT, SwiLibrary


class Handles(Cache[Any, int]):
    """What SWI-Prolog knows our atoms and functors by; it keeps them as long as they are held here."""

    __slots__ = ("let_go",)

    def __init__(self, let_go: Callable[[int], object]):
        super().__init__(4096, 1 << 20)
        self.let_go = let_go

    def clear(self) -> None:
        """Forget all."""
        while self:
            _, handle = self.popitem()  # first: what is found in it must be there
            self.let_go(handle)
        super().clear()


class HeldHandles(Cache[int, Any]):
    """The other way: our atoms and functors by what SWI-Prolog knows them by."""

    __slots__ = ("let_go",)

    def __init__(self, let_go: Callable[[int], object]):
        super().__init__(4096, 1 << 20)
        self.let_go = let_go

    def clear(self) -> None:
        """Forget all."""
        while self:
            handle, _ = self.popitem()
            self.let_go(handle)
        super().clear()


def kept(handle: int) -> None:
    """Let a functor go: SWI-Prolog keeps those for ever."""


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


_MASK = len(BULK) - 1
_LEAST, _LARGEST = -(1 << 63), (1 << 63) - 1
_MARK = "$retalis_variable"

Refs = Dict[Var, int]
"""Where variables of ours stand in SWI-Prolog."""

Bindings = List[Tuple[Var, Term]]
"""What a solution makes of variables."""


class SwiTerms:
    """Makes terms of SWI-Prolog of ours, and the other way; one thread uses it at a time, with an engine."""

    def __init__(self, swi: SwiLibrary):
        self._swi = swi
        self._handles = Handles(swi.unregister_atom)
        self._functors = Handles(kept)
        self._atoms = HeldHandles(swi.unregister_atom)
        self._names = HeldHandles(kept)
        self._puts: Dict[type, Callable[[int, Any], int]] = {
            int: self._put_integer,
            float: swi.unify_float,
            Atom: self._put_atom,
            String: self._put_string,
        }
        kinds = swi.kinds
        self._variable, self._compound, self._pair = (
            kinds["variable"],
            kinds["compound"],
            kinds["pair"],
        )
        self._reads: Dict[int, Callable[[int], Term]] = {
            kinds["atom"]: self._read_atom,
            kinds["integer"]: self._read_integer,
            kinds["float"]: self._read_float,
            kinds["string"]: self._read_string,
            kinds["nil"]: lambda ref: NIL,
        }
        self._word, self._long, self._double = c_size_t(), c_int64(), c_double()
        self._length, self._place, self._arity = c_size_t(), c_void_p(), c_int()
        self._to_word, self._to_long, self._to_double = (
            byref(self._word),
            byref(self._long),
            byref(self._double),
        )
        self._to_length, self._to_place = byref(self._length), byref(self._place)
        self._to_arity = byref(self._arity)
        self._mark = swi.new_functor(self.handle(atom(_MARK)), 1)
        self._marked: List[Var] = []
        self._lenient = False

    def let_go(self) -> None:
        """Hold no atoms any more."""
        self._handles.clear()
        self._atoms.clear()

    # Ours to SWI-Prolog's

    def put(self, ref: int, term: Term, refs: Refs) -> None:
        """Have a new variable of SWI-Prolog's be a term.

        Args:
            ref: the variable.
            term: the term.
            refs: of the variables that have been put already; those of the term are added.

        Raises:
            PrologError: where it has no room for the term, or no such term.
        """
        term = deref(term)
        put = self._puts.get(term.__class__)
        if put is not None:
            require(put(ref, term))
        elif term.__class__ is Var:
            self._put_variable(ref, term, refs)
        else:
            self._put_large(ref, term, refs)

    def _put_variable(self, ref: int, var: Var, refs: Refs) -> None:
        known = refs.setdefault(var, ref)
        if known != ref:
            require(self._swi.unify(ref, known))

    def _put_large(self, ref: int, whole: Term, refs: Refs) -> None:
        """Put what may have parts: from the outside in, so that no depth is too much."""
        swi, puts = self._swi, self._puts
        stack = [(ref, whole)]
        steps = 0
        while stack:
            ref, term = stack.pop()
            steps += 1
            if not steps & _MASK:
                look()
                if steps > MAX_STEPS:
                    raise TermTooLarge
            term = deref(term)
            put = puts.get(term.__class__)
            if put is not None:
                require(put(ref, term))
            elif term.__class__ is Var:
                self._put_variable(ref, term, refs)
            elif term.__class__ is tuple:
                count = len(term) - 1
                first = require(swi.new_refs(count))
                if term[0] is CONS:
                    require(swi.unify_list(ref, first, first + 1))
                else:
                    require(swi.unify_functor(ref, self._functor_handle(term[0])))
                    for number in range(count):
                        swi.get_argument(number + 1, ref, first + number)
                stack += [(first + number, term[number + 1]) for number in range(count - 1, -1, -1)]
            elif isinstance(term, int):
                require(self._put_integer(ref, int(term)))
            else:
                raise representation_error("term", f"SWI-Prolog has no {type(term).__name__}")

    def _put_integer(self, ref: int, value: int) -> int:
        if _LEAST <= value <= _LARGEST:
            return self._swi.unify_integer(ref, value)  # type: ignore[no-any-return]
        read = require(self._swi.new_refs(1))
        require(self._swi.read_text(hex(value).encode(), read))
        return self._swi.unify(ref, read)  # type: ignore[no-any-return]

    def _put_atom(self, ref: int, value: Atom) -> int:
        if value is NIL:
            return self._swi.unify_nil(ref)  # type: ignore[no-any-return]
        handle = self._handles.get(value)
        if handle is not None:
            return self._swi.unify_atom(ref, handle)  # type: ignore[no-any-return]
        text = _encoded(value.name)
        done: int = self._swi.unify_text(ref, self._swi.atom | self._swi.utf8, len(text), text)
        if done and self._swi.get_atom(ref, self._to_word):
            self._keep(self._handles, value, self._word.value, len(text))
        return done

    def _put_string(self, ref: int, value: String) -> int:
        text = _encoded(value.text)
        swi = self._swi
        return swi.unify_text(ref, swi.kinds["string"] | swi.utf8, len(text), text)  # type: ignore[no-any-return]

    def _keep(self, cache: Handles, key: Any, handle: int, size: int) -> None:
        self._swi.register_atom(handle)  # first: what is found in it must be there
        cache.keep(key, handle, size)
        if key not in cache:
            self._swi.unregister_atom(handle)

    def _functor_handle(self, key: Functor) -> int:
        handle = self._functors.get(key)
        if handle is None:
            handle = self._swi.new_functor(self.handle(atom(key.name)), key.arity)
            self._functors.keep(key, handle, len(key.name))
        return handle

    def handle(self, value: Atom) -> int:
        """Return what SWI-Prolog knows an atom by, which a term has to hold, or the cache."""
        ref = require(self._swi.new_refs(1))
        if value is NIL:  # as a functor it is a name like others
            require(self._swi.unify_text(ref, self._swi.atom | self._swi.utf8, 2, b"[]"))
        else:
            require(self._put_atom(ref, value))
        require(self._swi.get_atom(ref, self._to_word))
        return self._word.value

    # SWI-Prolog's to ours

    # Variables of SWI-Prolog's are bound to marks meanwhile: who reads takes that back, by going on with the query
    # or by discarding a frame.

    def begin(self, lenient: bool = False) -> None:
        """Begin to read: variables are the same in all that is read until the next `begin`.

        Args:
            lenient: whether what has no term here is read as text.
        """
        self._marked = []
        self._lenient = lenient

    def read_values(self, refs: Refs) -> Bindings:
        """Return what variables of ours have become; without those that are still variables, and none seen before."""
        reads, kind_of, variable = self._reads, self._swi.term_type, self._variable
        self._marked = []
        self._lenient = False
        found = []
        for var, ref in refs.items():
            kind = kind_of(ref)
            read = reads.get(kind)
            if read is not None:
                found.append((var, read(ref)))
            elif kind == variable:
                self._note(ref, var)
            else:
                found.append((var, self._read_other(ref, kind)))
        return found

    def read(self, ref: int) -> Term:
        """Return a term.

        Raises:
            PrologError: for what is no term here: rational numbers, streams and other handles, terms without
                arguments, variables with constraints.
            TermTooLarge: where it contains itself.
        """
        kind = self._swi.term_type(ref)
        read = self._reads.get(kind)
        if read is not None:
            return read(ref)
        return self._note(ref, Var()) if kind == self._variable else self._read_other(ref, kind)

    def _read_other(self, ref: int, kind: int) -> Term:
        """Return a term that is neither a constant nor a variable."""
        if kind not in (self._compound, self._pair):
            return self._other(ref, kind)
        if not self._swi.is_acyclic(ref):
            raise TermTooLarge
        return self._read_large(ref, kind)

    def _note(self, ref: int, var: Var) -> Var:
        swi = self._swi
        if swi.is_attributed(ref):
            if not self._lenient:
                raise representation_error(
                    "constraint",
                    "a variable of the answer has constraints in SWI-Prolog: label it there first",
                )
            return var
        inner = require(swi.new_refs(1))
        require(swi.unify_functor(ref, self._mark) and swi.get_argument(1, ref, inner))
        require(swi.unify_integer(inner, len(self._marked)))
        self._marked.append(var)
        return var

    def _read_large(self, ref: int, kind: int) -> Term:
        stack: List[TermParts] = []
        top = self._parts(ref, kind)
        steps = 0
        while True:
            steps += 1
            if not steps & _MASK:
                look()
                if steps > MAX_STEPS:
                    raise TermTooLarge
            part = top.following()
            if part is None:
                made = top.made()
                if not stack:
                    return made
                top = stack.pop()
                top.values.append(made)
                continue
            kind = self._swi.term_type(part)
            read = self._reads.get(kind)
            if read is not None:
                top.values.append(read(part))
            elif kind in (self._compound, self._pair):
                stack.append(top)
                top = self._parts(part, kind)
            else:
                top.values.append(
                    self._note(part, Var()) if kind == self._variable else self._other(part, kind)
                )

    def _parts(self, ref: int, kind: int) -> "TermParts":
        """Return the parts of a list or another compound term, to be read."""
        swi = self._swi
        if kind == self._pair:
            items = require(swi.new_refs(2))
            swi.copy_ref(items + 1, ref)
            found = ListParts(swi, items)
            found.pending = self._read_constants(items, found.values)
            return found
        swi.get_functor(ref, self._to_word)
        handle = self._word.value
        argument = require(swi.new_refs(1))
        if handle == self._mark:
            swi.get_argument(1, ref, argument)
            swi.get_integer(argument, self._to_long)
            return SeenVariable(self._marked[self._long.value])
        key = self._names.get(handle)
        if key is None:
            key = self._named(ref)
            self._names.keep(handle, key, len(key.name))
        return ArgumentParts(swi, ref, argument, key)

    def _read_constants(self, item: int, values: List[Term]) -> bool:
        """Read the items with which a list begins as long as they are constants; tell whether another one follows."""
        reads, kind_of, get_list = self._reads, self._swi.term_type, self._swi.get_list
        tail = item + 1
        while len(values) <= MAX_STEPS:
            for _ in BULK:
                if not get_list(tail, item, tail):
                    return False
                read = reads.get(kind_of(item))
                if read is None:
                    return True
                values.append(read(item))
            look()
        raise TermTooLarge

    def _named(self, ref: int) -> Functor:
        self._swi.get_name(ref, self._to_word, self._to_arity)
        handle, arity = self._word.value, self._arity.value
        if not arity:
            raise representation_error("arity", "a term without arguments, as f(), is none here")
        return functor(self._name(handle), arity)

    def _name(self, handle: int) -> str:
        ref = require(self._swi.new_refs(1))
        self._swi.unify_atom(ref, handle)
        return self._text(ref, ATOM_TEXT)

    def _read_atom(self, ref: int) -> Term:
        self._swi.get_atom(ref, self._to_word)
        handle = self._word.value
        known: Optional[Atom] = self._atoms.get(handle)
        if known is not None:
            return known
        made = atom(self._text(ref, ATOM_TEXT))
        self._swi.register_atom(handle)
        self._atoms.keep(handle, made, len(made.name))
        if handle not in self._atoms:
            self._swi.unregister_atom(handle)
        return made

    def _read_integer(self, ref: int) -> Term:
        if self._swi.get_integer(ref, self._to_long):
            return self._long.value
        try:
            return integer(self._text(ref, INTEGER_TEXT))
        except ValueError:
            raise TermTooLarge from None

    def _read_float(self, ref: int) -> Term:
        self._swi.get_float(ref, self._to_double)
        return self._double.value

    def _read_string(self, ref: int) -> Term:
        return String(self._text(ref, STRING_TEXT))

    def _text(self, ref: int, flags: int) -> str:
        if not self._swi.get_text(ref, self._to_length, self._to_place, flags | self._swi.utf8):
            raise resource_error("memory")
        return string_at(self._place.value or 0, self._length.value).decode("utf-8", "surrogatepass")

    def _other(self, ref: int, kind: int) -> Term:
        """Return what stands for something that is no term here, or raise what says so."""
        if self._lenient:
            return atom(self._text(ref, self._swi.written))
        names = {self._swi.kinds["rational"]: "a rational number", self._swi.kinds["dict"]: "a dict"}
        what = names.get(kind, "a stream, a clause or another handle")
        text = beginning(self._text(ref, self._swi.written))
        raise representation_error("term", f"{what} of SWI-Prolog is no term here: {text}")


def _encoded(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass")
