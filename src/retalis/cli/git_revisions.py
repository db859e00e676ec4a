"""Files of a revision of git, in a temporary folder."""

import os
import subprocess
import tarfile
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import IO, NamedTuple, Union

from ..foundation.errors import UsageError


class Revision(NamedTuple):
    """A revision whose files are in a folder.

    Attributes:
        name: name of the revision.
        root: folder with the files of the repository.
        program: folder of the program in it.
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
    root = Path(stack.enter_context(TemporaryDirectory(prefix="retalis-"))).resolve()
    with TemporaryFile() as archive:
        _run_git(place, top, archive, "archive", "--format=tar", commit)
        archive.seek(0)
        with tarfile.open(fileobj=archive) as tar:
            _extract_files(tar, root)
            _extract_links(tar, root)
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
    output = _run_git(place, folder, subprocess.PIPE, "rev-parse", *arguments)
    return os.fsdecode(output).rstrip("\n")


def _run_git(place: str, folder: Path, output: Union[int, IO[bytes]], *arguments: str) -> bytes:
    """Run git in a folder; return its output if that is a pipe."""
    try:
        process = subprocess.run(
            ["git", "-C", str(folder), *arguments], stdout=output, stderr=subprocess.PIPE, check=True
        )
    except FileNotFoundError:
        raise UsageError("--git needs the program git") from None
    except subprocess.CalledProcessError as error:
        text = error.stderr.decode("utf-8", "replace").strip()
        raise UsageError(f"{place}: {text}") from None
    return process.stdout or b""


def _extract_files(tar: tarfile.TarFile, root: Path) -> None:
    for member in tar:
        target = root / member.name
        # Names that lead out of the folder are not parts of a program.
        if member.isfile() and _is_inside(target, root):
            target.parent.mkdir(parents=True, exist_ok=True)
            content = tar.extractfile(member)
            assert content is not None
            target.write_bytes(content.read())


def _extract_links(tar: tarfile.TarFile, root: Path) -> None:
    """Create the symbolic links, and remove those that lead out of the folder, if need be by other links."""
    links = []
    for member in tar:
        target = root / member.name
        if member.issym() and _is_inside(target, root) and not os.path.lexists(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            target.symlink_to(member.linkname)
            links.append(target)
    for link in [link for link in links if not _is_inside(link, root)]:
        link.unlink()


def _is_inside(path: Path, root: Path) -> bool:
    # `Path.resolve` raises an exception for links in a circle.
    return f"{os.path.realpath(path)}{os.sep}".startswith(f"{root}{os.sep}")
