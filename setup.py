"""Tell catkin, or pip where there is no ROS, what to install; name and version stand in package.xml."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

KINDS = ("*.lark", "*.pl", "page/*.*", "py.typed")
DATA = [path for kind in KINDS for path in sorted(Path("src/retalis").rglob(kind))]
LAYOUT = {
    "packages": find_packages("src"),
    "package_dir": {"": "src"},
    "package_data": {"retalis": [str(path.relative_to("src/retalis")) for path in DATA]},
}


SHARED = ("application_source", "examples/nao")
"""Folders that the command ``demo`` needs; catkin installs them by itself."""


def shared() -> list:
    """Return the files of the example and where an installation has them."""
    files = [path for folder in SHARED for path in sorted(Path(folder).rglob("*")) if path.is_file()]
    kept = [path for path in files if "__pycache__" not in path.parts]
    folders = sorted({path.parent for path in kept})
    return [
        (f"share/retalis/{folder}", [str(path) for path in kept if path.parent == folder])
        for folder in folders
    ]


def described() -> dict:
    """Return what pip wants to know."""
    manifest = ElementTree.parse("package.xml").getroot()
    return {
        "name": manifest.findtext("name"),
        "version": manifest.findtext("version"),
        "license": manifest.findtext("license"),
        "description": " ".join(str(manifest.findtext("description")).split()),
        "python_requires": ">=3.8",
        "install_requires": Path("requirements.txt").read_text().split(),
        "data_files": shared(),
    }


try:
    from catkin_pkg.python_setup import generate_distutils_setup
except ImportError:
    setup(**described(), **LAYOUT)
else:
    setup(**generate_distutils_setup(**LAYOUT))
