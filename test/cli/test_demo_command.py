"""``python3 -m retalis demo``: the NAO example without ROS."""

import sys
from pathlib import Path

import pytest

from retalis.cli import demo_command
from retalis.cli.command_line import main

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "examples" / "nao"))
from make_bag import make_bag  # noqa: E402


def test_locates_the_markers(capsys):
    assert main(["demo", "--seconds", "4", "--seed", "3"]) == 0
    shown = capsys.readouterr()
    assert shown.err == ""
    assert "4x4_1" in shown.out


def test_plays_a_bag_that_is_given(tmp_path, capsys):
    bag = tmp_path / "nao.bag"
    make_bag(bag, 3.0, 2)
    assert main(["demo", "--bag", str(bag)]) == 0
    assert "4x4_1" in capsys.readouterr().out


def test_a_bag_that_is_not_there_is_an_error(tmp_path, capsys):
    assert main(["demo", "--bag", str(tmp_path / "no.bag")]) == 1
    assert "no.bag: there is no such file" in capsys.readouterr().err
    (tmp_path / "no.bag").touch()
    assert main(["demo", "--bag", str(tmp_path / "no.bag")]) == 1
    assert "no.truth.json" in capsys.readouterr().err


def test_finds_the_example_in_the_source_tree():
    assert demo_command.example_folder() == ROOT / "examples" / "nao"


def test_wrong_options_end_with_status_2(capsys):
    for arguments in (["demo", "--seconds", "soon"], ["demonstrate"], []):
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == 2
    assert "usage: retalis" in capsys.readouterr().err


@pytest.mark.parametrize("seconds", ["-1", "0", "nan", "inf", "some"])
def test_a_length_that_is_none_is_refused(seconds, capsys):
    with pytest.raises(SystemExit) as caught:
        main(["demo", "--seconds", seconds])
    assert caught.value.code == 2
    assert f"expected a positive number of seconds, found {seconds}" in capsys.readouterr().err
