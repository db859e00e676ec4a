"""Bytes of plain data and terms, and back: nothing in the bytes is ever called, and no attribute is ever set by them.

The bytes are a stream of MessagePack objects: a table (names of atoms, names and arities of functors, how many nodes
follow), the nodes, and the data. Atoms, functors, variables and the like are extension types with an index into the
table or with their own bytes. A node is a sequence that is used more than once, or that lies too deep in others to be
written in its place: an extension type refers to it by its number. References point backwards only, so nothing read
contains itself, and the size of what is read is bounded by the number of bytes.

What is read consists of numbers, texts, bytes, lists, and terms. A tuple is always a well-formed compound term, so
that a `schema` need not look into it. All other sequences are lists, but for keys of terms (`FlatKey`).
"""

from itertools import chain
from typing import Any, Callable, Dict, List, Tuple

import msgpack

from ..events.network.pattern_analysis import ITEM
from ..foundation.errors import UsageError
from ..prolog.terms.timestamps import Stamp, WholeSeconds
from ..prolog.terms.types import Atom, Functor, Lazy, String, Var, atom, deref, functor
from .schema import FlatKey

_ATOM, _FUNCTOR, _VARIABLE, _STRING, _REF, _NODE, _BIG, _KIND, _INSTANT, _STAMP = range(10)
"""The extension types."""

_MARKS = (float, Var)
"""Classes that keys of terms contain, as `term_key` makes them."""

_MAX_NESTING = 40
"""Nesting of sequences in the bytes: MessagePack's reader has a limit of 512."""

_SAMPLE = 4000
"""Sequences of a level among which those are counted that are used twice."""

_SHORT_SEQUENCE = 50
"""Sequences of a level that are written again if they are used twice; items of a short sequence."""

_OUTER = 4
"""Levels of sequences that the engine makes around terms."""

_MAX_UNSHARED_ITEMS = 2_000_000
"""Items of a level that may always be written as they are."""

_MAX_ARITY = 10_000_000

_TERMS = frozenset((int, float, Atom, String, Var, tuple))
_VALUES = _TERMS | {WholeSeconds, Stamp}
_IN_KEYS = frozenset((int, str, Atom, Functor, String, FlatKey, type, type(None)))
_IN_PAIRS = frozenset((str, int))


_SIGNED: Dict[int, Callable[[int], int]] = {_BIG: int, _INSTANT: WholeSeconds}


class Ref:
    """Stands for an object of a `Graph`, by its number."""

    __slots__ = ("number",)

    def __init__(self, number: int):
        self.number = number

    def __repr__(self) -> str:
        return f"Ref({self.number})"


_PLAIN = frozenset((type(None), bool, int, float, str, bytes, tuple, list, Atom, Functor, String, type, Ref))
"""Classes that MessagePack writes as they are, or that the table knows."""

_LEAVES = _PLAIN - {tuple, list}
_IN_TERMS = _LEAVES | {tuple}


def _index(number: int) -> bytes:
    width = 1 if number < 1 << 8 else 2 if number < 1 << 16 else 4
    return number.to_bytes(width, "little")


def _signed(number: int) -> bytes:
    return number.to_bytes(number.bit_length() // 8 + 1, "little", signed=True)


# ---- to bytes ----------------------------------------------------------------------------------------


class _SymbolTable(Dict[Any, Any]):
    """Extension types of atoms, functors and the like, made where they are first looked up."""

    def __init__(self) -> None:
        super().__init__()
        self.atoms: List[str] = []
        self.names: List[str] = []
        self.arities: List[int] = []
        self._variables = 0

    def __missing__(self, value: Any) -> Any:
        kind = value.__class__
        if kind is Atom:
            made = msgpack.ExtType(_ATOM, _index(len(self.atoms)))
            self.atoms.append(value.name)
        elif kind is Functor:
            made = msgpack.ExtType(_FUNCTOR, _index(len(self.names)))
            self.names.append(value.name)
            self.arities.append(value.arity)
        elif kind is Ref:
            made = msgpack.ExtType(_REF, _index(value.number))
        elif kind is Var and value.ref is None:
            made = msgpack.ExtType(_VARIABLE, _index(self._variables))
            self._variables += 1
        elif kind is String:
            return msgpack.ExtType(_STRING, value.text.encode("utf-8", "surrogatepass"))
        elif kind is int:
            return msgpack.ExtType(_BIG, _signed(value))
        elif kind is Var or kind is Lazy:
            return self.of(deref(value))
        elif value in _MARKS:
            made = msgpack.ExtType(_KIND, _index(_MARKS.index(value)))
        else:
            raise TypeError(f"{kind.__name__} cannot be kept")
        self[value] = made
        return made

    def of(self, value: Any) -> Any:
        """Return what MessagePack writes for a value that no variable stands for."""
        if value.__class__ in (Atom, Functor, String, Var) or (
            value.__class__ is int and value.bit_length() > 63
        ):
            return self[value]
        return value


def to_bytes(data: Any) -> bytes:
    """Return data as bytes.

    Raises:
        UsageError: for a term that contains itself.
    """
    nodes: List[Any] = []
    data = _pairs(data, _OUTER)
    if not _is_simple(data):
        data = _split(data, nodes)
    table = _SymbolTable()
    packer = msgpack.Packer(default=table.__getitem__, use_bin_type=True, unicode_errors="surrogatepass")
    body = [packer.pack(one) for one in (*nodes, data)]
    return b"".join((packer.pack((table.atoms, table.names, table.arities, len(nodes))), *body))


def _pairs(data: Any, depth: int) -> Any:
    """Return data with pairs for mappings, as far as these lie in short sequences that the engine makes."""
    if data.__class__ is dict:
        return [[key, _pairs(value, depth - 1)] for key, value in data.items()]
    if (
        data.__class__ in (tuple, list)
        and depth
        and 0 < len(data) <= _SHORT_SEQUENCE
        and data[0].__class__ is not Functor
    ):
        return [_pairs(item, depth - 1) for item in data]
    return data


def _is_simple(data: Any) -> bool:
    """Tell whether data can be written as it is: shallow, hardly anything used twice, no instants with a form.

    Looks at many items at once, by functions that are written in C: records of memories come by the thousand. Whether
    sequences are used twice is seen by the first thousands of each level.
    """
    level: List[Any] = [[data]]
    most = _MAX_UNSHARED_ITEMS
    for depth in range(_MAX_NESTING):
        size = sum(map(len, level))
        if depth <= _OUTER:
            most = max(most, 40 * size)
        elif size > most:  # most of it is perhaps the same again and again
            return False
        kinds = set(map(type, chain.from_iterable(level)))
        if kinds <= _LEAVES:
            return True
        if kinds <= _IN_TERMS:
            level = [one for one in chain.from_iterable(level) if one.__class__ is tuple and one]
        else:
            every: Any = chain.from_iterable(level)
            if Var in kinds or Lazy in kinds:
                every = [deref(one) if one.__class__ in (Var, Lazy) else one for one in every]
                kinds = set(map(type, every)) - {Var}
            if not all(issubclass(kind, tuple) for kind in kinds - _PLAIN):
                return False
            sequences = {kind for kind in kinds if issubclass(kind, (tuple, list))}
            level = [one for one in every if one.__class__ in sequences and one]
        first = level if depth < _OUTER else level[:_SAMPLE]
        if len(first) > _SHORT_SEQUENCE and 10 * len(set(map(id, first))) < 9 * len(first):
            return False
    return False


def _children(one: Any) -> List[Any]:
    """Return what lies in a sequence, a mapping, or a stamp."""
    if isinstance(one, dict):
        found: List[Any] = [[key, value] for key, value in one.items()]
    elif one.__class__ is Stamp:
        found = [one.term]
    else:
        found = one
    return [deref(item) if item.__class__ in (Var, Lazy) else item for item in found]


def _holds(one: Any) -> bool:
    return (isinstance(one, (tuple, list)) and bool(one)) or isinstance(one, dict) or one.__class__ is Stamp


def _split(data: Any, nodes: List[Any]) -> Any:
    """Return data in which sequences that are used more than once, or too deep, are references to nodes.

    Args:
        data: the data.
        nodes: takes the nodes, each after those that it refers to.

    Raises:
        UsageError: for a term that contains itself.
    """
    if not _holds(data):
        return data
    made: Dict[int, Any] = {}  # what each sequence has become; None while its parts are being done
    depths: Dict[int, int] = {}
    uses, parts_of = _uses(data)
    stack: List[Tuple[Any, bool]] = [(data, False)]
    while stack:
        one, done = stack.pop()
        parts = parts_of[id(one)]
        if not done:
            if id(one) in made:
                if made[id(one)] is None:
                    raise UsageError("the state has a term that contains itself: such a term cannot be kept")
                continue
            made[id(one)] = None
            stack.append((one, True))
            stack += [(part, False) for part in parts if _holds(part)]
            continue
        found = _replaced(one, parts, made)
        depth = max((depths[id(part)] for part in parts if _holds(part)), default=0)
        depths[id(one)] = 0
        if one.__class__ is Stamp:
            nodes.append(found[0])
            number = len(nodes) - 1
            made[id(one)] = msgpack.ExtType(_STAMP, number.to_bytes(4, "little") + _signed(int(one)))
        elif uses[id(one)] > 1 or depth >= _MAX_NESTING:
            nodes.append(found)
            made[id(one)] = msgpack.ExtType(_NODE, _index(len(nodes) - 1))
        else:
            made[id(one)], depths[id(one)] = found, depth + 1
    return made[id(data)]


def _replaced(one: Any, parts: List[Any], made: Dict[int, Any]) -> List[Any]:
    """Return the parts of a sequence with what they have become in their place; in terms instants are integers."""
    if one.__class__ is tuple and parts[0].__class__ is Functor and parts[0].name != ITEM:
        parts = [int(part) if part.__class__ in (WholeSeconds, Stamp) else part for part in parts]
    return [
        made[id(part)]
        if _holds(part)
        else msgpack.ExtType(_INSTANT, _signed(int(part)))
        if part.__class__ is WholeSeconds
        else part
        for part in parts
    ]


def _uses(data: Any) -> Tuple[Dict[int, int], Dict[int, List[Any]]]:
    """Return how often each sequence is used, and what lies in it, by its id."""
    uses: Dict[int, int] = {}
    parts: Dict[int, List[Any]] = {}
    stack = [data]
    while stack:
        one = stack.pop()
        if id(one) in uses:
            uses[id(one)] += 1
            continue
        uses[id(one)] = 1
        parts[id(one)] = found = _children(one)
        stack += [part for part in found if _holds(part)]
    return uses, parts


# ---- from bytes --------------------------------------------------------------------------------------


class _StateReader:
    """Reads one text of bytes."""

    def __init__(self) -> None:
        self._atoms: Dict[bytes, Atom] = {}
        self._functors: Dict[bytes, Functor] = {}
        self._variables: Dict[int, Var] = {}
        self._refs: Dict[int, Ref] = {}
        self._nodes: List[Any] = []

    def read(self, data: bytes) -> Any:
        """Return the data of bytes."""
        number = _number_of_objects(data)
        unpacker = _unpacker(data, self._sequence, self._extension)
        unpacker.feed(data)
        head = unpacker.unpack()
        atoms, names, arities, nodes = head
        if not (
            all(one.__class__ is list for one in (atoms, names, arities))
            and all(one.__class__ is str for one in (*atoms, *names))
            and all(one.__class__ is int and 0 <= one <= _MAX_ARITY for one in arities)
            and len(names) == len(arities)
            and nodes.__class__ is int
            and number == nodes + 2
        ):
            raise UsageError("its table is malformed")
        self._atoms = {_index(at): atom(name) for at, name in enumerate(atoms)}
        self._functors = {_index(at): functor(*one) for at, one in enumerate(zip(names, arities))}
        for _ in range(nodes):
            self._nodes.append(unpacker.unpack())
        return unpacker.unpack()

    def _sequence(self, items: Any) -> Any:
        """Return a compound term as a tuple, and any other sequence as a list."""
        if not items:
            return items
        first = items[0].__class__
        if first is Functor:
            if len(items) == items[0].arity + 1 and (
                _TERMS.issuperset(map(type, items[1:]))
                or (items[0].name == ITEM and _VALUES.issuperset(map(type, items[1:])))
            ):
                return tuple(items)
            if _IN_KEYS.issuperset(map(type, items)):
                return FlatKey(items)
        elif first is type and (
            _IN_KEYS.issuperset(map(type, items)) if items[0] is Var else len(items) == 2
        ):
            return FlatKey(items)
        return items

    def _extension(self, code: int, data: bytes) -> Any:
        """Return what an extension type stands for."""
        if code == _ATOM:
            return self._atoms[data]
        if code == _FUNCTOR:
            return self._functors[data]
        if code == _STRING:
            return String(str(data, "utf-8", "surrogatepass"))
        if code in _SIGNED:
            return _SIGNED[code](int.from_bytes(data, "little", signed=True))
        if code == _STAMP:
            shown: Any = self._nodes[int.from_bytes(data[:4], "little")]
            kind = shown.__class__
            if kind not in _TERMS:
                raise UsageError("an instant is shown as what is no term")
            return Stamp.of(int.from_bytes(data[4:], "little", signed=True), shown)
        return self._numbered(code, int.from_bytes(data, "little"))

    def _numbered(self, code: int, number: int) -> Any:
        """Return what an extension type stands for that has a number."""
        if code == _NODE:
            return self._nodes[number]
        if code == _KIND:
            return _MARKS[number]
        if code == _VARIABLE:
            return self._variables.get(number) or self._variables.setdefault(number, Var())
        if code == _REF:
            return self._refs.get(number) or self._refs.setdefault(number, Ref(number))
        raise UsageError(f"it has something of the unknown type {code}")


def _unpacker(data: bytes, sequence: Any = None, extension: Any = None) -> Any:
    most = max(len(data), 1)
    return msgpack.Unpacker(
        use_list=True,
        raw=False,
        strict_map_key=False,
        unicode_errors="surrogatepass",
        list_hook=sequence,
        ext_hook=extension or msgpack.ExtType,
        read_size=min(most, 1 << 16),
        max_buffer_size=most,
        max_str_len=most,
        max_bin_len=most,
        max_ext_len=most,
        max_array_len=most,
        max_map_len=0,
    )


def _number_of_objects(data: bytes) -> int:
    """Return how many objects bytes are, without making any.

    A sequence says how many items it has before these come. Read at once, a few bytes could have memory set aside for
    many; skipped first, it is known that all of them are there.
    """
    unpacker = _unpacker(data)
    unpacker.feed(data)
    number = 0
    while unpacker.tell() < len(data):
        unpacker.skip()
        number += 1
    return number


def from_bytes(data: bytes) -> Any:
    """Return the data of bytes: see the text of this module for what it consists of.

    Raises:
        UsageError: where they are damaged, or were never made by `to_bytes`.
    """
    try:
        return _StateReader().read(data)
    except UsageError:
        raise
    except Exception as error:  # of whatever kind: MessagePack has several
        raise UsageError(f"it does not read ({type(error).__name__}: {error})") from error
