"""Stub for catkin, with the parts of the metadata that `pyproject.toml` cannot express: the README without links to
files, and the files outside the package with their folders.
"""

import os
import re
from pathlib import Path

from setuptools import find_packages, setup

SHARED = ("application_source", "examples/nao", "examples/cookbook")
"""Folders that the commands ``demo`` and ``help`` read; `CMakeLists.txt` installs them for catkin."""

PAGES = ("explanation", "how-to", "reference", "tutorials")
"""Folders of pages that the commands ``help`` and ``console`` search."""

SITE = "docs/_build/html"
"""Documentation site, which ``./install.py docs`` builds; a wheel contains it if it exists."""

COMPLETIONS = [
    ("share/bash-completion/completions", ["src/retalis/cli/retalis.bash"]),
    ("share/zsh/site-functions", ["src/retalis/cli/_retalis"]),
    ("share/fish/vendor_completions.d", ["src/retalis/cli/retalis.fish"]),
]

_IMAGE = re.compile(r"!\[([^\]]*)\]\([^)]*\)")
_LINK = re.compile(r"\[([^\]]*)\]\((?!https?://|#)[^)]*\)")


def place_files(source: str, target: str, suffix: str = "") -> list:
    """Return the files of a folder and its subfolders, and their folders in an installation.

    Args:
        source: folder; it may be missing.
        target: folder in an installation.
        suffix: suffix of the files; all files by default.
    """
    files = [path for path in sorted(Path(source).rglob(f"*{suffix}")) if path.is_file()]
    # Bags are excluded: scripts of the examples write them.
    kept = [path for path in files if "__pycache__" not in path.parts and path.suffix != ".bag"]
    return [
        (
            f"{target}/{folder.relative_to(source).as_posix()}",
            [path.as_posix() for path in kept if path.parent == folder],
        )
        for folder in sorted({path.parent for path in kept})
    ]


def find_data_files() -> list:
    """Return the files outside the package: examples, pages, site and completions."""
    shared = [entry for folder in SHARED for entry in place_files(folder, f"share/retalis/{folder}")]
    pages = [
        entry
        for folder in PAGES
        for entry in place_files(f"docs/{folder}", f"share/retalis/docs/{folder}", ".md")
    ]
    return [*shared, *pages, *place_files(SITE, "share/retalis/docs/html"), *COMPLETIONS]


def long_description() -> str:
    """Return the README without links to files, which are broken on the page of a package index.

    Images are replaced by their alternative text, links by their link text.
    """
    text = Path("README.md").read_text(encoding="utf-8")
    return _LINK.sub(r"\1", _IMAGE.sub(r"*(Image: \1)*", text))


def is_for_catkin() -> bool:
    """Return whether catkin runs this file: it replaces ``setup`` to configure, and sets a variable to install.

    The import of its Python package is no evidence: pip can build on a machine that has ROS.
    """
    return setup.__module__ != "setuptools" or "CATKIN_BINARY_DIR" in os.environ


if is_for_catkin():
    from catkin_pkg.python_setup import generate_distutils_setup

    # The setuptools of Ubuntu 20.04 do not read the layout in `pyproject.toml`.
    data = [
        path.relative_to("src/retalis").as_posix()
        for path in Path("src/retalis").rglob("*")
        if path.is_file() and path.suffix != ".py" and "__pycache__" not in path.parts
    ]
    setup(
        **generate_distutils_setup(
            packages=find_packages("src"),
            package_dir={"": "src"},
            package_data={"retalis": data},
            long_description=long_description(),
        )
    )
else:
    setup(
        long_description=long_description(),
        long_description_content_type="text/markdown",
        data_files=find_data_files(),
    )
