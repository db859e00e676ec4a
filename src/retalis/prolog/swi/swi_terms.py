"""Conversion of terms between this package and SWI-Prolog through term references, without text.

Terms are converted iteratively with an explicit stack, so their depth is not limited by recursion. Atoms and functors
are mapped to SWI-Prolog's handles by bounded caches. An atom handle is registered with SWI-Prolog while a cache holds
it, since SWI-Prolog frees unreferenced atoms.

While a term is read, each of its variables is bound to a mark ``'$retalis_variable'(N)``, by which further
occurrences of the variable are recognised. The caller undoes the marks by discarding a frame.
"""

from ctypes import byref, c_double, c_int, c_int64, c_size_t, c_void_p, string_at
from typing import Any, Callable, Dict, List, Optional, Tuple

from ...foundation.bounded_caches import Cache
from ...foundation.displayed_text import shorten
from ...foundation.errors import TermTooLarge
from ...foundation.limit_checks import STEPS_PER_ROUND, check_limits
from ..machine.errors import representation_error, resource_error
from ..syntax.literals import integer
from ..terms.list_terms import make_list
from ..terms.term_traversal import MAX_STEPS, check_steps
from ..terms.types import CONS, NIL, Atom, Functor, String, Term, Var, atom, deref, functor
from .libswipl import ATOM_TEXT, INTEGER_TEXT, STRING_TEXT, SwiLibrary


class HandlesByTerm(Cache[Any, int]):
    """Cache of SWI-Prolog's handles by atoms or functors of this package; it releases the handles that it drops."""

    __slots__ = ("release",)

    def __init__(self, release: Callable[[int], object]):
        super().__init__(4096, 1 << 20)
        self.release = release

    def clear(self) -> None:
        """Remove all entries."""
        while self:
            # The entry is removed before its handle is released: every entry must have a valid handle, also if an
            # exception of a signal handler comes in between.
            _, handle = self.popitem()
            self.release(handle)
        super().clear()


class TermsByHandle(Cache[int, Any]):
    """Cache of atoms or functors of this package by SWI-Prolog's handles; it releases the handles that it drops."""

    __slots__ = ("release",)

    def __init__(self, release: Callable[[int], object]):
        super().__init__(4096, 1 << 20)
        self.release = release

    def clear(self) -> None:
        """Remove all entries."""
        while self:
            handle, _ = self.popitem()
            self.release(handle)
        super().clear()


def release_nothing(handle: int) -> None:
    """Do nothing to release a functor handle: SWI-Prolog never frees functors."""


class TermParts:
    """Iterator over the parts of a compound term of SWI-Prolog that is being read."""

    __slots__ = ("values",)

    def __init__(self) -> None:
        self.values: List[Term] = []

    def next_part(self) -> Optional[int]:
        """Return the reference of the next part, or None after the last one."""
        raise NotImplementedError

    def build_term(self) -> Term:
        """Return the complete term."""
        raise NotImplementedError


class ListParts(TermParts):
    """Parts of a list: its items, then its tail.

    Attributes:
        has_pending_item: whether an item has been taken from the list but not been read.
    """

    __slots__ = ("_swi", "_item", "_has_ended", "has_pending_item")

    def __init__(self, swi: SwiLibrary, item: int):
        super().__init__()
        self._swi = swi
        self._item = item
        self._has_ended = False
        self.has_pending_item = False

    def next_part(self) -> Optional[int]:
        """Return the reference of the next part, see `TermParts`."""
        item = self._item
        if self._has_ended:
            return None
        if self.has_pending_item:
            self.has_pending_item = False
            return item
        if self._swi.get_list(item + 1, item, item + 1):
            return item
        self._has_ended = True
        return item + 1

    def build_term(self) -> Term:
        """Return the complete term, see `TermParts`."""
        return make_list(self.values[:-1], self.values[-1])


class ArgumentParts(TermParts):
    """Parts of a compound term that is not a list."""

    __slots__ = ("_swi", "_ref", "_argument", "_key")

    def __init__(self, swi: SwiLibrary, ref: int, argument: int, key: Functor):
        super().__init__()
        self._swi = swi
        self._ref = ref
        self._argument = argument
        self._key = key

    def next_part(self) -> Optional[int]:
        """Return the reference of the next part, see `TermParts`."""
        number = len(self.values) + 1
        if number > self._key.arity:
            return None
        self._swi.get_argument(number, self._ref, self._argument)
        return self._argument

    def build_term(self) -> Term:
        """Return the complete term, see `TermParts`."""
        return (self._key, *self.values)


class MarkedVariable(TermParts):
    """A mark, which denotes a variable that has been read before; it has no parts."""

    __slots__ = ("_var",)

    def __init__(self, var: Var):
        super().__init__()
        self._var = var

    def next_part(self) -> Optional[int]:
        """Return None, since there are no parts."""
        return None

    def build_term(self) -> Term:
        """Return the variable."""
        return self._var


def require_success(result: int) -> int:
    """Return the result of a function of SWI-Prolog.

    Raises:
        PrologError: a resource error if it is 0, which means that SWI-Prolog has no memory left.
    """
    if not result:
        raise resource_error("memory")
    return result


_CHECK_INTERVAL_MASK = len(STEPS_PER_ROUND) - 1
"""Mask of a number of steps that is 0 where the limits are checked; the number per round is a power of 2."""

_MIN_INTEGER, _MAX_INTEGER = -(1 << 63), (1 << 63) - 1
_MARK_NAME = "$retalis_variable"
"""Name of the functor that marks a variable that has been read."""

Refs = Dict[Var, int]
"""References to terms of SWI-Prolog by variables of this package."""

Bindings = List[Tuple[Var, Term]]
"""Values of variables in a solution."""


class SwiTerms:
    """Converter of terms for one engine of SWI-Prolog. Not thread-safe."""

    def __init__(self, swi: SwiLibrary):
        self._swi = swi
        self._atom_handles = HandlesByTerm(swi.unregister_atom)
        self._functor_handles = HandlesByTerm(release_nothing)
        self._atoms_by_handle = TermsByHandle(swi.unregister_atom)
        self._functors_by_handle = TermsByHandle(release_nothing)
        self._put_functions: Dict[type, Callable[[int, Any], int]] = {
            int: self._put_integer,
            float: swi.unify_float,
            Atom: self._put_atom,
            String: self._put_string,
        }
        term_types = swi.term_types
        self._variable_type, self._compound_type, self._pair_type = (
            term_types["variable"],
            term_types["compound"],
            term_types["pair"],
        )
        self._read_functions: Dict[int, Callable[[int], Term]] = {
            term_types["atom"]: self._read_atom,
            term_types["integer"]: self._read_integer,
            term_types["float"]: self._read_float,
            term_types["string"]: self._read_string,
            term_types["nil"]: lambda ref: NIL,
        }
        # Buffers for results of C functions, and pointers to them.
        self._word, self._long, self._double = c_size_t(), c_int64(), c_double()
        self._length, self._address, self._arity = c_size_t(), c_void_p(), c_int()
        self._to_word, self._to_long, self._to_double = (
            byref(self._word),
            byref(self._long),
            byref(self._double),
        )
        self._to_length, self._to_address = byref(self._length), byref(self._address)
        self._to_arity = byref(self._arity)
        self._mark_functor = swi.new_functor(self.handle(atom(_MARK_NAME)), 1)
        self._marked_variables: List[Var] = []
        self._is_lenient = False

    def release(self) -> None:
        """Release all atoms."""
        self._atom_handles.clear()
        self._atoms_by_handle.clear()

    # To SWI-Prolog

    def put(self, ref: int, term: Term, refs: Refs) -> None:
        """Bind a new variable of SWI-Prolog to a term.

        Args:
            ref: reference of the variable.
            term: the term.
            refs: references of variables that have been converted already; those of the term are added.

        Raises:
            PrologError: if SWI-Prolog has no memory left, or cannot represent the term.
        """
        term = deref(term)
        put = self._put_functions.get(term.__class__)
        if put is not None:
            require_success(put(ref, term))
        elif term.__class__ is Var:
            self._put_variable(ref, term, refs)
        else:
            self._put_compound(ref, term, refs)

    def _put_variable(self, ref: int, var: Var, refs: Refs) -> None:
        stored_ref = refs.setdefault(var, ref)
        if stored_ref != ref:
            require_success(self._swi.unify(ref, stored_ref))

    def _put_compound(self, ref: int, root: Term, refs: Refs) -> None:
        """Bind a variable to a term that may be compound, from the outside to the inside."""
        swi, put_functions = self._swi, self._put_functions
        stack = [(ref, root)]
        steps = 0
        while stack:
            ref, term = stack.pop()
            steps += 1
            if not steps & _CHECK_INTERVAL_MASK:
                check_steps(steps)
            term = deref(term)
            put = put_functions.get(term.__class__)
            if put is not None:
                require_success(put(ref, term))
            elif term.__class__ is Var:
                self._put_variable(ref, term, refs)
            elif term.__class__ is tuple:
                count = len(term) - 1
                first = require_success(swi.new_refs(count))
                if term[0] is CONS:
                    require_success(swi.unify_list(ref, first, first + 1))
                else:
                    require_success(swi.unify_functor(ref, self._functor_handle(term[0])))
                    # The arguments of the new functor are unbound variables, which are bound by the next steps.
                    for number in range(count):
                        swi.get_argument(number + 1, ref, first + number)
                # In reverse order, because the stack returns the last item first; variables are numbered from left to
                # right.
                stack += [(first + number, term[number + 1]) for number in range(count - 1, -1, -1)]
            elif isinstance(term, int):
                require_success(self._put_integer(ref, int(term)))
            else:
                raise representation_error(
                    "term", f"SWI-Prolog cannot represent a value of type {type(term).__name__}"
                )

    def _put_integer(self, ref: int, value: int) -> int:
        if _MIN_INTEGER <= value <= _MAX_INTEGER:
            return self._swi.unify_integer(ref, value)  # type: ignore[no-any-return]
        # The text is hexadecimal, because the conversion of a long integer to decimal takes quadratic time.
        parsed_ref = require_success(self._swi.new_refs(1))
        require_success(self._swi.parse_term(hex(value).encode(), parsed_ref))
        return self._swi.unify(ref, parsed_ref)  # type: ignore[no-any-return]

    def _put_atom(self, ref: int, value: Atom) -> int:
        # The empty list of SWI-Prolog is a constant of its own, not an atom.
        if value is NIL:
            return self._swi.unify_nil(ref)  # type: ignore[no-any-return]
        handle = self._atom_handles.get(value)
        if handle is not None:
            return self._swi.unify_atom(ref, handle)  # type: ignore[no-any-return]
        text = _encode(value.name)
        result: int = self._swi.unify_text(ref, self._swi.atom_flag | self._swi.utf8_flag, len(text), text)
        if result and self._swi.get_atom(ref, self._to_word):
            self._cache_handle(self._atom_handles, value, self._word.value, len(text))
        return result

    def _put_string(self, ref: int, value: String) -> int:
        text = _encode(value.text)
        swi = self._swi
        return swi.unify_text(ref, swi.term_types["string"] | swi.utf8_flag, len(text), text)  # type: ignore[no-any-return]

    def _cache_handle(self, cache: HandlesByTerm, key: Any, handle: int, size: int) -> None:
        # Registered first: every entry of the cache must have a valid handle.
        self._swi.register_atom(handle)
        cache.store(key, handle, size)
        # The cache may refuse an entry that is too large; then nothing references the handle.
        if key not in cache:
            self._swi.unregister_atom(handle)

    def _functor_handle(self, key: Functor) -> int:
        handle = self._functor_handles.get(key)
        if handle is None:
            handle = self._swi.new_functor(self.handle(atom(key.name)), key.arity)
            self._functor_handles.store(key, handle, len(key.name))
        return handle

    def handle(self, value: Atom) -> int:
        """Return the handle of an atom. It is valid only while a term or the cache holds the atom."""
        ref = require_success(self._swi.new_refs(1))
        if value is NIL:  # the empty list of SWI-Prolog is not the atom '[]', which is the name of a functor
            require_success(self._swi.unify_text(ref, self._swi.atom_flag | self._swi.utf8_flag, 2, b"[]"))
        else:
            require_success(self._put_atom(ref, value))
        require_success(self._swi.get_atom(ref, self._to_word))
        return self._word.value

    # From SWI-Prolog

    def start_reading(self, lenient: bool = False) -> None:
        """Begin to read: terms that are read until the next `start_reading` share variables.

        Args:
            lenient: whether terms that cannot be represented are read as text.
        """
        self._marked_variables = []
        self._is_lenient = lenient

    def read_values(self, refs: Refs) -> Bindings:
        """Return the values of variables, without those that are still unbound and differ from the others."""
        read_functions, term_type_of, variable_type = (
            self._read_functions,
            self._swi.term_type,
            self._variable_type,
        )
        # All values of a solution share their variables, so the marks are reset only here.
        self._marked_variables = []
        self._is_lenient = False
        values = []
        for var, ref in refs.items():
            term_type = term_type_of(ref)
            read = read_functions.get(term_type)
            if read is not None:
                values.append((var, read(ref)))
            elif term_type == variable_type:
                self._mark_variable(ref, var)
            else:
                values.append((var, self._read_compound(ref, term_type)))
        return values

    def read(self, ref: int) -> Term:
        """Return the term of a reference.

        Raises:
            PrologError: if the term cannot be represented: rational numbers, streams and other handles, compound
                terms without arguments, variables with constraints.
            TermTooLarge: if the term is cyclic.
        """
        term_type = self._swi.term_type(ref)
        read = self._read_functions.get(term_type)
        if read is not None:
            return read(ref)
        return (
            self._mark_variable(ref, Var())
            if term_type == self._variable_type
            else self._read_compound(ref, term_type)
        )

    def _read_compound(self, ref: int, term_type: int) -> Term:
        """Return a term that is neither a constant nor a variable."""
        if term_type not in (self._compound_type, self._pair_type):
            return self._read_unsupported(ref, term_type)
        # Checked first, since the conversion of a cyclic term would not end before its limit.
        if not self._swi.is_acyclic(ref):
            raise TermTooLarge
        return self._read_compound_term(ref, term_type)

    def _mark_variable(self, ref: int, var: Var) -> Var:
        swi = self._swi
        # Constraints are goals suspended on a variable, and would be lost.
        if swi.is_attributed(ref):
            if not self._is_lenient:
                raise representation_error(
                    "constraint",
                    "a variable of the answer has constraints in SWI-Prolog: label it there first",
                )
            return var
        # The mark is a compound term with an integer, which cannot be confused with a term of the program.
        mark_argument = require_success(swi.new_refs(1))
        require_success(
            swi.unify_functor(ref, self._mark_functor) and swi.get_argument(1, ref, mark_argument)
        )
        require_success(swi.unify_integer(mark_argument, len(self._marked_variables)))
        self._marked_variables.append(var)
        return var

    def _read_compound_term(self, ref: int, term_type: int) -> Term:
        stack: List[TermParts] = []
        parts = self._make_parts(ref, term_type)
        steps = 0
        while True:
            steps += 1
            if not steps & _CHECK_INTERVAL_MASK:
                check_steps(steps)
            part = parts.next_part()
            if part is None:
                term = parts.build_term()
                if not stack:
                    return term
                parts = stack.pop()
                parts.values.append(term)
                continue
            term_type = self._swi.term_type(part)
            read = self._read_functions.get(term_type)
            if read is not None:
                parts.values.append(read(part))
            elif term_type in (self._compound_type, self._pair_type):
                stack.append(parts)
                parts = self._make_parts(part, term_type)
            else:
                parts.values.append(
                    self._mark_variable(part, Var())
                    if term_type == self._variable_type
                    else self._read_unsupported(part, term_type)
                )

    def _make_parts(self, ref: int, term_type: int) -> "TermParts":
        """Return the iterator over the parts of a compound term."""
        swi = self._swi
        if term_type == self._pair_type:
            items = require_success(swi.new_refs(2))
            swi.copy_ref(items + 1, ref)
            parts = ListParts(swi, items)
            parts.has_pending_item = self._read_constants(items, parts.values)
            return parts
        swi.get_functor(ref, self._to_word)
        handle = self._word.value
        argument = require_success(swi.new_refs(1))
        # A mark denotes a variable that has been read before.
        if handle == self._mark_functor:
            swi.get_argument(1, ref, argument)
            swi.get_integer(argument, self._to_long)
            return MarkedVariable(self._marked_variables[self._long.value])
        key = self._functors_by_handle.get(handle)
        if key is None:
            key = self._read_functor(ref)
            self._functors_by_handle.store(handle, key, len(key.name))
        return ArgumentParts(swi, ref, argument, key)

    def _read_constants(self, item: int, values: List[Term]) -> bool:
        """Read the leading constants of a list; return whether an item follows that is not a constant."""
        read_functions, term_type_of, get_list = self._read_functions, self._swi.term_type, self._swi.get_list
        # Lists of constants, the most common ones, need no stack entry per item.
        tail = item + 1
        while len(values) <= MAX_STEPS:
            for _ in STEPS_PER_ROUND:
                if not get_list(tail, item, tail):
                    return False
                read = read_functions.get(term_type_of(item))
                if read is None:
                    return True
                values.append(read(item))
            check_limits()
        raise TermTooLarge

    def _read_functor(self, ref: int) -> Functor:
        self._swi.get_name(ref, self._to_word, self._to_arity)
        handle, arity = self._word.value, self._arity.value
        if not arity:
            raise representation_error(
                "arity", "a compound term without arguments, such as f(), is not supported"
            )
        return functor(self._atom_name(handle), arity)

    def _atom_name(self, handle: int) -> str:
        ref = require_success(self._swi.new_refs(1))
        self._swi.unify_atom(ref, handle)
        return self._read_text(ref, ATOM_TEXT)

    def _read_atom(self, ref: int) -> Term:
        self._swi.get_atom(ref, self._to_word)
        handle = self._word.value
        cached_atom: Optional[Atom] = self._atoms_by_handle.get(handle)
        if cached_atom is not None:
            return cached_atom
        term = atom(self._read_text(ref, ATOM_TEXT))
        self._swi.register_atom(handle)
        self._atoms_by_handle.store(handle, term, len(term.name))
        if handle not in self._atoms_by_handle:
            self._swi.unregister_atom(handle)
        return term

    def _read_integer(self, ref: int) -> Term:
        # Integers beyond 64 bits are read as text.
        if self._swi.get_integer(ref, self._to_long):
            return self._long.value
        try:
            return integer(self._read_text(ref, INTEGER_TEXT))
        except ValueError:
            raise TermTooLarge from None

    def _read_float(self, ref: int) -> Term:
        self._swi.get_float(ref, self._to_double)
        return self._double.value

    def _read_string(self, ref: int) -> Term:
        return String(self._read_text(ref, STRING_TEXT))

    def _read_text(self, ref: int, flags: int) -> str:
        if not self._swi.get_text(ref, self._to_length, self._to_address, flags | self._swi.utf8_flag):
            raise resource_error("memory")
        return string_at(self._address.value or 0, self._length.value).decode("utf-8", "surrogatepass")

    def _read_unsupported(self, ref: int, term_type: int) -> Term:
        """Return the text of a term that cannot be represented, or raise an error, unless reading is lenient."""
        if self._is_lenient:
            return atom(self._read_text(ref, self._swi.any_term_as_text))
        names = {
            self._swi.term_types["rational"]: "a rational number",
            self._swi.term_types["dict"]: "a dict",
        }
        description = names.get(term_type, "a stream, a clause or another handle")
        text = shorten(self._read_text(ref, self._swi.any_term_as_text))
        raise representation_error(
            "term", f"{description} of SWI-Prolog cannot be converted to a term: '{text}'"
        )


def _encode(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass")
