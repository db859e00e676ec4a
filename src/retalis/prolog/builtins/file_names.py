"""Predicates on file names, and environment variables.

Paths are POSIX paths. Most predicates only manipulate the text of a name. Those that access the file system go
through `SourceFiles`, which restricts goals to the folders that the settings allow.
"""

from posixpath import basename, dirname, isabs, join, normpath, splitext
from typing import TYPE_CHECKING, Dict, List, Optional

from ..machine.errors import existence_error, permission_error
from ..terms.types import SLASH, Atom, Term, Var, atom, deref
from ..terms.unification import unify
from .argument_checks import atom_of, bound, items, option_values
from .builtin_registry import ProgramMachine, deterministic
from .text_arguments import text_of, whole_text

if TYPE_CHECKING:
    from ..files.source_files import SourceFiles

_EXTENSIONS: Dict[str, List[str]] = {
    "prolog": [".pl", ".prolog", ".pro", ""],
    "source": [".pl", ".prolog", ".pro", ""],
}
"""Extensions that a file name may omit, by file type."""


def _read_file_name(term: Term) -> str:
    return whole_text(term, "text")


def _base_name(path: str) -> str:
    """Return the part of a path after its last slash; trailing slashes are ignored, and the root is ``/``."""
    stripped = path.rstrip("/")
    return basename(stripped) if stripped else path[:1]


def _folder_name(path: str) -> str:
    """Return the part of a path before its last slash, ``.`` if it has none; trailing slashes are ignored."""
    stripped = path.rstrip("/")
    return (dirname(stripped) or ".") if stripped else path[:1] or "."


@deterministic("file_base_name/2")
def file_base_name(machine: ProgramMachine, path: Term, base: Term) -> bool:
    """Unify with the part of a path after its last slash."""
    return unify(base, atom(_base_name(_read_file_name(path))), machine.trail)


@deterministic("file_directory_name/2")
def file_directory_name(machine: ProgramMachine, path: Term, folder: Term) -> bool:
    """Unify with the part of a path before its last slash."""
    return unify(folder, atom(_folder_name(_read_file_name(path))), machine.trail)


@deterministic("file_name_extension/3")
def file_name_extension(machine: ProgramMachine, base: Term, extension: Term, name: Term) -> bool:
    """Relate a file name with its base name and its extension."""
    if deref(name).__class__ is not Var:
        file_name = _read_file_name(name)
        if deref(extension).__class__ is not Var:
            # An extension may be given with or without its dot.
            suffix = "." + _read_file_name(extension).lstrip(".")
            if suffix != "." and file_name.endswith(suffix):
                return _unify_text(machine, base, file_name[: -len(suffix)])
            return suffix == "." and "." not in file_name and _unify_text(machine, base, file_name)
        stem, ending = _split_extension(file_name)
        return unify(extension, atom(ending), machine.trail) and _unify_text(machine, base, stem)
    stem, ending = _read_file_name(base), _read_file_name(extension).lstrip(".")
    if ending and not stem.endswith(f".{ending}"):
        stem = f"{stem}.{ending}"
    return unify(name, atom(stem), machine.trail)


def _split_extension(name: str) -> List[str]:
    """Return a name without its extension, and the extension; dots in folder names are ignored."""
    stem, point, ending = name.rpartition(".")
    return [stem, ending] if point and "/" not in ending else [name, ""]


def _unify_text(machine: ProgramMachine, term: Term, text: str) -> bool:
    """Unify an argument with a text; a bound argument of any text type is compared by its text."""
    term = deref(term)
    return unify(term, atom(text), machine.trail) if term.__class__ is Var else text_of(term) == text


@deterministic("directory_file_path/3")
def directory_file_path(machine: ProgramMachine, folder: Term, name: Term, path: Term) -> bool:
    """Relate a path with its folder and file name; if one of these is given, the other one is the rest of it."""
    has_folder, has_name = (deref(part).__class__ is not Var for part in (folder, name))
    if has_folder and has_name:
        folder_name, file_name = _read_file_name(folder), _read_file_name(name)
        joined = file_name if folder_name == "." or isabs(file_name) else join(folder_name or "/", file_name)
        return _unify_text(machine, path, joined)
    file_path = _read_file_name(path)
    if has_folder:
        rest = _path_in_folder(file_path, _read_file_name(folder))
        return rest is not None and unify(name, atom(rest), machine.trail)
    if has_name:
        parent = _folder_with_name(file_path, _read_file_name(name))
        return parent is not None and unify(folder, atom(parent), machine.trail)
    return machine.unify_all((folder, atom(_folder_name(file_path))), (name, atom(_base_name(file_path))))


def _path_in_folder(path: str, folder: str) -> Optional[str]:
    """Return the part of a path after its folder; None if it is not in the folder."""
    if folder == "." and not isabs(path):
        return path
    prefix = join(folder or "/", "")
    return path[len(prefix) :] if path.startswith(prefix) else None


def _folder_with_name(path: str, name: str) -> Optional[str]:
    """Return the part of a path before its file name; None if it does not end with the name."""
    if path == name:
        return "."
    folder = path[: -len(name)] if name and path.endswith(f"/{name}") else None
    return folder if folder is None else folder.rstrip("/") or "/"


@deterministic("is_absolute_file_name/1")
def is_absolute_file_name(machine: ProgramMachine, path: Term) -> bool:
    """Test for a path that begins with a slash."""
    return isabs(_read_file_name(path))


@deterministic("absolute_file_name/2")
def absolute_file_name(machine: ProgramMachine, name: Term, path: Term) -> bool:
    """Unify with the absolute path of a name."""
    absolute = _absolute_path(machine, name, None)
    return absolute is not None and unify(path, atom(absolute), machine.trail)


@deterministic("absolute_file_name/3")
def absolute_file_name_with(machine: ProgramMachine, name: Term, path: Term, options: Term) -> bool:
    """Unify with the absolute path of a name; options select its base folder, extensions, type and access."""
    # Older versions of SWI-Prolog had the options as the second argument; both orders are accepted, as there.
    if isinstance(deref(path), tuple):
        path, options = options, path
    values: Dict[str, Term] = {}
    for option in option_values(options):
        if isinstance(option, tuple) and len(option) == 2:
            values.setdefault(option[0].name, deref(option[1]))
    file_type = _option_name(values, "file_type", "txt")
    endings = _EXTENSIONS.get(file_type, [""])
    if "extensions" in values:
        endings = [
            f".{text.lstrip('.')}" if text else "" for text in map(text_of, items(values["extensions"]))
        ]
    absolute = _absolute_path(machine, name, values.get("relative_to"))
    access = _option_name(values, "access", "none")
    if absolute is not None:
        must_search = access != "none" or endings != [""]
        existing = _find_existing(machine, absolute, endings, file_type) if must_search else absolute
        if existing is not None or access in ("none", "write", "append"):
            return unify(path, atom(absolute if existing is None else existing), machine.trail)
    if _option_name(values, "file_errors", "error") == "fail":
        return False
    raise existence_error("source_sink", deref(name))


def _option_name(values: Dict[str, Term], name: str, default: str) -> str:
    """Return the value of an option, which is an atom, or a default."""
    return atom_of(values[name]).name if name in values else default


def _find_existing(machine: ProgramMachine, path: str, endings: List[str], file_type: str) -> Optional[str]:
    """Return the path of the first existing file with one of the extensions, or of an existing folder; else None."""
    files = _require_files(machine)
    if file_type == "directory":
        return path if files.is_folder(path) else None
    # A name that already has the extension is not extended again.
    candidates = (path if splitext(path)[1] == ending else path + ending for ending in endings)
    return next((candidate for candidate in candidates if files.is_readable(candidate)), None)


def _require_files(machine: ProgramMachine) -> "SourceFiles":
    """Return the files that goals may open; raise a permission error if there are none."""
    files = machine.logic.files
    if files is None:
        raise permission_error("access", "source_sink", atom("."), "this program has no access to files")
    return files


def _absolute_path(machine: ProgramMachine, name: Term, folder: Optional[Term]) -> Optional[str]:
    """Return a normalised absolute path; None for a term such as ``library(lists)``, which is not a file name."""
    name = bound(name)
    if name.__class__ is tuple and name[0] is SLASH:
        text = _join_segments(name)
    elif name.__class__ is tuple and name[0].arity == 1:
        return None
    else:
        text = _read_file_name(name)
    start = "." if folder is None else _read_file_name(folder)
    if not isabs(start):
        start = _require_files(machine).absolute(start)
    return normpath(join(start, text)) + ("/" if text.endswith("/") and text != "/" else "")


def _join_segments(path: Term) -> str:
    """Return the path of a term such as ``folder/file``."""
    # Collects the parts from right to left without recursion, so that the depth of the term is not limited; they are
    # reversed at the end, because an insertion at the front takes time linear in their number.
    segments: List[str] = []
    pending = [path]
    while pending:
        part = deref(pending.pop())
        if part.__class__ is tuple and part[0] is SLASH:
            pending += [part[1], part[2]]
        else:
            segments.append(part.name if isinstance(part, Atom) else text_of(part))
    return "/".join(reversed(segments))


@deterministic("exists_directory/1")
def exists_directory(machine: ProgramMachine, name: Term) -> bool:
    """Test for an existing folder whose files goals may open."""
    path = _read_file_name(name)
    return _require_files(machine).is_folder(path)


@deterministic("getenv/2")
def getenv(machine: ProgramMachine, name: Term, value: Term) -> bool:
    """Unify with the value of an environment variable; a permission error if the setting ``allow_foreign`` is off."""
    variable = text_of(name)
    environment = machine.logic.environment
    # The environment may contain secrets of the user, so a program needs a permission to read it.
    if environment is None:
        raise permission_error(
            "access", "environment_variable", atom(variable), "the setting allow_foreign is off"
        )
    return variable in environment and unify(value, atom(environment[variable]), machine.trail)
