"""Command line: version, help, imports, and options of all commands."""

import argparse
import subprocess
import sys
from pathlib import Path
from typing import Any, Dict, Set
from xml.etree import ElementTree

import pytest
from subprocess_python_path import python_path

from retalis.cli import command_line
from retalis.cli.command_line import COMMANDS, main, make_parser
from retalis.cli.result_partitions import parse_robot
from retalis.cli.short_help_parser import ShortHelpParser

SOURCES = Path(__file__).resolve().parents[2] / "src"


def test_version_is_read_from_manifest(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with pytest.raises(SystemExit) as raised:
        main(["--version"])
    manifest = ElementTree.parse(SOURCES.parent / "package.xml").getroot()
    assert (raised.value.code, capsys.readouterr().out) == (0, f"retalis {manifest.findtext('version')}\n")
    monkeypatch.setattr(command_line, "MANIFEST", tmp_path / "package.xml")
    monkeypatch.setattr("importlib.metadata.version", lambda name: f"9 of {name}")
    assert command_line.version() == "9 of retalis"
    (tmp_path / "package.xml").write_text("<package><name>other</name><version>5</version></package>")
    assert command_line.version() == "9 of retalis"


def imported_modules(*arguments: Any) -> Set[Any]:
    """Return the modules of the package that a command imports in a separate process."""
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


def test_version_imports_no_engine() -> None:
    modules = imported_modules("--version")
    assert {name.split(".")[1] for name in modules} == {"cli", "foundation"}


@pytest.mark.parametrize("command", ["docs", "query", "status", "demo"])
def test_help_without_engine_imports_no_engine(command: str) -> None:
    assert {name.split(".")[1] for name in imported_modules(command, "--help")} == {"cli", "foundation"}


@pytest.mark.slow
def test_command_imports_only_needed_modules() -> None:
    modules = imported_modules("events", "--help")
    assert "retalis.cli.event_stream_command" in modules
    assert not [name for name in modules if name.startswith("retalis.playback")]
    assert not modules & {
        f"retalis.cli.{path.partition('.')[0]}"
        for path in COMMANDS.values()
        if "event_stream_command" not in path
    }


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_command_equals_full_parser(name: Any, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as raised:
        main([name, "--help"])
    assert (raised.value.code, capsys.readouterr().out) == (0, parsers()[name].format_help())


def test_help_lists_all_commands(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--help"])
    text = capsys.readouterr().out
    assert set(parsers()) == set(COMMANDS)
    assert all(f"\n    {name} " in text for name in COMMANDS)


def test_missing_command_prints_help_as_error(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--help"])
    text = capsys.readouterr().out
    assert main([]) == 2
    assert capsys.readouterr() == ("", text)


def parsers() -> Dict[str, ShortHelpParser]:
    """Return the parser of each command by its name."""
    return make_parser([])[1]


@pytest.mark.parametrize(("name", "parser"), parsers().items())
def test_help_of_each_command_has_common_form(name: Any, parser: Any) -> None:
    assert parser.description[0].isupper()
    assert parser.description.rstrip().endswith(".")
    for action in parser._actions:
        text = action.help
        assert text
        assert text[-1] not in ".:", text
        assert text == argparse.SUPPRESS or not text[:2].istitle(), text
        assert not text.startswith("its "), f"{text}: completion shows this text alone"
        if action.nargs != 0:
            value_name = action.metavar or "".join(action.choices or ())
            assert value_name, f"{name} {action.dest}: a word for its value"


NUMERIC_OPTIONS = [
    (command, action.option_strings[0])
    for command, parser in parsers().items()
    for action in parser._actions
    if action.option_strings and action.type not in (None, Path, parse_robot)
]


def test_some_commands_have_numeric_options() -> None:
    assert {("bag", "--start"), ("console", "--most"), ("query", "--timeout")} <= set(NUMERIC_OPTIONS)


@pytest.mark.parametrize(("command", "option"), NUMERIC_OPTIONS)
def test_invalid_number_is_a_usage_error(
    command: Any, option: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as raised:
        main([command, f"{option}=many"])
    message = capsys.readouterr().err.splitlines()[-1]
    assert raised.value.code == 2
    assert ": expected " in message
    assert message.endswith(("found many", "found 'many'"))
