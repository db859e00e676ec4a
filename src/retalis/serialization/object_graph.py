"""Serialization of objects that refer to each other in cycles.

Matches, events, shared buffers and nodes form a graph. Each object has a number, by which other objects refer to it.
`ObjectWriter` assigns the numbers in the order in which objects are reached, and encodes the attributes of all
objects of a kind in columns, one for each declared field (`ObjectFields`). `ObjectReader` first creates all objects
without attributes, so that references can be resolved in any order, then checks and sets the attributes, and finally
checks the constraints and calls ``after_restore``, which derives the attributes that are not stored.

Objects that exist before a state is read, such as rules and their nodes, are external: `ExternalObjects` names them
by numbers.

A state file is not trusted: every column has a type, references are only accepted to objects of the right kinds, and
the graph of what objects consist of must be acyclic, because the engine traverses it recursively.
"""

from __future__ import annotations

from collections import defaultdict
from operator import attrgetter, is_
from typing import Callable, DefaultDict, Dict, FrozenSet, List, Mapping, Optional, Sequence, Tuple

from ..foundation.errors import UsageError
from .codec import Ref
from .state_fields import KINDS, ObjectFields, StoredField, check_column, named_values
from .stored_field_types import (
    ANYTHING,
    COUNT,
    NO_CONTEXT,
    TEXT,
    FieldChange,
    FieldType,
    ReadContext,
    ValueCheck,
    check_items,
    encode_each,
    invalid_value,
    items_of,
    sequence_of,
    tuple_of,
)

ExternalKey = Sequence[int]
"""Numbers that name an external object."""


class ExternalObjects:
    """Objects that a state refers to and does not contain."""

    def may_contain(self, item_class: type) -> bool:
        """Return whether objects of a class can be external."""
        raise NotImplementedError

    def kind_of(self, item: object) -> Optional[str]:
        """Return the kind of an object; None if it is not external."""
        raise NotImplementedError

    def key_of(self, item: object) -> ExternalKey:
        """Return the key of an external object."""
        raise NotImplementedError

    def find(self, kind: str, key: ExternalKey) -> object:
        """Return the object with a key.

        Raises:
            UsageError: if there is none.
        """
        raise NotImplementedError


class ObjectWriter:
    """Writer that assigns numbers to objects and encodes their attributes.

    Args:
        replace: returns the object that is written in place of another one, such as a copy without some links; None
            if each is written itself.
    """

    def __init__(self, external: ExternalObjects, replace: Optional[Callable[[object], object]] = None):
        self._external = external
        self._replace = replace
        self._numbers: Dict[int, int] = {}
        self._refs: Dict[int, Ref] = {}
        self._unexplored: List[object] = []
        self._codes = bytearray()
        self._code_by_kind: Dict[str, int] = {}
        self._objects: DefaultDict[str, List[object]] = defaultdict(list)
        self._columns: DefaultDict[Tuple[str, str], List[object]] = defaultdict(list)
        self._is_object_class: Dict[type, bool] = {}
        self._kind_by_class: Dict[type, str] = {}

    def is_object(self, item: object) -> bool:
        """Return whether a value is an object of the graph, and not data."""
        item_class = type(item)
        known = self._is_object_class.get(item_class)
        if known is None:
            has_fields = isinstance(getattr(item_class, "STATE", None), ObjectFields)
            known = self._is_object_class[item_class] = has_fields or self._external.may_contain(item_class)
        return known

    def number_of(self, item: object) -> int:
        """Return the number of an object."""
        number = self._numbers.get(id(item))
        if number is None:
            number = self._numbers[id(item)] = len(self._numbers)
            self._unexplored.append(item)
        return number

    def reference_to(self, item: object) -> Ref:
        """Return the reference to an object."""
        number = self.number_of(item)
        return self._refs.get(number) or self._refs.setdefault(number, Ref(number))

    def encode(self) -> object:
        """Return the encoding of all objects that were reached: kinds, their codes by object, columns by kind."""
        # Objects are reached in a loop instead of recursively, because chains of objects can be very long.
        while self._unexplored:
            self._collect_unexplored()
        kinds = list(self._code_by_kind)
        return [kinds, bytes(self._codes), [[kind, self._encode_columns(kind)] for kind in kinds]]

    def _collect_unexplored(self) -> None:
        """Collect the objects that were numbered last, and assign numbers to the objects that they refer to."""
        reached, self._unexplored = self._unexplored, []
        if self._replace is not None:
            reached = list(map(self._replace, reached))
        known_kinds = self._kind_by_class
        kinds = [known_kinds.get(type(item)) or self._find_kind(item) for item in reached]
        self._codes += bytes(map(self._code_by_kind.__getitem__, kinds))
        by_kind: DefaultDict[str, List[object]] = defaultdict(list)
        for kind, item in zip(kinds, reached):
            by_kind[kind].append(item)
        for kind, objects in by_kind.items():
            self._objects[kind] += objects
            for entry in _fields_of(kind):
                # Columns without references are encoded at the end, all at once.
                if callable(entry.type) or entry.type.encoder is not None:
                    column = _encode_values(entry, objects, self)
                    self._columns[kind, entry.name] += items_of(column)

    def _find_kind(self, item: object) -> str:
        """Return the kind of an object; that of a class without external objects is stored."""
        item_class = type(item)
        kind = self._external.kind_of(item) if self._external.may_contain(item_class) else None
        if kind is None:
            state_fields: ObjectFields = item_class.STATE  # type: ignore[attr-defined]
            kind = state_fields.kind
            if not self._external.may_contain(item_class):
                self._kind_by_class[item_class] = kind
        self._code_by_kind.setdefault(kind, len(self._code_by_kind))
        return kind

    def _encode_columns(self, kind: str) -> object:
        """Return the columns of all objects of a kind by name; for external objects, their keys."""
        objects = self._objects[kind]
        if kind not in KINDS:
            return [self._external.key_of(item) for item in objects]
        fields = _fields_of(kind)
        columns: List[object] = []
        for entry in fields:
            column: object = self._columns.get((kind, entry.name))
            if column is None:
                column = _encode_values(entry, objects, self)
            # A column in which all values are None takes no space.
            if isinstance(column, list) and all(value is None for value in column):
                column = None
            columns.append(column)
        return named_values([entry.name for entry in fields], columns)


def _fields_of(kind: str) -> Sequence[StoredField]:
    if kind not in KINDS:
        return ()
    _, state_fields = KINDS[kind]
    return state_fields.fields


def _encode_values(entry: StoredField, objects: Sequence[object], graph: ObjectWriter) -> object:
    """Return the column of a field; None if all values are None, or those of another field."""
    values: List[object] = list(map(attrgetter(entry.attribute), objects))
    # Most events have no duration. Instants are compared by identity, because equal ones can print differently.
    if entry.same_as is not None and all(map(is_, map(attrgetter(entry.same_as), objects), values)):
        return None
    if callable(entry.type):
        return encode_each(values, [entry.type(item).encoder for item in objects], graph)
    return entry.type.encode_column(values, graph)


_HEAD = tuple_of(sequence_of(TEXT), ANYTHING, sequence_of(tuple_of(TEXT, ANYTHING)))
"""Kinds, their codes by object, and columns by kind."""


class ObjectReader:
    """Reader that creates objects from columns and checks each attribute.

    Args:
        value: result of `ObjectWriter.encode`.
        changes: see `ReadContext`.

    Attributes:
        current_sources: receives the numbers of the objects that the object being read consists of.

    Raises:
        UsageError: if the value cannot have been created by `ObjectWriter`.
    """

    def __init__(
        self, value: object, external: ExternalObjects, changes: Mapping[str, Sequence[FieldChange]] = {}
    ):
        self.current_sources: List[int] = []
        self._owners: Dict[int, object] = {}
        """Owners of the objects that `claim` has recorded, by the identity of the object."""
        self._external = external
        self._context = ReadContext(self, changes)
        self._objects: List[object] = []
        self._sources: DefaultDict[int, List[int]] = defaultdict(list)
        kinds, codes, columns_by_kind = _HEAD.check(value)
        if type(codes) is not bytes or (codes and max(codes) >= len(kinds)) or len(set(kinds)) != len(kinds):
            raise invalid_value(codes, "codes of kinds")
        self._kinds: List[str] = kinds
        self._codes: bytes = codes
        columns = dict(columns_by_kind)
        if list(columns) != kinds or len(columns_by_kind) != len(kinds):
            raise invalid_value(list(columns), f"the kinds {', '.join(kinds)}")
        # Objects exist before their attributes are set, since references form cycles.
        objects_by_kind = {kind: self._create(kind, columns[kind]) for kind in kinds}
        numbers_by_kind = self._order_objects(objects_by_kind)
        stored_kinds = [kind for kind in kinds if kind in KINDS]
        for kind in stored_kinds:
            self._set_attributes(kind, objects_by_kind[kind], numbers_by_kind[kind], columns[kind])
        self._check_acyclic()
        for kind in stored_kinds:
            _derive_attributes(kind, objects_by_kind[kind])
        # Constraints can read derived attributes of other objects.
        for kind in stored_kinds:
            _check_constraints(kind, objects_by_kind[kind])

    def claim(self, item: object, owner: object) -> None:
        """Record that an object belongs to one owner.

        Raises:
            UsageError: if it belongs to another one.
        """
        if self._owners.setdefault(id(item), owner) != owner:
            raise UsageError(f"{type(item).__name__}: expected an object of one owner")

    def context(self) -> ReadContext:
        """Return the context of states that refer to these objects."""
        return self._context

    def is_reference(self, value: object) -> bool:
        """Return whether a decoded value is a reference."""
        return type(value) is Ref

    def reference_reader(self, kinds: Sequence[str], is_source: bool) -> ValueCheck[object]:
        """Return a check of references to objects of some kinds; the result is the object."""
        codes = self._codes_of(kinds)

        def check(value: object) -> object:
            if (
                type(value) is not Ref
                or value.number >= len(self._codes)
                or self._codes[value.number] not in codes
            ):
                raise invalid_value(value, f"a reference to {' or '.join(kinds)}")
            if is_source:
                self.current_sources.append(value.number)
            return self._objects[value.number]

        return check

    def objects_by_number(self, values: Sequence[object], kinds: Sequence[str]) -> List[object]:
        """Return the objects of some kinds with the given numbers."""
        numbers: Sequence[int] = COUNT.column_checker(NO_CONTEXT)(values, ())
        is_in_range = max(numbers, default=-1) < len(self._codes)
        if not is_in_range or not self._codes_of(kinds).issuperset(map(self._codes.__getitem__, numbers)):
            raise invalid_value(numbers, f"references to {' or '.join(kinds)}")
        return list(map(self._objects.__getitem__, numbers))

    def sources_of(self, number: int) -> List[int]:
        """Return the list of the numbers of the objects that an object consists of."""
        return self._sources[number]

    def _codes_of(self, kinds: Sequence[str]) -> FrozenSet[int]:
        return frozenset(self._kinds.index(kind) for kind in kinds if kind in self._kinds)

    def _create(self, kind: str, columns: object) -> List[object]:
        """Return the objects of a kind, without attributes."""
        size = self._codes.count(self._kinds.index(kind))
        if kind in KINDS:
            # The stored class may be more compact than the class of restored objects.
            restored_class, _ = KINDS[KINDS[kind][1].restored_kind]
            return [object.__new__(restored_class) for _ in range(size)]
        keys = sequence_of(sequence_of(COUNT, tuple)).check(columns)
        if len(keys) != size:
            raise invalid_value(len(keys), f"{size} objects of kind {kind}")
        return [self._external.find(kind, key) for key in keys]

    def _order_objects(self, objects_by_kind: Dict[str, List[object]]) -> Dict[str, List[int]]:
        """Store the objects in the order of their numbers, and return the numbers by kind."""
        numbers_by_kind: Dict[str, List[int]] = {kind: [] for kind in self._kinds}
        by_code = [(iter(objects_by_kind[kind]), numbers_by_kind[kind]) for kind in self._kinds]
        for number, code in enumerate(self._codes):
            objects, numbers = by_code[code]
            self._objects.append(next(objects))
            numbers.append(number)
        return numbers_by_kind

    def _set_attributes(
        self, kind: str, objects: Sequence[object], numbers: Sequence[int], stored: object
    ) -> None:
        """Check the columns of a kind and set the attributes of its objects."""
        _, state_fields = KINDS[kind]
        columns: Dict[str, Sequence[object]] = {}
        try:
            mapping = state_fields.mapping_of(stored, self._context)
        except UsageError as error:
            raise UsageError(f"{kind}: {error.message}") from None
        for entry in state_fields.fields:
            try:
                values = self._read_column(entry, mapping[entry.name], objects, numbers, columns)
            except UsageError as error:
                raise UsageError(f"{kind}: {entry.name}: {error.message}") from None
            columns[entry.name] = values
            for item, value in zip(objects, values):
                setattr(item, entry.attribute, value)

    def _read_column(
        self,
        entry: StoredField,
        column: object,
        objects: Sequence[object],
        numbers: Sequence[int],
        earlier_columns: Mapping[str, Sequence[object]],
    ) -> Sequence[object]:
        """Return the values of a field; its type may depend on fields that have been set before."""
        if column is None and entry.same_as is not None:
            return earlier_columns[entry.same_as]
        if isinstance(entry.type, FieldType):
            if column is None and numbers:
                # All values are None: one check decides whether they may be.
                return [entry.type.checker(self._context)(None)] * len(numbers)
            return check_column(entry.type, column, numbers, self._context)
        values = [None] * len(objects) if column is None else items_of(column)
        if len(values) != len(objects):
            raise invalid_value(len(values), f"{len(objects)} values")
        type_for = entry.type
        checked: List[object] = check_items(
            zip(objects, values),
            lambda pair: type_for(pair[0]).checker(self._context)(pair[1]),  # type: ignore[index]
        )
        return checked

    def _check_acyclic(self) -> None:
        """Check that no object consists of itself, by a depth-first search with an explicit stack."""
        # By object: 0 before the visit, 1 while the objects that it consists of are being visited, then 2.
        progress = bytearray(len(self._objects))
        for number in list(self._sources):
            stack = [number]
            while stack:
                current = stack[-1]
                if progress[current]:
                    progress[current] = 2
                    stack.pop()
                    continue
                progress[current] = 1
                for source in self._sources.get(current, ()):
                    if progress[source] == 1:
                        kind = self._kinds[self._codes[source]]
                        raise UsageError(f"object {source}, of kind {kind}, contains itself")
                    if not progress[source]:
                        stack.append(source)


def _derive_attributes(kind: str, objects: Sequence[object]) -> None:
    """Derive the attributes that are not stored."""
    owner_class, _ = KINDS[kind]
    after_restore: Optional[Callable[[object], None]] = getattr(owner_class, "after_restore", None)
    if after_restore is not None:
        for item in objects:
            after_restore(item)


def _check_constraints(kind: str, objects: Sequence[object]) -> None:
    _, state_fields = KINDS[kind]
    for constraint in state_fields.constraints:
        for item in objects:
            if not constraint.holds(item):
                raise UsageError(f"{kind}: expected {constraint.expected}")
