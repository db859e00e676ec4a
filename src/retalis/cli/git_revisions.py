"""Files of a revision of git, in a temporary folder."""

import os
import subprocess
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Mapping, NamedTuple

from ..foundation.errors import UsageError


class Revision(NamedTuple):
    """A revision whose files are in a folder.

    Attributes:
        root: folder with the files of the repository.
    """

    name: str
    root: Path
    program: Path

    def rename_paths(self, text: str) -> str:
        """Return a message in which paths of the folder have the form ``REVISION:PATH`` of git."""
        return text.replace(f"{self.root}/", f"{self.name}:").replace(str(self.root), f"{self.name}:")


def extract_revision(name: str, program: Path, stack: ExitStack) -> Revision:
    """Extract the whole repository of a program's folder, because programs may use files in other folders.

    Args:
        name: name of the revision, as of a commit, branch or tag.
        program: the program's folder.
        stack: removes the files when it is closed.

    Raises:
        UsageError: if the revision is unknown or has no such folder, or git fails.
    """
    place = f"--git {name}"
    top = Path(_read_line(place, program, "--show-toplevel"))
    prefix = _read_line(place, program, "--show-prefix")
    commit = _find_commit(place, name, program)
    folder = Path(stack.enter_context(TemporaryDirectory(prefix="retalis-"))).resolve()
    root = folder / "files"
    root.mkdir()
    # An index of its own leaves that of the user unchanged. `git archive` would omit files with the attribute
    # export-ignore, and change those with export-subst.
    index = {"GIT_INDEX_FILE": str(folder / "index")}
    _run_git(place, top, "read-tree", commit, variables=index)
    _run_git(place, top, "checkout-index", "--all", "--quiet", f"--prefix={root}/", variables=index)
    _remove_outside_links(root)
    if not (root / prefix).is_dir():
        raise UsageError(f"{place}: has no folder {prefix.rstrip('/')}: expected a revision with the program")
    return Revision(name, root, root / prefix)


def _find_commit(place: str, name: str, program: Path) -> str:
    """Return the hash of a revision, which unlike its name cannot be an option of git."""
    error = UsageError(f"{place}: unknown revision: expected a commit, branch or tag")
    # Older versions of `git rev-parse` have no `--end-of-options`. No name of a revision begins so.
    if name.startswith("-"):
        raise error
    try:
        return _read_line(place, program, "--verify", f"{name}^{{commit}}")
    except UsageError:
        raise error from None


def _read_line(place: str, folder: Path, *arguments: str) -> str:
    return os.fsdecode(_run_git(place, folder, "rev-parse", *arguments)).rstrip("\n")


def _run_git(place: str, folder: Path, *arguments: str, variables: Mapping[str, str] = {}) -> bytes:
    """Run git in a folder, with further environment variables; return its output."""
    try:
        process = subprocess.run(
            ["git", "-C", str(folder), *arguments],
            capture_output=True,
            check=True,
            env={**os.environ, **variables},
        )
    except FileNotFoundError:
        raise UsageError("--git needs the program git") from None
    except subprocess.CalledProcessError as error:
        text = error.stderr.decode("utf-8", "replace").strip()
        raise UsageError(f"{place}: {text}") from None
    return process.stdout


def _remove_outside_links(root: Path) -> None:
    """Remove the symbolic links that lead out of the folder, if need be by other links."""
    links = [
        Path(folder, name)
        for folder, folder_names, file_names in os.walk(root)
        for name in (*folder_names, *file_names)
        if os.path.islink(os.path.join(folder, name))
    ]
    # All are found before one is removed, because a link may lead out by another one.
    for link in [link for link in links if not _is_inside(link, root)]:
        link.unlink()


def _is_inside(path: Path, root: Path) -> bool:
    # `Path.resolve` raises an exception for links in a circle.
    return f"{os.path.realpath(path)}{os.sep}".startswith(f"{root}{os.sep}")
