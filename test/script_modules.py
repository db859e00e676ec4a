"""Loading of scripts that are not part of a package, as modules."""

import importlib.util
from pathlib import Path
from types import ModuleType


def load_script(path: Path, name: str = "") -> ModuleType:
    """Return a script as a module, which is not entered in ``sys.modules``.

    Args:
        path: file of the script.
        name: name of the module; by default that of the file.
    """
    specification = importlib.util.spec_from_file_location(name or path.stem, str(path))
    assert specification is not None, path
    assert specification.loader is not None, path
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module
