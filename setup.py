"""Tell catkin, or pip where there is no ROS, what to install; name and version stand in package.xml."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

DATA = [path for kind in ("*.lark", "*.pl") for path in sorted(Path("src/retalis").rglob(kind))]
LAYOUT = {
    "packages": find_packages("src"),
    "package_dir": {"": "src"},
    "package_data": {"retalis": [str(path.relative_to("src/retalis")) for path in DATA]},
}


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
    }


try:
    from catkin_pkg.python_setup import generate_distutils_setup
except ImportError:
    setup(**described(), **LAYOUT)
else:
    setup(**generate_distutils_setup(**LAYOUT))
