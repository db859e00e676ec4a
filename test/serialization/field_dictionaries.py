"""Fields of a decoded state: alternating names and values."""

from typing import Any, List


def fields_of(data: Any) -> Any:
    """Return the values of stored fields by name."""
    return dict(zip(data[::2], data[1::2]))


def to_fields(values: Any) -> List[Any]:
    """Return stored fields, given their values by name."""
    return [item for pair in values.items() for item in pair]
