"""Declarations of stored state: fields, constraints, and the objects that have them.

A class whose objects are in a snapshot has an attribute ``STATE``, which names its stored attributes and their types,
one a line. An object of a graph (`ObjectFields`) is written in columns by `object_graph`, because there may be
millions. The state of any other object (`StateFields`) is a mapping from names to values, which `StateOwner` reads
from attributes and sets again. `rows_of` declares the rows of a table, which is stored in columns, too.

A constraint is a named condition on several fields, or on fields and their owner. A type can depend on the owner: it
is then declared as a function of the owner. This is how the number of values of a match follows from its node, and
the state of an operator from its class.
"""

from __future__ import annotations

from itertools import chain, count
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Dict,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    Type,
    Union,
    overload,
)

from ..foundation.errors import UsageError
from .stored_field_types import (
    ANYTHING,
    COUNT,
    TEXT,
    Encode,
    FieldType,
    PlainType,
    ReadContext,
    Row,
    SameForAll,
    State,
    Value,
    ValueCheck,
    encode_each,
    invalid_value,
    items_of,
    optional,
    sequence_of,
    tuple_of,
    with_path,
)

if TYPE_CHECKING:
    from .object_graph import ObjectWriter

# ---- fields and their owners -------------------------------------------------------------------------------

DeclaredType = Union[FieldType[Any], Callable[[Any], FieldType[Any]]]
"""Type of a field, or a function that returns it, given the owner."""


class StoredField(NamedTuple):
    """Stored attribute of an object.

    Attributes:
        name: name in the file.
        type: its type, or a function of the owner that returns it.
        attribute: name of the attribute, or of a property with a setter.
        same_as: name of an earlier field with the same values for most objects: such a column is not stored.
        is_part: whether the attribute is a `StateOwner`, or None, whose state is stored.
        is_part_list: whether the attribute is a sequence of `StateOwner` whose states are stored.
    """

    name: str
    type: DeclaredType
    attribute: str
    same_as: Optional[str] = None
    is_part: bool = False
    is_part_list: bool = False

    def type_for(self, owner: object) -> FieldType[Any]:
        """Return the type of the field of an object."""
        return self.type if isinstance(self.type, FieldType) else self.type(owner)


def field(name: str, type: DeclaredType, same_as: Optional[str] = None) -> StoredField:  # noqa: A002
    """Return a field; the name of a private attribute is stored without its underscore."""
    return StoredField(name.lstrip("_"), type, name, same_as)


def part(name: str, check_item: str = "") -> StoredField:
    """Return a field for the state of a part: an attribute that is a `StateOwner`, or None.

    Args:
        name: name of the attribute.
        check_item: name of the owner's method that checks the objects in the state; see `ReadContext.check_item`.
    """

    def type_for(owner: object) -> FieldType[Optional[State]]:
        state_owner: Optional[StateOwner] = getattr(owner, name)
        if state_owner is None:
            return _NO_PART
        return optional(part_state(state_owner, getattr(owner, check_item) if check_item else None))

    return StoredField(name.lstrip("_"), type_for, name, is_part=True)


def part_list(
    name: str, attribute: str, expected: str, title: Callable[[Any], str] = lambda part: type(part).__name__
) -> StoredField:
    """Return a field for the states of several parts: an attribute that is a sequence of `StateOwner`.

    Args:
        name: name of the field.
        attribute: name of the attribute.
        expected: text of the error if the state has parts of other classes.
        title: returns the name of a part in error texts; by default its class.
    """
    return StoredField(
        name,
        lambda owner: states_of(getattr(owner, attribute), expected, title),
        attribute,
        is_part_list=True,
    )


class Constraint(NamedTuple):
    """Named condition on the fields of an object.

    Attributes:
        expected: description for the error.
        holds: returns whether it holds, given the object; for a `StateFields`, given the owner and the new state.
    """

    expected: str
    holds: Callable[..., bool]


def constraint(expected: str, holds: Callable[..., bool]) -> Constraint:
    """Return a constraint."""
    return Constraint(expected, holds)


class FieldList:
    """Fields and constraints of a record; the base class of `StateFields` and `ObjectFields`.

    Args:
        declared: the fields, in the order in which they are set, and the constraints.

    Attributes:
        record_name: name of the record in migrations: that of the class that has the declaration, or of the rows.
    """

    record_name = ""

    def __init__(self, *declared: Union[StoredField, Constraint]):
        self.fields = [entry for entry in declared if isinstance(entry, StoredField)]
        self.constraints = [entry for entry in declared if isinstance(entry, Constraint)]

    def __set_name__(self, owner: Type[object], name: str) -> None:
        self.record_name = owner.__name__

    def extended(self, *declared: Union[StoredField, Constraint]) -> Sequence[Union[StoredField, Constraint]]:
        """Return the fields and constraints together with further ones, for the declaration of a subclass."""
        return (*self.fields, *self.constraints, *declared)

    def describe(self) -> List[str]:
        """Return the names and types of the fields."""
        return [
            f"{entry.name}: {entry.type.name if isinstance(entry.type, FieldType) else 'depends on its owner'}"
            for entry in self.fields
        ]

    def mapping_of(self, value: object, context: ReadContext) -> Dict[str, object]:
        """Return stored fields by name, migrated to the present format.

        Raises:
            UsageError: if they are not exactly the declared ones.
        """
        mapping = read_named_values(value)
        for change in context.changes.get(self.record_name, ()):
            mapping = {
                change.renamed.get(name, name): stored
                for name, stored in mapping.items()
                if name not in change.removed
            }
            mapping.update({name: SameForAll(stored) for name, stored in change.added.items()})
            mapping = mapping if change.convert is None else change.convert(mapping)
        names = [entry.name for entry in self.fields]
        if len(mapping) != len(names) or any(name not in mapping for name in names):
            raise invalid_value(list(mapping), f"the fields {', '.join(names)}")
        return mapping

    def check_constraints(self, *arguments: object) -> None:
        """Check all constraints.

        Raises:
            UsageError: if one does not hold.
        """
        for entry in self.constraints:
            if not entry.holds(*arguments):
                raise UsageError(f"{self.record_name}: expected {entry.expected}")


def named_values(names: Sequence[str], values: Sequence[object]) -> List[object]:
    """Return alternating names and values. Checkpoints are encoded by level; pairs would be one level more."""
    return list(chain.from_iterable(zip(names, values)))


def read_named_values(value: object) -> Dict[str, object]:
    """Return the values of `named_values` by name.

    Raises:
        UsageError: if they are something else, or a name is repeated.
    """
    items = items_of(value)
    names, values = items[::2], items[1::2]
    mapping = {name: stored for name, stored in zip(names, values) if isinstance(name, str)}
    if 2 * len(mapping) != len(items):
        raise invalid_value(value, "alternating names and values, each name once")
    return mapping


def check_column(
    content: FieldType[Value], column: object, numbers: Sequence[int], context: ReadContext
) -> Sequence[Value]:
    """Return the values of a column for objects or rows with the given numbers."""
    if isinstance(column, SameForAll):
        return [content.checker(context)(column.value)] * len(numbers) if numbers else []
    values = content.column_checker(context)(column, numbers)
    if len(values) != len(numbers):
        raise invalid_value(len(values), f"{len(numbers)} values")
    return values


class StateFields(FieldList):
    """Fields of the state of one object, whose class is a `StateOwner`."""

    def __init__(self, *declared: Union[StoredField, Constraint]):
        super().__init__(*declared)
        # Checkpoints write all states twice a second, so what does not depend on the owner is computed once.
        self._names = [entry.name for entry in self.fields]
        self._attributes = [entry.attribute for entry in self.fields]
        self._parts = [
            (position, entry.attribute) for position, entry in enumerate(self.fields) if entry.is_part
        ]
        self._part_list_positions = [
            position for position, entry in enumerate(self.fields) if entry.is_part_list
        ]
        # Fields with an encoding, and fields whose type depends on the owner.
        self._encoded_fields: List[Tuple[int, Encode[Any]]] = []
        self._fields_of_owner: List[Tuple[int, StoredField]] = []
        for position, entry in enumerate(self.fields):
            if not isinstance(entry.type, FieldType):
                if not entry.is_part:
                    self._fields_of_owner.append((position, entry))
            elif entry.type.encoder is not None:
                self._encoded_fields.append((position, entry.type.encoder))

    def check_state(self, value: object, owner: object, context: ReadContext) -> State:
        """Return the values of the fields by name.

        Args:
            value: the stored state.
            owner: the object that the state will be set to.
            context: see `ReadContext`.

        Raises:
            UsageError: if a value is invalid; its text begins with the path of the field.
        """
        mapping = self.mapping_of(value, context)
        state: State = {}
        for entry in self.fields:
            check = with_path(entry.name, entry.type_for(owner).checker(context))
            state[entry.name] = check(_unwrapped(mapping[entry.name]))
        self.check_constraints(owner, state)
        return state

    def values_of(self, owner: object) -> State:
        """Return the values of the fields of an object by name."""
        values = [getattr(owner, attribute) for attribute in self._attributes]
        for position, _ in self._parts:
            if values[position] is not None:
                values[position] = values[position].snapshot()
        for position in self._part_list_positions:
            values[position] = [part.snapshot() for part in values[position]]
        return dict(zip(self._names, values))

    def encode_state(self, state: State, owner: object, graph: ObjectWriter) -> List[object]:
        """Return the encoding of a state."""
        values = list(map(state.__getitem__, self._names))
        for position, attribute in self._parts:
            if values[position] is not None:
                part: StateOwner = getattr(owner, attribute)
                values[position] = part.STATE.encode_state(values[position], part, graph)
        for position, encode in self._encoded_fields:
            values[position] = encode(values[position], graph)
        for position, entry in self._fields_of_owner:
            encode_for_owner = entry.type_for(owner).encoder
            if encode_for_owner is not None:
                values[position] = encode_for_owner(values[position], graph)
        return named_values(self._names, values)


class StateOwner:
    """Base class of objects with a state; its fields are attributes, properties with setters, or parts."""

    __slots__ = ()

    STATE = StateFields()

    def snapshot(self) -> State:
        """Return the state: the values of the declared fields by name."""
        return self.STATE.values_of(self)

    def restore(self, saved: State) -> None:
        """Set the state that an equal object has returned from `snapshot`."""
        for entry in self.STATE.fields:
            value = saved[entry.name]
            if entry.is_part_list:
                for part, state in zip(getattr(self, entry.attribute), value):
                    part.restore(state)
            elif not entry.is_part:
                setattr(self, entry.attribute, value)
            elif value is not None:
                getattr(self, entry.attribute).restore(value)


class NextNumber:
    """Property for the next number of a counter, which is stored in place of the counter.

    Args:
        attribute: name of the attribute with the counter, an `itertools.count`.
        doc: docstring of the property.
    """

    def __init__(self, attribute: str, doc: str):
        self._attribute = attribute
        self.__doc__ = doc

    @overload
    def __get__(self, owner: None, owner_class: type) -> NextNumber: ...

    @overload
    def __get__(self, owner: object, owner_class: Optional[type] = None) -> int: ...

    def __get__(self, owner: object, owner_class: Optional[type] = None) -> Union[int, NextNumber]:
        """Return the next number, or the property itself if it is read from the class."""
        if owner is None:
            return self
        # Reading the next number of a counter consumes it, so the counter is replaced.
        number: int = next(getattr(owner, self._attribute))
        self.__set__(owner, number)
        return number

    def __set__(self, owner: object, number: int) -> None:
        """Make the counter continue with a number."""
        setattr(owner, self._attribute, count(number))


def part_state(
    part: StateOwner, check_item: Optional[Callable[[object, int], None]] = None
) -> FieldType[State]:
    """Return the type of states of a part of an object; it depends on the object.

    Args:
        part: the part.
        check_item: check of the objects in its state, given the object and a channel; see `ReadContext.check_item`.
    """

    def checker(context: ReadContext) -> ValueCheck[State]:
        inner_context = context if check_item is None else context._replace(check_item=check_item)
        return lambda value: part.STATE.check_state(value, part, inner_context)

    return FieldType(
        "the state of a part",
        checker,
        lambda state, graph: part.STATE.encode_state(state, part, graph),
    )


def states_of(
    owners: Sequence[StateOwner], expected: str, title: Callable[[Any], str]
) -> FieldType[List[State]]:
    """Return the type of the states of several objects, each with the name of its class; see `part_list`."""

    def checker(context: ReadContext) -> ValueCheck[List[State]]:
        def check(value: object) -> List[State]:
            named_states = _NAMED_STATES.check(value)
            if [name for name, _ in named_states] != [type(owner).__name__ for owner in owners]:
                raise UsageError(expected)
            return [
                with_path(title(owner), part_state(owner).checker(context))(state)
                for owner, (_, state) in zip(owners, named_states)
            ]

        return check

    return FieldType(
        "the states of several objects",
        checker,
        lambda states, graph: [
            [type(owner).__name__, owner.STATE.encode_state(state, owner, graph)]
            for owner, state in zip(owners, states)
        ],
    )


_NAMED_STATES = sequence_of(tuple_of(TEXT, ANYTHING))
_NO_PART: PlainType[Optional[State]] = PlainType("nothing, because there is no such part", lambda value: None)


def _row_fields(row_class: Type[Row], contents: Mapping[str, FieldType[Any]]) -> FieldList:
    assert tuple(contents) == row_class._fields, row_class
    fields = FieldList(*(field(name, content) for name, content in contents.items()))
    fields.record_name = row_class.__name__
    return fields


def rows_of(row_class: Type[Row], **contents: FieldType[Any]) -> FieldType[List[Row]]:
    """Return the type of tables: sequences of named tuples, stored in columns."""
    fields = _row_fields(row_class, contents)
    make: Callable[..., Row] = row_class

    def checker(context: ReadContext) -> ValueCheck[List[Row]]:
        def check(value: object) -> List[Row]:
            row_count, stored = _TABLE.check(value)
            if not row_count and not stored:
                return []
            mapping = fields.mapping_of(stored, context)
            columns: Dict[str, Sequence[object]] = {}
            # Columns of the file first: their lengths are checked before a value is repeated for an added field.
            for name in sorted(contents, key=lambda name: isinstance(mapping[name], SameForAll)):
                columns[name] = with_path(
                    name,
                    lambda column, content=contents[name]: check_column(  # type: ignore[misc]
                        content, column, range(row_count), context
                    ),
                )(mapping[name])
            return list(map(make, *(columns[name] for name in contents)))

        return check

    def encode(rows: List[Row], graph: ObjectWriter) -> List[object]:
        if not rows:
            return [0, []]
        columns = [
            content.encode_column(list(column), graph)
            for content, column in zip(contents.values(), zip(*rows))
        ]
        return [len(rows), named_values(list(contents), columns)]

    return FieldType(f"rows of {fields.record_name}: ({', '.join(fields.describe())})", checker, encode)


_TABLE = tuple_of(COUNT, ANYTHING)
"""A table: number of rows, and columns."""


def record_of(row_class: Type[Row], **contents: FieldType[Any]) -> FieldType[Row]:
    """Return the type of named tuples, stored as mappings from names to values."""
    fields = _row_fields(row_class, contents)
    make: Callable[..., Row] = row_class

    def checker(context: ReadContext) -> ValueCheck[Row]:
        checks = {name: with_path(name, content.checker(context)) for name, content in contents.items()}

        def check(value: object) -> Row:
            mapping = fields.mapping_of(value, context)
            return make(
                **{name: check_value(_unwrapped(mapping[name])) for name, check_value in checks.items()}
            )

        return check

    names, encodings = list(contents), [content.encoder for content in contents.values()]
    return FieldType(
        f"{fields.record_name}: ({', '.join(fields.describe())})",
        checker,
        lambda record, graph: named_values(names, encode_each(record, encodings, graph)),
    )


def _unwrapped(stored: object) -> object:
    return stored.value if isinstance(stored, SameForAll) else stored


KINDS: Dict[str, Tuple[Type[object], ObjectFields]] = {}
"""Class and fields of each kind of object of a graph."""


class ObjectFields(FieldList):
    """Fields of the objects of a graph, which refer to each other in cycles; see `object_graph`.

    Args:
        kind: name of the kind.
        declared: see `FieldList`. Constraints get the object, after the fields of all objects have been set. A field
            whose type depends on its owner is set after the fields before it.
        restored_kind: kind whose class restored objects have; by default the same.
    """

    def __init__(self, kind: str, *declared: Union[StoredField, Constraint], restored_kind: str = ""):
        super().__init__(*declared)
        self.kind = kind
        self.restored_kind = restored_kind or kind

    def __set_name__(self, owner: Type[object], name: str) -> None:
        super().__set_name__(owner, name)
        KINDS[self.kind] = owner, self
