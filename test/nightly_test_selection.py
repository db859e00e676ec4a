"""A pytest plugin that leaves the nightly tests out of all runs that do not name them.

Nightly tests are the long forms of searches for errors, and tests of wording. They run with `-m nightly`, and where
the command line names their file.
"""

from typing import Any

import pytest

MARKER = "nightly"


def is_requested(item: Any, config: Any) -> bool:
    """Return whether the command line names the file of a test."""
    folder = config.invocation_params.dir
    return any((folder / argument.partition("::")[0]).resolve() == item.path for argument in config.args)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: Any, items: Any) -> None:
    """Deselect the nightly tests unless they are requested."""
    if MARKER in config.option.markexpr:
        return
    omitted = [item for item in items if item.get_closest_marker(MARKER) and not is_requested(item, config)]
    if omitted:
        config.hook.pytest_deselected(items=omitted)
        omitted_set = set(omitted)
        items[:] = [item for item in items if item not in omitted_set]
