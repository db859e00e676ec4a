"""Names of files: their parts, and where they are. Only what asks for a file looks at the file system.

What a program may learn of the process it runs in.
"""

from posixpath import basename, dirname, isabs, join, normpath, splitext
from typing import Dict, List, Optional

from ..machine.errors import existence_error, instantiation_error, permission_error
from ..terms.types import SLASH, Atom, Term, Var, atom, deref
from ..terms.unification import unify
from .argument_checks import atom_of, items, option_values
from .builtin_registry import Machine, StreamFiles, deterministic
from .text_arguments import text_of, whole_text

_OF_TYPE: Dict[str, List[str]] = {
    "prolog": [".pl", ".prolog", ".pro", ""],
    "source": [".pl", ".prolog", ".pro", ""],
}
"""What may be left out at the end of a file's name, by its type."""


def _name(term: Term) -> str:
    return whole_text(term, "text")


@deterministic("file_base_name/2")
def file_base_name(machine: Machine, path: Term, base: Term) -> bool:
    """Give what is behind the last slash of a path."""
    text = _name(path)
    plain = text.rstrip("/")
    return unify(base, atom(basename(plain) if plain else text[:1]), machine.trail)


@deterministic("file_directory_name/2")
def file_directory_name(machine: Machine, path: Term, folder: Term) -> bool:
    """Give what is before the last slash of a path."""
    text = _name(path)
    plain = text.rstrip("/")
    return unify(folder, atom((dirname(plain) or ".") if plain else text[:1] or "."), machine.trail)


@deterministic("file_name_extension/3")
def file_name_extension(machine: Machine, base: Term, extension: Term, name: Term) -> bool:
    """Relate a name with the part before its last point and the one behind it."""
    if deref(name).__class__ is not Var:
        whole = _name(name)
        if deref(extension).__class__ is not Var:
            wanted = "." + _name(extension).lstrip(".")
            if wanted != "." and whole.endswith(wanted):
                return _is_text(machine, base, whole[: -len(wanted)])
            return wanted == "." and "." not in whole and _is_text(machine, base, whole)
        stem, ending = _split(whole)
        return unify(extension, atom(ending), machine.trail) and _is_text(machine, base, stem)
    stem, ending = _name(base), _name(extension).lstrip(".")
    if ending and not stem.endswith(f".{ending}"):
        stem = f"{stem}.{ending}"
    return unify(name, atom(stem), machine.trail)


def _split(name: str) -> List[str]:
    """Return a name without its last point, and what is behind that; a point in a folder's name is none."""
    stem, point, ending = name.rpartition(".")
    return [stem, ending] if point and "/" not in ending else [name, ""]


def _is_text(machine: Machine, term: Term, text: str) -> bool:
    """Unify an argument with a text; one that is bound is compared as a text."""
    term = deref(term)
    return unify(term, atom(text), machine.trail) if term.__class__ is Var else text_of(term) == text


@deterministic("directory_file_path/3")
def directory_file_path(machine: Machine, folder: Term, name: Term, path: Term) -> bool:
    """Relate a path with its folder and the name in it."""
    if deref(folder).__class__ is Var or deref(name).__class__ is Var:
        whole = _name(path)
        return machine.unify_all((folder, atom(dirname(whole) or ".")), (name, atom(basename(whole))))
    inside, last = _name(folder), _name(name)
    found = last if inside == "." or isabs(last) else join(inside or "/", last)
    return unify(path, atom(found), machine.trail)


@deterministic("is_absolute_file_name/1")
def is_absolute_file_name(machine: Machine, path: Term) -> bool:
    """Succeed for a path that begins with a slash."""
    return isabs(_name(path))


@deterministic("absolute_file_name/2")
def absolute_file_name(machine: Machine, name: Term, path: Term) -> bool:
    """Give the whole path of a name."""
    found = _absolute(machine, name, None)
    return found is not None and unify(path, atom(found), machine.trail)


@deterministic("absolute_file_name/3")
def absolute_file_name_with(machine: Machine, name: Term, path: Term, options: Term) -> bool:
    """Give the whole path of a name; options say where it begins and may end, and whether a file has to be there."""
    if isinstance(deref(path), tuple):  # in the order of before
        path, options = options, path
    values: Dict[str, Term] = {}
    for option in option_values(options):
        if isinstance(option, tuple) and len(option) == 2:
            values.setdefault(option[0].name, deref(option[1]))
    kind = _option(values, "file_type", "txt")
    endings = _OF_TYPE.get(kind, [""])
    if "extensions" in values:
        endings = [
            f".{text.lstrip('.')}" if text else "" for text in map(text_of, items(values["extensions"]))
        ]
    found = _absolute(machine, name, values.get("relative_to"))
    access = _option(values, "access", "none")
    if found is not None:
        looks = access != "none" or endings != [""]
        there = _there(machine, found, endings, kind) if looks else found
        if there is not None or access in ("none", "write", "append"):
            return unify(path, atom(found if there is None else there), machine.trail)
    if _option(values, "file_errors", "error") == "fail":
        return False
    raise existence_error("source_sink", deref(name))


def _option(values: Dict[str, Term], name: str, default: str) -> str:
    return atom_of(values[name]).name if name in values else default


def _there(machine: Machine, path: str, endings: List[str], kind: str) -> Optional[str]:
    """Return the path of the first file that is there with one of the endings."""
    files = _files(machine)
    if kind == "directory":
        return path if files.is_folder(path) else None
    named = (path if splitext(path)[1] == ending else path + ending for ending in endings)
    return next((one for one in named if files.is_readable(one)), None)


def _files(machine: Machine) -> StreamFiles:
    files = machine.logic.files
    if files is None:
        raise permission_error("access", "source_sink", atom("."), "there are no files")
    return files


def _absolute(machine: Machine, name: Term, folder: Optional[Term]) -> Optional[str]:
    """Return a path from the root, without ``.`` and ``..``; None for what names no file, as ``library(lists)``."""
    name = deref(name)
    if name.__class__ is Var:
        raise instantiation_error()
    if name.__class__ is tuple and name[0] is SLASH:
        text = _joined(name)
    elif name.__class__ is tuple and name[0].arity == 1:
        return None
    else:
        text = _name(name)
    start = _files(machine).absolute(".") if folder is None else _name(folder)
    return normpath(join(start, text)) + ("/" if text.endswith("/") and text != "/" else "")


def _joined(path: Term) -> str:
    """Return the path that ``one/two`` is."""
    parts: List[str] = []
    pending = [path]
    while pending:
        part = deref(pending.pop())
        if part.__class__ is tuple and part[0] is SLASH:
            pending += [part[1], part[2]]
        else:
            parts.insert(0, part.name if isinstance(part, Atom) else text_of(part))
    return "/".join(parts)


@deterministic("exists_directory/1")
def exists_directory(machine: Machine, name: Term) -> bool:
    """Succeed for a folder that is there, and whose files goals may open."""
    path = _name(name)
    return _files(machine).is_folder(path)


@deterministic("getenv/2")
def getenv(machine: Machine, name: Term, value: Term) -> bool:
    """Give the value of an environment variable, where the program may know it."""
    wanted = text_of(name)
    environment = machine.logic.environment
    if environment is None:
        raise permission_error(
            "access", "environment_variable", atom(wanted), "the setting allow_foreign is off"
        )
    return wanted in environment and unify(value, atom(environment[wanted]), machine.trail)
