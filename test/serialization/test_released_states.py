"""State files of released versions, and of made-up older formats, are restored."""

import json
from typing import Any, Dict, List

import pytest
from serialization.field_dictionaries import fields_of
from serialization.released_states import FLAGS, FOLDER, continued_outputs, engine_with_state

from retalis import Engine, UsageError
from retalis.serialization.codec import from_bytes, to_bytes
from retalis.serialization.field_types import FieldChange
from retalis.serialization.state_fields import KINDS, StateFields, StateOwner
from retalis.serialization.state_file_format import (
    FORMAT_NUMBER,
    MIGRATIONS,
    pack_sections,
    unpack_sections,
)

RELEASES = sorted(path.stem for path in FOLDER.glob("*.json"))


def state_of(release: Any, flags: Any) -> bytes:
    return (FOLDER / f"{release}-{flags}.state").read_bytes()


def state_owners(base: Any = StateOwner) -> List[Any]:
    """Return the classes of the package that declare fields."""
    owners = [base] if base.STATE.fields and base.__module__.startswith("retalis.") else []
    return [*owners, *(owner for subclass in base.__subclasses__() for owner in state_owners(subclass))]


def test_state_of_each_release_is_stored() -> None:
    assert "1.1.0" in RELEASES


@pytest.mark.parametrize("release", RELEASES)
@pytest.mark.parametrize("flags", FLAGS)
def test_state_of_release_is_restored(release: Any, flags: Any) -> None:
    expected = json.loads((FOLDER / f"{release}.json").read_text(encoding="utf-8"))[flags]
    restored = Engine.restore(state_of(release, flags))
    assert continued_outputs(restored) == expected


NEWER_RECORDS = {"HeldHoppingWindow", "HeldWindow", "NotPrecededFilter", "SessionWindow"}
"""Records that are newer than the states of the last release; the states of the next release have them."""


def test_states_of_release_have_all_records(monkeypatch: pytest.MonkeyPatch) -> None:
    checked, kinds = set(), set()
    check_state = StateFields.check_state

    def record_check(fields: Any, value: Any, owner: Any, scope: Any) -> Dict[str, Any]:
        checked.add(fields.record_name)
        return check_state(fields, value, owner, scope)

    monkeypatch.setattr(StateFields, "check_state", record_check)
    for flags in FLAGS:
        data = state_of(RELEASES[-1], flags)
        Engine.restore(data)
        kinds.update(fields_of(from_bytes(unpack_sections(data).sections["matches"]))["objects"][0])
    assert kinds >= set(KINDS)
    assert {owner.STATE.record_name for owner in state_owners()} - checked == NEWER_RECORDS


def describe_fields() -> List[str]:
    """Return the declared fields of all records."""
    records = {owner.STATE.record_name: owner.STATE for owner in state_owners()}
    records.update({fields.record_name: fields for _, fields in KINDS.values()})
    return [f"{name}: {entry}" for name, fields in sorted(records.items()) for entry in fields.describe()]


def test_fields_are_those_of_the_format() -> None:
    """If this fails, raise FORMAT_NUMBER, add the changes to MIGRATIONS, and store the new fields."""
    stored = (FOLDER / f"fields-{FORMAT_NUMBER}.txt").read_text(encoding="utf-8")
    assert "\n".join(describe_fields()) == stored.rstrip("\n")


# ---- migrations --------------------------------------------------------------------------------------

OLDER_FORMATS = {
    FORMAT_NUMBER - 2: {
        "EventRule": FieldChange(renamed={"lost_alarms": "lost_alarm_count"}, removed=["colour"]),
    },
    FORMAT_NUMBER - 1: {
        "EventRule": FieldChange(renamed={"lost_alarm_count": "dropped_alarm_count"}),
        "StoredTimer": FieldChange(renamed={"plan": "schedule"}, removed=["colour"]),
        "Timers": FieldChange(added={"omitted_count": 0}),
        "RunCursor": FieldChange(renamed={"length_before": "prefix_length"}, added={"consumed_by": None}),
        "StreamClock": FieldChange(),
        "Clock": FieldChange(convert=lambda fields: {**fields, "behind": bool(fields["behind"])}),
    },
}
"""Changes from two made-up formats."""


def with_older_fields(fields: Any) -> List[Any]:
    """Return stored fields as the oldest of the made-up formats would have them."""
    older = fields_of(fields)
    names = list(older)
    if "dropped_alarm_count" in names:
        older["lost_alarms"] = older.pop("dropped_alarm_count")
        older["colour"] = "red"
    if "schedule" in names:
        older["plan"] = older.pop("schedule")
        older["colour"] = [None] * len(older["plan"])
    older.pop("omitted_count", None)
    if "prefix_length" in names:
        older["length_before"] = older.pop("prefix_length")
        del older["consumed_by"]
    if "behind" in names:
        older["behind"] = int(older["behind"])
    return [item for name, value in older.items() for item in (name, as_older(value))]


def as_older(data: Any) -> Any:
    """Return the data of a section as the oldest of the made-up formats would have it."""
    if not isinstance(data, list):
        return data
    names = data[::2]
    has_fields = 2 * len(names) == len(data) and all(isinstance(name, str) for name in names)
    if has_fields and len(set(names)) == len(names):
        return with_older_fields(data)
    return [as_older(item) for item in data]


@pytest.fixture
def older_state() -> bytes:
    """Return the state of an engine in the oldest of the made-up formats."""
    sections = unpack_sections(engine_with_state("plain").snapshot()).sections
    older = {
        name: to_bytes(as_older(from_bytes(data))) if name in ("matches", "run") else data
        for name, data in sections.items()
    }
    assert b"lost_alarms" in older["matches"]
    return pack_sections(older, FORMAT_NUMBER - 2)


def test_older_state_is_migrated(monkeypatch: pytest.MonkeyPatch, older_state: bytes) -> None:
    for number, changes in OLDER_FORMATS.items():
        monkeypatch.setitem(MIGRATIONS, number, changes)
    restored = Engine.restore(older_state)
    assert continued_outputs(restored) == continued_outputs(engine_with_state("plain"))


def test_state_older_than_migrations_is_refused(monkeypatch: pytest.MonkeyPatch, older_state: bytes) -> None:
    monkeypatch.delitem(MIGRATIONS, FORMAT_NUMBER - 2)
    monkeypatch.setitem(MIGRATIONS, FORMAT_NUMBER - 1, OLDER_FORMATS[FORMAT_NUMBER - 1])
    expected = (
        f"format {FORMAT_NUMBER - 2}: this version reads formats {FORMAT_NUMBER - 1} to {FORMAT_NUMBER}"
    )
    with pytest.raises(UsageError, match=expected):
        Engine.restore(older_state)


def test_missing_field_is_refused_without_migration(
    monkeypatch: pytest.MonkeyPatch, older_state: bytes
) -> None:
    monkeypatch.setitem(MIGRATIONS, FORMAT_NUMBER - 2, {})
    monkeypatch.setitem(MIGRATIONS, FORMAT_NUMBER - 1, {})
    with pytest.raises(UsageError, match="section run: clock: behind: '0': expected true or false"):
        Engine.restore(older_state)
