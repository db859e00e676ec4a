"""``python3 -m retalis plot``: a run as a page."""

import sys
from pathlib import Path

import pytest

from retalis.cli.command_line import main

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "examples" / "nao"))
from make_bag import make_bag  # noqa: E402

PROGRAM = str(ROOT / "application_source")


@pytest.mark.slow
def test_a_run_is_the_same_from_the_bag_and_from_a_file(tmp_path, capsys):
    bag = tmp_path / "nao.bag"
    make_bag(bag, 1.0, 1)
    assert main(["plot", str(bag), "--program", PROGRAM, "-o", str(tmp_path / "a.html")]) == 0
    assert capsys.readouterr() == ("", "")
    assert main(["bag", str(bag), "--program", PROGRAM, "--events", "--json"]) == 0
    (tmp_path / "run.jsonl").write_text(capsys.readouterr().out, encoding="utf-8")
    assert main(["plot", "--from", str(tmp_path / "run.jsonl"), "-o", str(tmp_path / "b.html")]) == 0
    drawn, read = ((tmp_path / name).read_text(encoding="utf-8") for name in ("a.html", "b.html"))
    assert drawn.replace("application_source over nao.bag", "run.jsonl") == read
    assert '"name": "odom_base"' in drawn and '"kind": "wait"' in drawn


def test_wrong_options_are_refused(tmp_path, capsys):
    assert main(["plot", "x.bag", "--program", PROGRAM, "-o", "run.jpeg"]) == 1
    assert "expected a name that ends in one of .html, .htm, .png, .svg, .pdf" in capsys.readouterr().err
    assert main(["plot", "--from", str(tmp_path / "none"), "-o", "run.html"]) == 1
    assert "cannot read" in capsys.readouterr().err
    for arguments in (["x.bag", "--from", "y"], [], ["x.bag"]):
        with pytest.raises(SystemExit) as ended:
            main(["plot", *arguments, "-o", "run.html"])
        assert ended.value.code == 2
