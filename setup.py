"""Package metadata for catkin and pip; name, version and authors are read from package.xml."""

import os
import re
from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

KINDS = ("*.pl", "*.bash", "*.fish", "_retalis", "page/*.*", "py.typed")
DATA = [path for kind in KINDS for path in sorted(Path("src/retalis").rglob(kind))]
LAYOUT = {
    "packages": find_packages("src"),
    "package_dir": {"": "src"},
    "package_data": {"retalis": [str(path.relative_to("src/retalis")) for path in DATA]},
}

SHARED = ("application_source", "examples/nao", "examples/cookbook")
"""Folders that the commands ``demo`` and ``help`` read; `CMakeLists.txt` installs them for catkin."""

PAGES = ("explanation", "how-to", "reference", "tutorials")
"""Folders of pages that the commands ``help`` and ``console`` search."""

SITE = "docs/_build/html"
"""Documentation site, which ``./install.py docs`` builds; a wheel contains it if it exists."""

EXTRAS = {
    "dashboard": ["tornado>=6"],
    "plot": ["matplotlib"],
    "dask": ["distributed"],
    "s3": ["fsspec", "s3fs"],
    "parquet": ["pyarrow"],
}


def shared() -> list:
    """Return the files of the examples and their folders in an installation."""
    return [entry for folder in SHARED for entry in placed(folder, f"share/retalis/{folder}")]


def placed(source: str, target: str, suffix: str = "") -> list:
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


CLASSIFIERS = [
    "Development Status :: 5 - Production/Stable",
    "Environment :: Console",
    "Intended Audience :: Developers",
    "Intended Audience :: Science/Research",
    "License :: OSI Approved :: GNU General Public License v3 or later (GPLv3+)",
    "Operating System :: POSIX :: Linux",
    "Programming Language :: Prolog",
    "Programming Language :: Python :: 3",
    "Programming Language :: Python :: 3.8",
    "Programming Language :: Python :: 3.11",
    "Programming Language :: Python :: 3.12",
    "Programming Language :: Python :: 3.13",
    "Programming Language :: Python :: Implementation :: CPython",
    "Topic :: Scientific/Engineering :: Artificial Intelligence",
    "Topic :: Software Development :: Interpreters",
    "Typing :: Typed",
]

KEYWORDS = [
    "ROS",
    "robotics",
    "complex event processing",
    "CEP",
    "stream reasoning",
    "Prolog",
    "rules",
    "events",
]

_IMAGE = re.compile(r"!\[([^\]]*)\]\([^)]*\)")
_LINK = re.compile(r"\[([^\]]*)\]\((?!https?://|#)[^)]*\)")


def long_description() -> str:
    """Return the README without links to files, which are broken on the page of a package index.

    Images are replaced by their alternative text, links by their link text.
    """
    text = Path("README.md").read_text(encoding="utf-8")
    return _LINK.sub(r"\1", _IMAGE.sub(r"*(Image: \1)*", text))


def described() -> dict:
    """Return the metadata for pip."""
    manifest = ElementTree.parse("package.xml").getroot()
    urls = {str(url.get("type")).capitalize(): str(url.text) for url in manifest.findall("url")}
    return {
        "name": manifest.findtext("name"),
        "version": manifest.findtext("version"),
        "author": manifest.findtext("author"),
        "maintainer": manifest.findtext("maintainer"),
        "url": manifest.findtext("url"),
        "project_urls": urls,
        "license": manifest.findtext("license"),
        "classifiers": CLASSIFIERS,
        "keywords": KEYWORDS,
        "description": " ".join(str(manifest.findtext("description")).split()),
        "long_description": long_description(),
        "long_description_content_type": "text/markdown",
        "python_requires": ">=3.8",
        "install_requires": Path("requirements.txt").read_text(encoding="utf-8").split(),
        "extras_require": EXTRAS,
        "entry_points": {"console_scripts": ["retalis = retalis.__main__:main"]},
        "data_files": [
            *shared(),
            *placed(SITE, "share/retalis/docs/html"),
            *[
                entry
                for folder in PAGES
                for entry in placed(f"docs/{folder}", f"share/retalis/docs/{folder}", ".md")
            ],
            ("share/bash-completion/completions", ["src/retalis/cli/retalis.bash"]),
            ("share/zsh/site-functions", ["src/retalis/cli/_retalis"]),
            ("share/fish/vendor_completions.d", ["src/retalis/cli/retalis.fish"]),
        ],
    }


def is_for_catkin() -> bool:
    """Return whether catkin runs this file: it replaces ``setup`` to configure, and sets a variable to install.

    The import of its Python package is no evidence: pip can build on a machine that has ROS.
    """
    return setup.__module__ != "setuptools" or "CATKIN_BINARY_DIR" in os.environ


if is_for_catkin():
    from catkin_pkg.python_setup import generate_distutils_setup

    setup(**generate_distutils_setup(**LAYOUT))
else:
    setup(**described(), **LAYOUT)
