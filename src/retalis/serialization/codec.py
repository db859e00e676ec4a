"""Binary encoding of plain data and terms, which is safe to decode from untrusted files.

In contrast to `pickle`, decoding never calls a function and never sets an attribute that the bytes name.

The encoding is a stream of MessagePack objects: a symbol table (names of atoms, names and arities of functors, number
of nodes), the nodes, and the data. Atoms, functors, variables and the like are extension types with an index into the
table, or with their own bytes. A node is a sequence that is used more than once, or that is nested too deeply to be
written inline: an extension type refers to it by its number. References only point backwards, so decoded data is
never cyclic, and its size is bounded by the number of bytes.

Decoded data consists of numbers, strings, bytes, lists, and terms. A tuple is always a well-formed compound term, so
that a check of `state_fields` need not inspect its arguments. All other sequences are lists, except keys of
terms (`FlatKey`).
"""

from functools import lru_cache
from itertools import chain
from typing import Callable, Dict, Iterable, List, Sequence, Tuple

import msgpack

from ..foundation.errors import UsageError
from ..prolog.terms.timestamps import FloatSeconds, Stamp
from ..prolog.terms.types import Atom, Functor, Lazy, String, Var, atom, deref, functor
from .stored_field_types import ITEM_FUNCTOR_NAME, TERM, FlatKey, items_of

_ATOM, _FUNCTOR, _VARIABLE, _STRING, _REF, _NODE, _LONG_INTEGER, _MARKER, _INSTANT, _STAMP = range(10)
"""Codes of the extension types."""

_MARKERS = (float, Var)
"""Classes that occur as markers in keys of terms, see `term_key`."""

_MAX_NESTING = 40
"""Maximum nesting of encoded sequences: the MessagePack reader has a limit of 512."""

_SHARING_SAMPLE = 4000
"""Number of sequences per level that are examined for repeated use."""

_SHORT_SEQUENCE = 50
"""Levels with at most this many sequences are not examined for repeated use; also the length of a short sequence."""

_ENGINE_LEVELS = 4
"""Number of levels of sequences that the engine creates around terms."""

_MAX_UNSHARED_ITEMS = 2_000_000
"""Levels with at most this many items are always encoded inline."""

_MAX_ARITY = 10_000_000

_VALUES = TERM.classes | {FloatSeconds, Stamp}
"""Classes of values of a match."""

_IN_KEYS = frozenset((int, str, Atom, Functor, String, FlatKey, type, type(None)))
"""Classes of the items of keys."""

_SIGNED_NUMBERS: Dict[int, Callable[[int], int]] = {_LONG_INTEGER: int, _INSTANT: FloatSeconds}
"""Classes of the extension types that consist of a signed number."""


class Ref:
    """Reference to an object of a match graph by its number."""

    __slots__ = ("number",)

    def __init__(self, number: int):
        self.number = number

    def __repr__(self) -> str:
        return f"Ref({self.number})"


_PLAIN = frozenset((type(None), bool, int, float, str, bytes, tuple, list, Atom, Functor, String, type, Ref))
"""Classes that MessagePack or the symbol table encode directly."""

_LEAVES = _PLAIN - {tuple, list}
_IN_TERMS = _LEAVES | {tuple}


def _encode_index(number: int) -> bytes:
    width = 1 if number < 1 << 8 else 2 if number < 1 << 16 else 4
    return number.to_bytes(width, "little")


def _encode_signed(number: int) -> bytes:
    return number.to_bytes(number.bit_length() // 8 + 1, "little", signed=True)


@lru_cache(maxsize=1024)
def _make_extension(code: int, number: int) -> object:
    """Return an extension type. Low numbers occur in every state, and msgpack checks each new object."""
    return msgpack.ExtType(code, _encode_index(number))


# ---- encoding ----------------------------------------------------------------------------------------


class _SymbolTable(Dict[object, object]):
    """Extension types of atoms, functors and the like, created on first lookup."""

    def __init__(self) -> None:
        super().__init__()
        self.atoms: List[str] = []
        self.names: List[str] = []
        self.arities: List[int] = []
        self._variable_count = 0

    def __missing__(self, value: object) -> object:
        # MessagePack looks up each value that it cannot encode; this is called on the first lookup only.
        if isinstance(value, Atom):
            extension = _make_extension(_ATOM, len(self.atoms))
            self.atoms.append(value.name)
        elif isinstance(value, Functor):
            extension = _make_extension(_FUNCTOR, len(self.names))
            self.names.append(value.name)
            self.arities.append(value.arity)
        elif isinstance(value, Ref):
            extension = msgpack.ExtType(_REF, _encode_index(value.number))
        elif isinstance(value, Var) and value.ref is None:
            extension = _make_extension(_VARIABLE, self._variable_count)
            self._variable_count += 1
        elif isinstance(value, String):
            return msgpack.ExtType(_STRING, value.text.encode("utf-8", "surrogatepass"))
        elif isinstance(value, int):
            # MessagePack encodes integers of at most 64 bits.
            return msgpack.ExtType(_LONG_INTEGER, _encode_signed(value))
        # A bound variable is not stored: it may be bound to another value in the next term.
        elif isinstance(value, (Var, Lazy)):
            return self.lookup(deref(value))
        elif value in _MARKERS:
            extension = msgpack.ExtType(_MARKER, _encode_index(_MARKERS.index(value)))
        else:
            raise TypeError(f"{type(value).__name__} cannot be stored in a state")
        self[value] = extension
        return extension

    def lookup(self, value: object) -> object:
        """Return the value that MessagePack encodes for a dereferenced value."""
        if value.__class__ in (Atom, Functor, String, Var) or (
            value.__class__ is int and value.bit_length() > 63
        ):
            return self[value]
        return value


def to_bytes(data: object) -> bytes:
    """Return the encoding of data.

    Raises:
        UsageError: if the data contains a cyclic term.
    """
    nodes: List[object] = []
    # The general encoder visits every item in Python, and is needed for few states.
    if not _is_simple(data):
        data = _extract_nodes(data, nodes)
    table = _SymbolTable()
    packer = msgpack.Packer(default=table.__getitem__, use_bin_type=True, unicode_errors="surrogatepass")
    body = [packer.pack(item) for item in (*nodes, data)]
    return b"".join((packer.pack((table.atoms, table.names, table.arities, len(nodes))), *body))


def _is_simple(data: object) -> bool:
    """Return whether data can be encoded inline: shallow, with little repeated use, and without formatted instants.

    Memories have thousands of records, so items are examined level by level with functions that are implemented in C.
    Repeated use is estimated from the first `_SHARING_SAMPLE` sequences of each level.
    """
    level: List[Sequence[object]] = [[data]]
    max_items = _MAX_UNSHARED_ITEMS
    for depth in range(_MAX_NESTING):
        size = sum(map(len, level))
        if depth <= _ENGINE_LEVELS:
            max_items = max(max_items, 40 * size)
        # A level that is much larger than those above it probably consists of the same sequences repeatedly.
        elif size > max_items:
            return False
        classes = set(map(type, chain.from_iterable(level)))
        if classes <= _LEAVES:
            return True
        if classes <= _IN_TERMS:
            level = [item for item in chain.from_iterable(level) if type(item) is tuple and item]
        else:
            items: Iterable[object] = chain.from_iterable(level)
            if Var in classes or Lazy in classes:
                items = [deref(item) if isinstance(item, (Var, Lazy)) else item for item in items]
                classes = set(map(type, items)) - {Var}
            if not all(issubclass(item_class, tuple) for item_class in classes - _PLAIN):
                return False
            level = [item for item in items if isinstance(item, (tuple, list)) and item]
        sample = level if depth < _ENGINE_LEVELS else level[:_SHARING_SAMPLE]
        if len(sample) > _SHORT_SEQUENCE and 10 * len(set(map(id, sample))) < 9 * len(sample):
            return False
    return False


def _list_children(container: object) -> List[object]:
    """Return the items of a sequence, or the term of a stamp."""
    children = [container.term] if isinstance(container, Stamp) else items_of(container)
    return [deref(item) if isinstance(item, (Var, Lazy)) else item for item in children]


def _is_container(value: object) -> bool:
    return (isinstance(value, (tuple, list)) and bool(value)) or value.__class__ is Stamp


def _extract_nodes(data: object, nodes: List[object]) -> object:
    """Return data in which sequences that are used repeatedly or nested too deeply are references to nodes.

    Args:
        data: the data.
        nodes: receives the nodes, each one after those that it refers to.

    Raises:
        UsageError: if the data contains a cyclic term.
    """
    if not _is_container(data):
        return data
    # The replacement of each sequence by its id; None while its items are being processed, which detects cycles.
    replacements: Dict[int, object] = {}
    depths: Dict[int, int] = {}
    uses, children_of = _count_uses(data)
    # An explicit stack: lists in Prolog are nested as deeply as they are long.
    stack: List[Tuple[object, bool]] = [(data, False)]
    while stack:
        sequence, items_are_done = stack.pop()
        children = children_of[id(sequence)]
        if not items_are_done:
            if id(sequence) in replacements:
                if replacements[id(sequence)] is None:
                    raise UsageError(
                        "the state contains a term that contains itself: cyclic terms cannot be stored"
                    )
                continue
            replacements[id(sequence)] = None
            stack.append((sequence, True))
            stack += [(child, False) for child in children if _is_container(child)]
            continue
        items = _replace_children(sequence, children, replacements)
        depth = max((depths[id(child)] for child in children if _is_container(child)), default=0)
        depths[id(sequence)] = 0
        if sequence.__class__ is Stamp:
            # The text of a stamp is a node, because an extension type can only contain bytes.
            nodes.append(items[0])
            number = len(nodes) - 1
            replacements[id(sequence)] = msgpack.ExtType(
                _STAMP, number.to_bytes(4, "little") + _encode_signed(int(sequence))
            )
        # A shared sequence is stored once, which also preserves identity; deep ones are cut so that no reader
        # overflows.
        elif uses[id(sequence)] > 1 or depth >= _MAX_NESTING:
            nodes.append(items)
            replacements[id(sequence)] = msgpack.ExtType(_NODE, _encode_index(len(nodes) - 1))
        else:
            replacements[id(sequence)], depths[id(sequence)] = items, depth + 1
    return replacements[id(data)]


def _replace_children(sequence: object, parts: List[object], replacements: Dict[int, object]) -> List[object]:
    """Return the items of a sequence with nested sequences replaced; instants in terms become integers."""
    if sequence.__class__ is tuple and parts[0].__class__ is Functor and parts[0].name != ITEM_FUNCTOR_NAME:
        parts = [int(part) if part.__class__ in (FloatSeconds, Stamp) else part for part in parts]
    return [
        replacements[id(part)]
        if _is_container(part)
        else msgpack.ExtType(_INSTANT, _encode_signed(int(part)))
        if part.__class__ is FloatSeconds
        else part
        for part in parts
    ]


def _count_uses(data: object) -> Tuple[Dict[int, int], Dict[int, List[object]]]:
    """Return the number of uses and the items of each sequence, by its id."""
    uses: Dict[int, int] = {}
    parts: Dict[int, List[object]] = {}
    stack = [data]
    while stack:
        sequence = stack.pop()
        if id(sequence) in uses:
            uses[id(sequence)] += 1
            continue
        uses[id(sequence)] = 1
        parts[id(sequence)] = children = _list_children(sequence)
        stack += [part for part in children if _is_container(part)]
    return uses, parts


# ---- decoding ----------------------------------------------------------------------------------------


class _StateReader:
    """Decoder of one encoded state."""

    def __init__(self) -> None:
        self._atoms: Dict[bytes, Atom] = {}
        self._functors: Dict[bytes, Functor] = {}
        self._variables: Dict[int, Var] = {}
        self._refs: Dict[int, Ref] = {}
        self._nodes: List[object] = []

    def read(self, data: bytes) -> object:
        """Return the decoded data."""
        # Counted first, see `_count_objects`.
        object_count = _count_objects(data)
        unpacker = _create_unpacker(data, self._decode_sequence, self._decode_extension)
        unpacker.feed(data)
        head = unpacker.unpack()
        atoms, names, arities, nodes = head
        # Everything that later code relies on is checked here, because the bytes may come from anywhere.
        if not (
            all(entry.__class__ is list for entry in (atoms, names, arities))
            and all(entry.__class__ is str for entry in (*atoms, *names))
            and all(entry.__class__ is int and 0 <= entry <= _MAX_ARITY for entry in arities)
            and len(names) == len(arities)
            and nodes.__class__ is int
            and object_count == nodes + 2
        ):
            raise UsageError("its symbol table is malformed")
        self._atoms = {_encode_index(index): atom(name) for index, name in enumerate(atoms)}
        self._functors = {
            _encode_index(index): functor(*entry) for index, entry in enumerate(zip(names, arities))
        }
        for _ in range(nodes):
            self._nodes.append(unpacker.unpack())
        return unpacker.unpack()

    def _decode_sequence(self, items: List[object]) -> object:
        """Return a compound term as a tuple, a key of a term as a `FlatKey`, and any other sequence as a list."""
        if not items:
            return items
        first = items[0]
        if isinstance(first, Functor):
            # A functor with another number of arguments would break code that relies on the arity.
            if len(items) == first.arity + 1 and (
                TERM.classes.issuperset(map(type, items[1:]))
                or (first.name == ITEM_FUNCTOR_NAME and _VALUES.issuperset(map(type, items[1:])))
            ):
                return tuple(items)
            if _IN_KEYS.issuperset(map(type, items)):
                return FlatKey(items)
        elif isinstance(first, type) and (
            _IN_KEYS.issuperset(map(type, items)) if first is Var else len(items) == 2
        ):
            return FlatKey(items)
        return items

    def _decode_extension(self, code: int, data: bytes) -> object:
        """Return the value of an extension type."""
        if code == _ATOM:
            return self._atoms[data]
        if code == _FUNCTOR:
            return self._functors[data]
        if code == _STRING:
            return String(str(data, "utf-8", "surrogatepass"))
        if code in _SIGNED_NUMBERS:
            return _SIGNED_NUMBERS[code](int.from_bytes(data, "little", signed=True))
        if code == _STAMP:
            term = TERM.check(self._nodes[int.from_bytes(data[:4], "little")])
            return Stamp.of(int.from_bytes(data[4:], "little", signed=True), term)
        return self._decode_numbered(code, int.from_bytes(data, "little"))

    def _decode_numbered(self, code: int, number: int) -> object:
        """Return the value of an extension type with a number."""
        if code == _NODE:
            return self._nodes[number]
        if code == _MARKER:
            return _MARKERS[number]
        if code == _VARIABLE:
            # The same number is the same variable in all parts of the data.
            return self._variables.get(number) or self._variables.setdefault(number, Var())
        if code == _REF:
            return self._refs.get(number) or self._refs.setdefault(number, Ref(number))
        raise UsageError(f"extension type {code} is unknown")


def _create_unpacker(
    data: bytes, sequence_hook: object = None, extension_hook: object = None
) -> msgpack.Unpacker:
    """Return a MessagePack decoder for untrusted data."""
    # No object can be larger than the data. Without these limits, a false length would allocate memory.
    max_size = max(len(data), 1)
    return msgpack.Unpacker(
        use_list=True,
        raw=False,
        strict_map_key=False,
        unicode_errors="surrogatepass",
        list_hook=sequence_hook,
        ext_hook=extension_hook or msgpack.ExtType,
        read_size=min(max_size, 1 << 16),
        max_buffer_size=max_size,
        max_str_len=max_size,
        max_bin_len=max_size,
        max_ext_len=max_size,
        max_array_len=max_size,
        # Maps are never written.
        max_map_len=0,
    )


def _count_objects(data: bytes) -> int:
    """Return the number of encoded objects, without decoding them.

    A sequence states its length before its items. Decoding it directly would allocate memory for that many items;
    skipping over all objects first verifies that they exist.
    """
    unpacker = _create_unpacker(data)
    unpacker.feed(data)
    count = 0
    while unpacker.tell() < len(data):
        unpacker.skip()
        count += 1
    return count


def from_bytes(data: bytes) -> object:
    """Return decoded data; the module docstring describes its types.

    Raises:
        UsageError: if the bytes are damaged, or were not created by `to_bytes`.
    """
    try:
        return _StateReader().read(data)
    except UsageError:
        raise
    except Exception as error:  # MessagePack raises several types of exceptions
        raise UsageError(f"it cannot be decoded ({type(error).__name__}: {error})") from error
