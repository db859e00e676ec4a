import argparse
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
from python_path import python_path

from retalis.cli import command_line
from retalis.cli.command_line import COMMANDS, main, make_parser

SOURCES = Path(__file__).resolve().parents[2] / "src"


def test_the_version_is_that_of_the_manifest(capsys, monkeypatch, tmp_path):
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    manifest = ElementTree.parse(SOURCES.parent / "package.xml").getroot()
    assert (ended.value.code, capsys.readouterr().out) == (0, f"retalis {manifest.findtext('version')}\n")
    monkeypatch.setattr(command_line, "MANIFEST", tmp_path / "package.xml")
    monkeypatch.setattr("importlib.metadata.version", lambda name: f"9 of {name}")
    assert command_line.version() == "9 of retalis"
    (tmp_path / "package.xml").write_text("<package><name>other</name><version>5</version></package>")
    assert command_line.version() == "9 of retalis"


def imported(*arguments):
    """Return the modules of the package that a command imports in a process of its own."""
    code = """import sys
from retalis.cli.command_line import main
try:
    main(sys.argv[1:])
except SystemExit:
    pass
print(*(name for name in sys.modules if name.startswith("retalis.")), file=sys.stderr)
"""
    result = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env={"PYTHONPATH": python_path(), "PATH": "/usr/bin:/bin"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert result.returncode == 0, result.stderr
    return set(result.stderr.split())


def test_the_version_imports_no_engine():
    found = imported("--version")
    assert {name.split(".")[1] for name in found} == {"cli", "foundation"}


@pytest.mark.parametrize("command", ["docs", "query", "status", "demo"])
def test_the_help_of_a_command_that_needs_none_imports_no_engine(command):
    assert {name.split(".")[1] for name in imported(command, "--help")} == {"cli", "foundation"}


@pytest.mark.slow
def test_a_command_imports_no_other_command_and_bags_only_if_it_reads_them():
    found = imported("events", "--help")
    assert "retalis.cli.event_stream_command" in found
    assert not [name for name in found if name.startswith("retalis.playback")]
    assert not found & {
        f"retalis.cli.{path.partition('.')[0]}"
        for path in COMMANDS.values()
        if "event_stream_command" not in path
    }


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_of_a_command_is_the_same_without_the_others(name, capsys):
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    assert (ended.value.code, capsys.readouterr().out) == (0, parsers()[name].format_help())


def test_the_help_lists_all_commands(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    text = capsys.readouterr().out
    assert set(parsers()) == set(COMMANDS)
    assert all(f"\n    {name} " in text for name in COMMANDS)


def test_without_a_command_the_help_is_an_error_message(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    text = capsys.readouterr().out
    assert main([]) == 2
    assert capsys.readouterr() == ("", text)


def parsers():
    """Return the parser of each command by its name."""
    return make_parser([])[1]


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
