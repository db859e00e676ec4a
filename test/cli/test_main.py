import argparse
from pathlib import Path
from xml.etree import ElementTree

import pytest

from retalis.cli import main, version

SOURCES = Path(__file__).resolve().parents[2] / "src"


def test_the_version_is_that_of_the_manifest(capsys, monkeypatch, tmp_path):
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    manifest = ElementTree.parse(SOURCES.parent / "package.xml").getroot()
    assert (ended.value.code, capsys.readouterr().out) == (0, f"retalis {manifest.findtext('version')}\n")
    monkeypatch.setattr(version, "MANIFEST", tmp_path / "package.xml")
    monkeypatch.setattr(version.metadata, "version", lambda name: f"9 of {name}")
    assert version.version() == "9 of retalis"
    (tmp_path / "package.xml").write_text("<package><name>other</name><version>5</version></package>")
    assert version.version() == "9 of retalis"


def parsers():
    """Return the parser of each command by its name."""
    found = []

    def parse(parser, arguments=None):
        found.append(parser)
        raise SystemExit(0)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(argparse.ArgumentParser, "parse_args", parse)
        with pytest.raises(SystemExit):
            main([])
    (commands,) = [action.choices for action in found[0]._actions if isinstance(action.choices, dict)]
    return commands


@pytest.mark.parametrize("name, parser", parsers().items())
def test_the_help_of_each_command_is_alike(name, parser):
    assert parser.description[0].isupper() and parser.description.rstrip().endswith(".")
    for action in parser._actions:
        said = action.help
        assert said and said[-1] not in ".:" and (said == argparse.SUPPRESS or not said[:2].istitle()), said
        if action.nargs != 0:
            shown = action.metavar or "".join(action.choices or ())
            assert shown, f"{name} {action.dest}: a word for its value"


@pytest.mark.parametrize("name, parser", parsers().items())
def test_what_is_no_number_is_told_as_such_in_each_command(name, parser, capsys):
    for action in parser._actions:
        if action.option_strings and action.type not in (None, Path):
            with pytest.raises(SystemExit) as ended:
                main([name, f"{action.option_strings[0]}=many"])
            said = capsys.readouterr().err.splitlines()[-1]
            assert (ended.value.code, said.partition(": expected ")[1]) == (2, ": expected "), said
            assert said.endswith(("found many", "found 'many'"))
