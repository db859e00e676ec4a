"""Records in columns."""

from retalis.cli import page, report


def test_plain_values_and_tables():
    found = report(
        {"node": "/a", "memories": [{"id": "m", "size": 10}, {"id": "long", "size": 2}], "none": []}
    )
    assert found == ["node  /a", "none  -", "", "memories", "  id    size", "  m     10", "  long  2"]


def test_what_is_long_or_has_lines_is_shown_in_one_short_line():
    assert report({"text": "a\nb" + "c" * 100}) == ["text  a b" + "c" * 54 + "..."]


def test_records_in_records():
    assert report({"work": {"what": "a", "seconds": 1.5}, "x": [1, 2]}) == [
        "work  what a, seconds 1.5",
        "x     1; 2",
    ]


def test_instants_are_shown_to_the_microsecond_and_none_as_a_dash():
    assert report({"now": 1795367020.25, "lag": 0.000012, "at": 7.0, "oldest": None}) == [
        "now     1795367020.25",
        "lag     0.000012",
        "at      7",
        "oldest  -",
    ]


def test_nothing():
    assert report({}) == []


def test_of_a_path_the_end_is_shown():
    assert report({"a": "/x" * 100 + "/rules.txt:12:1"}) == [
        "a  ..." + ("/x" * 100 + "/rules.txt:12:1")[-57:]
    ]


def test_a_page_is_no_larger_than_its_terminal():
    found = {f"value{number}": number for number in range(50)}
    lines = page({**found, "rows": [{"a": "x" * 50, "b": number} for number in range(100)]}, 40, 30)
    assert len(lines) == 29 and max(map(len, lines)) <= 40
    assert lines[0] == "value1 1  value2 2  value3 3  value4 4"
