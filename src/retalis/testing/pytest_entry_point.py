"""Entry point of the plugin of pytest, which is loaded by every run of pytest where the package is installed.

Versions of pytest before 7 do not know the hooks of the plugin, and would end with an error.
"""

import pytest

FIRST_VERSION = 7
"""First major version of pytest with the hooks of the plugin."""

if int(pytest.__version__.partition(".")[0]) >= FIRST_VERSION:
    pytest_plugins = ["retalis.testing.pytest_plugin"]
