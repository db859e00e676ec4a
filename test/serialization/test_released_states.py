"""State files of released versions, and of made-up older formats, are restored."""

import json
from typing import Any, Dict, List

import pytest
from serialization.field_dictionaries import fields_of, to_fields
from serialization.released_states import FLAGS, FOLDER, continued_outputs, engine_with_state

from retalis import Engine, StreamClock, UsageError
from retalis.serialization.codec import from_bytes, to_bytes
from retalis.serialization.state_fields import KINDS, StateFields, StateOwner
from retalis.serialization.state_file_format import (
    FORMAT_NUMBER,
    MIGRATIONS,
    pack_sections,
    unpack_sections,
)
from retalis.serialization.stored_field_types import FieldChange

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
    for number in range(min(MIGRATIONS), FORMAT_NUMBER - 1):
        monkeypatch.delitem(MIGRATIONS, number)
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


# ---- row patterns in format 13, which lists the elements of each match ---------------------------------

OVERLAPPING_STEPS = """
rising(L) <- aggregate(list(X), e(X), L, steps([a(2, many) where X > prev(X)], [after_match(skip_to_next)])).
low_high(L) <- aggregate(list(X), e(X), L, steps([low where X < 5, later(high) where X > 8])).
"""


def engine_with_steps() -> Engine:
    engine = Engine(StreamClock())
    engine.load(OVERLAPPING_STEPS)
    for second, value in enumerate([7, 3, 4, 5, 6]):
        engine.event(f"e({value})", second)
    return engine


def outputs_of_steps(engine: Engine) -> List[str]:
    outputs: List[str] = []
    engine.on_event(lambda term, start, end: outputs.append(engine.show(term)))
    for second, value in enumerate([7, 1, 9, 10, 2], start=10):
        engine.event(f"e({value})", second)
    return [output for output in outputs if not output.startswith("e(")]


def in_format_13(data: Any) -> Any:
    """Return the data of a section with a list of elements in place of the nodes of each match."""
    if not isinstance(data, list):
        return data
    names = data[::2]
    if "nodes" not in [name for name in names if isinstance(name, str)]:
        return [in_format_13(item) for item in data]
    partitions = fields_of(data)
    for column, (_, nodes) in enumerate(partitions.pop("nodes")):
        node_fields = fields_of(nodes)

        def assignments_of(node: Any, start: int, rows: Any = node_fields) -> List[List[int]]:
            pairs: List[List[int]] = []
            while node is not None and rows["element"][node] >= start:
                pairs.insert(0, [rows["element"][node], rows["step"][node]])
                node = rows["previous"][node]
            return pairs

        for name in ("states", "completed"):
            count, stored = partitions[name][column]
            rows = fields_of(stored) if count else {"last_node": [], "start_order": []}
            matches = zip(rows.pop("last_node"), rows.pop("start_order"))
            assignments = [assignments_of(*match) for match in matches]
            if name == "completed":
                partitions[name][column] = assignments
            else:
                del rows["totals"]
                partitions[name][column] = [count, to_fields({**rows, "assignments": assignments})]
    return to_fields(partitions)


def test_matches_of_row_pattern_in_format_13_are_restored() -> None:
    engine = engine_with_steps()
    sections = unpack_sections(engine.snapshot()).sections
    matches = from_bytes(sections["matches"])
    assert b"start_order" in to_bytes(matches)
    older = {**sections, "matches": to_bytes(in_format_13(matches))}
    assert b"assignments" in older["matches"]
    assert b"start_order" not in older["matches"]
    expected = outputs_of_steps(engine)
    assert len(expected) == 7
    assert outputs_of_steps(Engine.restore(pack_sections(older, 13))) == expected


def test_malformed_row_pattern_in_format_13_is_refused() -> None:
    sections = unpack_sections(engine_with_steps().snapshot()).sections
    older = to_bytes(in_format_13(from_bytes(sections["matches"])))
    sections["matches"] = older.replace(b"assignments", b"assignment_")
    with pytest.raises(UsageError, match="section matches: .*expected the fields"):
        Engine.restore(pack_sections(sections, 13))
