"""The trail of the abstract machine."""

from retalis.prolog.machine.machine import drop_unshared


class Entry:
    """An entry that may refer to another one."""

    next: "Entry"


class OtherEntry(Entry):
    """An entry of another class."""


def test_entries_without_other_references_are_dropped() -> None:
    kept, chained = Entry(), Entry()
    chained.next = Entry()
    entries = [Entry(), kept, OtherEntry(), chained.next, Entry()]
    # The last entry has no other reference once the one before it is dropped.
    entries[4].next = Entry()
    entries.append(entries[4].next)
    remaining = drop_unshared(entries, Entry)
    assert entries == []
    assert [type(entry) for entry in remaining] == [Entry, OtherEntry, Entry]
    assert remaining[0] is kept
    assert remaining[2] is chained.next
