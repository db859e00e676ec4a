"""Files of a revision of git."""

import subprocess
from contextlib import ExitStack
from pathlib import Path

from retalis.cli.git_revisions import extract_revision


def run_git(folder: Path, *arguments: str) -> None:
    names = ("-c", "user.name=me", "-c", "user.email=me@example.org")
    subprocess.run(["git", *names, *arguments], cwd=str(folder), check=True, capture_output=True, timeout=60)


def test_links_inside_the_repository_are_kept(tmp_path: Path) -> None:
    program = tmp_path / "program"
    (program / "deep").mkdir(parents=True)
    (tmp_path / "rules.txt").write_text("a <- b.")
    (program / "deep" / "file").write_text("")
    links = {
        "rules.txt": "../rules.txt",
        "top": "..",
        "circle": "circle",
        "absolute": "/etc/hostname",
        "outside": "../../secret",
        # Inside by its text, and outside by the other link.
        "deep/indirect": "../top/../secret",
    }
    for name, target in links.items():
        (program / name).symlink_to(target)
    run_git(tmp_path, "init")
    run_git(tmp_path, "add", ".")
    run_git(tmp_path, "commit", "-m", "first")
    with ExitStack() as stack:
        revision = extract_revision("HEAD", program, stack)
        names = {path.relative_to(revision.program).as_posix() for path in revision.program.rglob("*")}
        assert {"rules.txt", "top", "deep", "deep/file"} <= names
        assert not names & {"absolute", "outside", "deep/indirect"}
        assert (revision.program / "rules.txt").read_text() == "a <- b."
        assert revision.rename_paths(f"{revision.program}/x:1: wrong") == "HEAD:program/x:1: wrong"
    assert not revision.root.exists()


def test_attributes_of_archives_are_ignored(tmp_path: Path) -> None:
    (tmp_path / ".gitattributes").write_text("tests export-ignore\nrules.txt export-subst\n")
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "data.txt").write_text("facts")
    (tmp_path / "rules.txt").write_text("% $Format:%H$")
    run_git(tmp_path, "init")
    run_git(tmp_path, "add", ".")
    run_git(tmp_path, "commit", "-m", "first")
    (tmp_path / "tests" / "new.txt").write_text("staged")
    run_git(tmp_path, "add", ".")
    with ExitStack() as stack:
        revision = extract_revision("HEAD", tmp_path / "tests", stack)
        assert [path.name for path in revision.program.iterdir()] == ["data.txt"]
        assert (revision.root / "rules.txt").read_text() == "% $Format:%H$"
    staged = subprocess.run(
        ["git", "diff", "--cached", "--name-only"], cwd=str(tmp_path), stdout=subprocess.PIPE, check=True
    )
    assert staged.stdout == b"tests/new.txt\n"
