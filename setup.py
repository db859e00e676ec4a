"""Tell catkin where the Python package is; without catkin, pip reads pyproject.toml alone."""

from setuptools import find_packages, setup

try:
    from catkin_pkg.python_setup import generate_distutils_setup
except ImportError:
    setup()
else:
    setup(
        **generate_distutils_setup(
            packages=find_packages("src"),
            package_dir={"": "src"},
            package_data={"": ["*.lark", "*.pl"]},
        )
    )
