"""Sessions of ``nox`` (https://nox.thea.codes): ``nox -l`` lists them, ``nox -s fast`` runs one.

Only ``all``, ``ros`` and ``lint`` need Debian 12 or Ubuntu 20.04; the others need Python alone. Each session installs
its requirements into a virtual environment below ``.nox``.
"""

import sys

import nox

nox.needs_version = ">=2022.1"
nox.options.sessions = ["fast", "style"]
nox.options.reuse_existing_virtualenvs = True

WITHOUT_ROS = ("--ignore", "test/ros1")

MYPY_38_OPTIONS = ("--no-warn-unused-ignores", "--no-warn-return-any")
"""Options of the last mypy for Python 3.8, see `MYPY_38_OPTIONS` in ``install.py``."""


def _install(session: nox.Session) -> None:
    """Install the requirements of the tests; on Python 3.8 the oldest supported versions."""
    oldest = session.python == "3.8"
    session.install(
        "-r",
        "requirements-oldest.txt" if oldest else "requirements.txt",
        "pytest>=7",
        "pytest-xdist",
        "hypothesis",
        "mcap",
        "tornado>=6",
        "distributed",
        "pygls<2",
        "setuptools",
        "wheel",
        *(() if oldest else ("duckdb", "pandas", "pyarrow")),
    )
    session.env["PYTHONPATH"] = ""  # packages of a sourced ROS are for another Python


@nox.session
def fast(session: nox.Session) -> None:
    """Fast tests without ROS."""
    _install(session)
    session.run("python", "-m", "pytest", *WITHOUT_ROS, "-m", "not slow", *session.posargs)


@nox.session(python=["3.8", "3.11", "3.12", "3.13"])
def tests(session: nox.Session) -> None:
    """All tests without ROS, on each Python (on one: ``nox -s tests-3.8``)."""
    _install(session)
    session.run("python", "-m", "pytest", *WITHOUT_ROS, *session.posargs)


@nox.session(python=False)
def ros(session: nox.Session) -> None:
    """Tests on a ROS master, in a workspace that is built if it does not exist."""
    session.run("./install.py", "test", "test/ros1", *session.posargs, external=True)


@nox.session(name="all", python=False)
def everything(session: nox.Session) -> None:
    """All stages of ``.ci/run``; ``nox -s all -- fast`` runs one of them."""
    session.run(".ci/run", *session.posargs, external=True)


@nox.session
def style(session: nox.Session) -> None:
    """Ruff and mypy, without ROS."""
    session.install("-r", "requirements.txt", "-r", "requirements-dev.txt")
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")
    session.run("mypy", *(MYPY_38_OPTIONS if sys.version_info < (3, 9) else ()))


@nox.session(python=False)
def lint(session: nox.Session) -> None:
    """Ruff, mypy and catkin_lint, as in ``.ci/run``."""
    session.run("./install.py", "lint", external=True)


@nox.session
def docs(session: nox.Session) -> None:
    """Documentation site, and tests of the snippets, links and tables of its pages."""
    _install(session)
    session.run("python", "install.py", "docs")
    session.run("python", "-m", "pytest", "-m", "docs", *session.posargs)


@nox.session
def bench(session: nox.Session) -> None:
    """Benchmarks of the engine; ``nox -s bench -- --help`` prints their options."""
    _install(session)
    session.run("python", "bench/engine.py", *session.posargs)
