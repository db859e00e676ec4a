"""Language features in texts that are being typed: no text is an error, and places are within the text."""

from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st
from parsed_sources import ROOT

from retalis import Definitions
from retalis.editing.language_features import complete, hover
from retalis.editing.program_index import ProgramIndex, index_file

RULES = (ROOT / "examples/cookbook/battery/eventRules.txt").read_text(encoding="utf-8")
GOALS = (ROOT / "application_source/goalPredicates.txt").read_text(encoding="utf-8")
TOPICS = (ROOT / "application_source/pub_sub.xml").read_text(encoding="utf-8")
FILES = {"eventRules.txt": RULES, "goalPredicates.txt": GOALS, "pub_sub.xml": TOPICS}
INSERTIONS = st.text(alphabet="aX1(){}[]|,.:-<>% \n/*'\"\\\0\u00e9\U0001f916", max_size=6)
DEFINITIONS = Definitions()


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(sorted(FILES)), st.floats(0, 1), INSERTIONS, st.booleans())
def test_unfinished_text_is_no_error(name: str, part: float, insertion: str, has_rest: bool) -> None:
    original = FILES[name]
    cut = int(part * len(original))
    text = original[:cut] + insertion + (original[cut:] if has_rest else "")
    offset = cut + len(insertion)
    path = str(Path("/program") / name)
    index = ProgramIndex("/program", {path: index_file(path, text)})
    for use in index.files[path].uses:
        assert text[use.start : use.end].strip("'").replace("''", "'") or use.symbol.name == ""
        assert use.clause_start <= use.start <= use.end <= use.clause_end <= len(text)
    for completion in complete(path, text, offset, index, DEFINITIONS, {}):
        assert completion.text
    hovered = hover(path, offset, index, DEFINITIONS, {})
    assert hovered is None or 0 <= hovered.start <= offset <= hovered.end <= len(text)
