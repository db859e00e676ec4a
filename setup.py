"""Tell catkin, or pip, what to install; name, version and authors stand in package.xml."""

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
"""Folders that the commands ``demo`` and ``help`` need; catkin installs them by itself."""

PAGES = ("explanation", "how-to", "reference", "tutorials")
"""Folders of pages that the commands ``help`` and ``console`` search."""

SITE = "docs/_build/html"
"""The documentation site, which ``./install.py docs`` builds; a wheel that is built without it has none."""

EXTRAS = {
    "dashboard": ["tornado>=6"],
    "plot": ["matplotlib"],
    "dask": ["distributed"],
    "s3": ["fsspec", "s3fs"],
    "parquet": ["pyarrow"],
}


def shared() -> list:
    """Return the files of the example and where an installation has them."""
    return [entry for folder in SHARED for entry in placed(folder, f"share/retalis/{folder}")]


def placed(source: str, target: str, suffix: str = "") -> list:
    """Return the files of a folder and its subfolders, and where an installation has them.

    Args:
        source: Folder, which may be missing.
        target: Its place in an installation.
        suffix: Suffix of the files; all files by default.
    """
    files = [path for path in sorted(Path(source).rglob(f"*{suffix}")) if path.is_file()]
    # Bags are made by scripts of the examples.
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
    """Return the README without its links to files, which lead nowhere on the page of a package index.

    Of an image its text stays, of a link what it is written on.
    """
    text = Path("README.md").read_text(encoding="utf-8")
    return _LINK.sub(r"\1", _IMAGE.sub(r"*(Image: \1)*", text))


def described() -> dict:
    """Return what pip wants to know."""
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
    """Tell whether catkin asks: it has a ``setup`` of its own while it configures, and says so while it installs.

    Its Python package may be there without it asking: pip can build on a machine that has ROS.
    """
    return setup.__module__ != "setuptools" or "CATKIN_BINARY_DIR" in os.environ


if is_for_catkin():
    from catkin_pkg.python_setup import generate_distutils_setup

    setup(**generate_distutils_setup(**LAYOUT))
else:
    setup(**described(), **LAYOUT)
