"""Records in columns."""

from retalis.cli import report


def test_plain_values_and_tables():
    found = report(
        {"node": "/a", "memories": [{"id": "m", "size": 10}, {"id": "long", "size": 2}], "none": []}
    )
    assert found == ["node  /a", "none", "", "memories", "  id    size", "  m     10", "  long  2"]


def test_what_is_long_or_has_lines_is_shown_in_one_short_line():
    assert report({"text": "a\nb" + "c" * 100}) == ["text  a b" + "c" * 54 + "..."]


def test_records_in_records():
    assert report({"work": {"what": "a", "seconds": 1.5}, "x": [1, 2]}) == [
        "work  what a, seconds 1.5",
        "x     1; 2",
    ]


def test_nothing():
    assert report({}) == []
