"""Python modules whose functions a program asks for as predicates: ``use_foreign/1``."""

import importlib
import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Protocol

from ...foundation import UsageError
from ..logic import Logic
from ..machine import Machine, instantiation_error, permission_error, type_error
from ..terms import Atom, String, Term, Var, deref
from .functions import Caller, define_foreign


class Opening(Protocol):
    """What opens files where that is allowed, see `Door`.

    Attributes:
        is_loading: whether the program's own files are being loaded.
    """

    is_loading: bool

    @property
    def output(self) -> str:
        """The folder of what programs write without saying where."""

    def append(self, path: str, text: str) -> None:
        """Write a text at the end of a file."""


class NamedFiles(Protocol):
    """The files that a program names, see `Files`."""

    @property
    def door(self) -> Opening:
        """What opens them."""

    def resolve(self, name: str) -> Path:
        """Return the path of a name."""

    def is_file(self, path: Path) -> bool:
        """Tell whether there is a file that may be read."""


def define_use_foreign(logic: Logic, runner: Caller, files: NamedFiles, allowed: bool) -> None:
    """Define ``use_foreign(Module)``, which loads a Python module and defines its predicates.

    Args:
        logic: where they are defined.
        runner: of the engine, which is told what calls back.
        files: of the program.
        allowed: whether its own files may do that, while they are loaded; goals that run later never may.
    """

    def use_foreign(machine: Machine, module: Term) -> bool:
        module = deref(module)
        if module.__class__ is Var:
            raise instantiation_error()
        if not isinstance(module, (Atom, String)):
            raise type_error("atom", module)
        reason = "" if allowed else "the setting allow_foreign is off"
        if not files.door.is_loading:
            reason = "Python may be loaded only by the program's own files, while they are being loaded"
        if reason:
            raise permission_error("load", "foreign_module", module, reason)
        name = module.name if isinstance(module, Atom) else module.text
        define_foreign(logic, runner, load_module(name, files))
        found = files.resolve(name if name.endswith(".py") else f"{name}.py")
        logic.foreign_modules[str(found) if files.is_file(found) else name] = None
        return True

    logic.define("use_foreign", 1, use_foreign).locked = True


def load_module(name: str, files: NamedFiles) -> ModuleType:
    """Return a module by its name, or by the path of its file.

    Args:
        name: ``package.module``, ``file.py`` or ``folder/file.py``; a name without a dot is first looked for
            as a file beside the file that names it.
        files: of the program, which knows where relative paths start.

    Raises:
        UsageError: where there is no such module, or importing it fails.
    """
    path = files.resolve(name if name.endswith(".py") else f"{name}.py")
    is_file = files.is_file(path)
    try:
        if name.endswith(".py") and not is_file:
            raise UsageError("there is no such file")
        if is_file and (name.endswith(".py") or "." not in name):
            spec = importlib.util.spec_from_file_location(f"retalis_foreign_{path.stem}", str(path))
            module = importlib.util.module_from_spec(spec)  # type: ignore[arg-type]
            spec.loader.exec_module(module)  # type: ignore[union-attr]
            return module
        return importlib.import_module(name)
    except Exception as error:  # a module may fail in any way while it is imported
        raise UsageError(f"cannot load {name}: {type(error).__name__}: {error}") from error
