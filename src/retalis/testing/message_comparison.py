"""Comparison of published messages with expected slots. Slots that are not expected are not compared."""

from typing import Any, Iterator, List, Mapping, Optional

from ..foundation.similar_names import did_you_mean
from ..foundation.source_places import Place
from ..messages.type_definition import TIMES, Definition, Field
from ..prolog.terms import timestamps
from .case_definition import Tolerance
from .message_values import find_constant, read_float, read_time
from .yaml_documents import CaseFileError, YamlValue

FLOAT32_ROUNDING = 1.2e-7
"""Relative difference of numbers of type ``float32`` that is always allowed: the distance between two of them."""

_TIME_ROUNDING = 1_000
"""Allowed difference in nanoseconds of times that are numbers of seconds."""

_ANYTHING = "_"
"""Text in place of a value that is not compared."""


class SlotComparison:
    """Comparison of the slots of a message.

    Args:
        tolerance: tolerance for numbers.
        slot_tolerances: tolerances by path of a slot, which hold for all that is in it.
        start: time from which expected times count, in nanoseconds since the epoch.
    """

    def __init__(self, tolerance: Tolerance, slot_tolerances: Mapping[str, Tolerance], start: int):
        self._tolerance = tolerance
        self._slot_tolerances = slot_tolerances
        self._start = start

    def find_difference(
        self, definition: Definition, expected: YamlValue, actual: Mapping[str, Any], path: str = ""
    ) -> Optional[str]:
        """Return the first slot that differs, with both values, or None.

        Raises:
            CaseFileError: if the type has no slot of an expected name, or a slot has another type of value.
        """
        slots = {slot.name: slot for slot in definition.fields}
        for name, value in expected.mapping().items():
            if name not in slots:
                raise _no_slot(value, definition, name)
            slot_path = f"{path}.{name}" if path else name
            for difference in self._compare_slot(definition, slots[name], value, actual[name], slot_path):
                return difference
        return None

    def check_names(self, definition: Definition, expected: YamlValue) -> None:
        """Check that a type has the expected slots; elements of arrays are not checked.

        Raises:
            CaseFileError: if it does not have a slot.
        """
        slots = {slot.name: slot for slot in definition.fields}
        for name, value in expected.mapping().items():
            if name not in slots:
                raise _no_slot(value, definition, name)
            slot = slots[name]
            if slot.definition is not None and slot.length is None and value.is_mapping:
                self.check_names(slot.definition, value)

    def check_tolerance_paths(self, definition: Definition, place: Place) -> None:
        """Check that a type has the slots that have tolerances.

        Raises:
            CaseFileError: if it does not have a slot.
        """
        for path in self._slot_tolerances:
            inner: Optional[Definition] = definition
            for name in path.split("."):
                # Elements of arrays are named by their positions, as in ``covariance.0``.
                if name.isdecimal():
                    continue
                slots = {} if inner is None else {slot.name: slot for slot in inner.fields}
                if name not in slots:
                    raise CaseFileError(
                        f"tolerances: {definition.name} has no slot {path}{did_you_mean(name, slots)}", place
                    )
                inner = slots[name].definition

    def _compare_slot(
        self, definition: Definition, slot: Field, expected: YamlValue, actual: Any, path: str
    ) -> Iterator[str]:
        if expected.is_text and expected.text() == _ANYTHING:
            return
        if slot.length is None or (slot.is_bytes and expected.is_text):
            yield from self._compare_element(definition, slot, expected, actual, path)
            return
        elements: List[Any] = list(actual)
        expected_elements = expected.items()
        if len(elements) != len(expected_elements):
            yield f"{path} has {len(elements)} elements, expected {len(expected_elements)}"
            return
        for position, (element, value) in enumerate(zip(expected_elements, elements)):
            yield from self._compare_element(definition, slot, element, value, f"{path}.{position}")

    def _compare_element(
        self, definition: Definition, slot: Field, expected: YamlValue, actual: Any, path: str
    ) -> Iterator[str]:
        if expected.is_text and expected.text() == _ANYTHING:
            return
        if slot.definition is not None:
            difference = self.find_difference(slot.definition, expected, actual, path)
            if difference is not None:
                yield difference
            return
        if slot.type in TIMES:
            is_equal = self._is_expected_time(slot, expected, actual, path)
        elif isinstance(actual, bool):
            is_equal = expected.boolean() == actual
        elif isinstance(actual, (int, float)):
            constant = find_constant(definition, expected) if isinstance(actual, int) else None
            number = read_float(expected) if constant is None else constant
            is_equal = self._accepts_number(slot, number, actual, path)
        else:
            text = actual.decode("utf-8", "replace") if isinstance(actual, bytes) else actual
            is_equal = expected.text() == text
        if not is_equal:
            yield f"{path} is {_format(slot, actual)}, expected {expected.plain()}"

    def _accepts_number(self, slot: Field, expected: float, actual: float, path: str) -> bool:
        tolerance = self._tolerance_of(path)
        if slot.type == "float32":
            tolerance = tolerance._replace(relative=max(tolerance.relative, FLOAT32_ROUNDING))
        return tolerance.accepts(expected, actual)

    def _is_expected_time(self, slot: Field, expected: YamlValue, actual: int, path: str) -> bool:
        """Return whether a time is the expected one: ``{secs: S, nsecs: N}``, or seconds since the start of the case.

        The absolute tolerance is in seconds; numbers of seconds are compared to the microsecond.
        """
        tolerance = round(self._tolerance_of(path).absolute * timestamps.SECOND)
        if expected.is_mapping:
            return abs(read_time(expected, 0) - actual) <= tolerance
        origin = self._start if slot.type == "time" else 0
        difference = abs(timestamps.from_seconds(expected.number()) + origin - actual)
        return difference <= max(tolerance, _TIME_ROUNDING)

    def _tolerance_of(self, path: str) -> Tolerance:
        """Return the tolerance of the longest path that contains a slot."""
        while path:
            if path in self._slot_tolerances:
                return self._slot_tolerances[path]
            path = path.rpartition(".")[0]
        return self._tolerance


def _no_slot(value: YamlValue, definition: Definition, name: str) -> CaseFileError:
    names = [slot.name for slot in definition.fields]
    return value.error(f"{definition.name} has no slot {name}{did_you_mean(name, names)}")


def _format(slot: Field, value: Any) -> str:
    return f"{timestamps.to_seconds(value):.9f} s" if slot.type in TIMES else repr(value)
