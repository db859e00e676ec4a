"""Manifests of results, for option ``--resume``: what each result was computed from.

The manifest of ``OUTPUT/r1/day.jsonl`` is ``OUTPUT/.manifest/r1/day.jsonl.json``, also if the result is in the
partition of a day; with partitions by robot, it is in ``OUTPUT/.manifest/robot=r07/``. The process that has computed
the result writes it, so that a run whose client has ended can be resumed. A result is whole if its content is that of
the manifest, and so are the version of retalis, the program, the options and the bag. The content of a file is known
by its digest, which takes 2 ms a megabyte, and that of an object at a URL by its size and ETag.
"""

import json
import os
from collections import Counter
from datetime import date
from pathlib import Path
from typing import (
    Any,
    Callable,
    Dict,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    Union,
)

from ..foundation.errors import RetalisError
from ..playback.bag_locations import (
    BAG_SUFFIXES,
    CONTENT_KEYS,
    is_url,
    list_file_versions,
    location_exists,
    read_location,
    remove_location,
    result_file,
)
from .command_line import version
from .result_partitions import ResultTarget

MANIFEST_FOLDER = ".manifest"
"""Folder of the manifests in that of the results."""

_MAX_DIGEST_BYTES = 1 << 20
"""Size up to which a file of a program counts by its contents; a larger one by its size and time of modification."""

_BLOCK_BYTES = 1 << 20

_PROGRAM_OPTIONS = ("program", "msg", "answers")
"""Options whose values are paths of files that are read: the contents count, not the paths."""


class ResultManifest(NamedTuple):
    """Manifest of the result of a bag.

    Attributes:
        location: path or URL of the manifest.
        bag: path or URL of the bag.
        target: path or URL of the result, which may contain the day of the bag.
        inputs: what the result depends on besides the bag, by name.
    """

    location: str
    bag: str
    target: ResultTarget
    inputs: Dict[str, str]


def compute_inputs(
    options: Mapping[str, Any], others: Sequence[object], output: str, any_version: bool = False
) -> Dict[str, str]:
    """Return what all results of a run depend on besides their bags.

    Args:
        options: options of a single bag.
        others: further options.
        output: folder of the results, which can be in the folder of the program.
        any_version: whether results of other versions of this package count as whole.
    """
    folders = [options["program"], *options["msg"], *filter(None, [options["answers"]])]
    lines = [line for folder in folders for line in _describe_files(Path(folder), os.path.realpath(output))]
    values = {name: value for name, value in options.items() if name not in _PROGRAM_OPTIONS}
    option_text = json.dumps([values, others], sort_keys=True, default=repr)
    inputs = {
        "program": _digest("\n".join(lines)),
        "options": _digest(option_text),
    }
    return inputs if any_version else {"retalis": version(), **inputs}


def _describe_files(path: Path, output: str) -> Iterator[str]:
    """Yield a line for each file below a folder, or for a file, without bags, hidden files and results."""
    if not path.is_dir():
        yield f"{path.name} {_digest_file(path)}"
        return
    for folder, folder_names, names in os.walk(path):
        folder_names[:] = sorted(
            name
            for name in folder_names
            if not name.startswith((".", "__pycache__"))
            and os.path.realpath(os.path.join(folder, name)) != output
        )
        for name in sorted(names):
            if not name.startswith(".") and not name.endswith(BAG_SUFFIXES):
                file = Path(folder, name)
                yield f"{file.relative_to(path)} {_digest_file(file)}"


def _digest(content: Union[str, bytes]) -> str:
    from hashlib import sha256  # noqa: PLC0415 - loads OpenSSL, which runs over single bags do not need

    return sha256(
        content if isinstance(content, bytes) else content.encode("utf-8", "surrogateescape")
    ).hexdigest()


def _digest_file(path: Path) -> str:
    """Return a text that changes with a file."""
    try:
        status = path.stat()
        if status.st_size > _MAX_DIGEST_BYTES or not path.is_file():
            return f"{status.st_size} {status.st_mtime_ns}"
        return _digest(path.read_bytes())
    except OSError:
        return "unreadable"


def record_result(
    manifest: ResultManifest,
    scratch: str,
    compute: Callable[[], Tuple[Optional[Mapping[str, Any]], Iterable[str]]],
) -> None:
    """Compute a result, and write its manifest if there is a result.

    Args:
        manifest: the manifest to write.
        scratch: folder for temporary files.
        compute: writes the result; returns its outcome, which JSON can represent, or None if there is no result, and
            the files that the program has loaded.

    Raises:
        RetalisError: if the manifest cannot be written.
    """
    if manifest.target.tail:
        # The bag may have been replaced by one of another day, whose result would not replace the earlier one.
        _remove_earlier_result(manifest)
    # Otherwise the manifest of an earlier result would describe the new one if the process is killed in between.
    remove_location(manifest.location)
    # Before the bag is read: a bag that changes meanwhile differs from the manifest.
    bag_files = list_file_versions(manifest.bag)
    outcome, loaded_files = compute()
    if outcome is None:
        return
    content = {
        # A worker of a cluster can have another version than the client.
        "inputs": {**manifest.inputs, "retalis": version()},
        "files": {path: _digest_file(Path(path)) for path in loaded_files},
        "bag": bag_files,
        "result": _describe_result(manifest.target.locate(outcome.get("day", ""))),
        "outcome": outcome,
    }
    with result_file(manifest.location, scratch) as path:
        Path(path).write_text(json.dumps(content), encoding="utf-8")


def remove_result(manifest: ResultManifest) -> None:
    """Remove the result and the manifest of an earlier run, if there are any.

    Raises:
        RetalisError: if they cannot be removed.
    """
    _remove_earlier_result(manifest)
    remove_location(manifest.location)


def _remove_earlier_result(manifest: ResultManifest) -> None:
    """Remove the result that a manifest describes, or the one at its only location, if there is one.

    Raises:
        RetalisError: if it cannot be removed.
    """
    if not manifest.target.tail:
        remove_location(manifest.target.head)
        return
    try:
        content = json.loads(read_location(manifest.location) or "")
        location = _find_result(manifest, content)
    except (ValueError, KeyError, TypeError):
        return
    remove_location(location)


def _find_result(manifest: ResultManifest, content: Mapping[str, Any]) -> str:
    """Return the location of the result that the content of a manifest describes.

    Raises:
        ValueError, KeyError, TypeError: if the content lacks the day that is part of the location.
    """
    # Checked, because a file of the output folder must not name files elsewhere.
    day = str(date.fromisoformat(content["outcome"]["day"])) if manifest.target.tail else ""
    return manifest.target.locate(day)


def _describe_result(target: str) -> List[List[str]]:
    """Return what changes with the content of a result.

    Raises:
        RetalisError: if it cannot be read.
    """
    if is_url(target):
        return [[size, tag] for _, size, tag in list_file_versions(target, CONTENT_KEYS)]
    from hashlib import sha256  # noqa: PLC0415 - see `_digest`

    digest = sha256()
    try:
        with open(target, "rb") as file:
            for block in iter(lambda: file.read(_BLOCK_BYTES), b""):
                digest.update(block)
    except OSError as error:
        raise RetalisError(f"{target} cannot be read: {error.strerror}") from error
    return [[digest.hexdigest()]]


_NO_RESULT = "no result"


def find_whole_results(
    manifests: Sequence[ResultManifest], starts: Sequence[int]
) -> Tuple[Dict[int, Mapping[str, Any]], str]:
    """Return the outcomes of the results that need not be computed again, by index, and a line that counts them.

    Args:
        manifests: the results.
        starts: indexes of the first part of each recording; the results of a recording are whole together, because
            each part depends on the former one.
    """
    outcomes: Dict[int, Mapping[str, Any]] = {}
    reasons: Dict[str, int] = Counter()
    for start, end in zip(starts, [*starts[1:], len(manifests)]):
        parts = {number: _read_outcome(manifests[number]) for number in range(start, end)}
        failures = [outcome for outcome in parts.values() if isinstance(outcome, str)]
        for number, outcome in parts.items():
            if isinstance(outcome, str):
                reasons[outcome] += 1
            elif failures:
                reasons["another part that is computed"] += 1
            else:
                outcomes[number] = outcome
    line = f"resume: {len(outcomes)} of {len(manifests)} results are whole"
    if reasons:
        counts = ", ".join(f"{count} with {reason}" for reason, count in sorted(reasons.items()))
        line += f"; the others are computed: {counts}"
    return outcomes, line


def _read_outcome(manifest: ResultManifest) -> Union[Mapping[str, Any], str]:
    """Return the outcome of a whole result, or the reason why it has to be computed."""
    try:
        text = read_location(manifest.location)
        if text is None:
            is_found = not manifest.target.tail and location_exists(manifest.target.head)
            return "a result without manifest" if is_found else _NO_RESULT
        content = json.loads(text)
        result = _find_result(manifest, content)
        if not location_exists(result):
            return _NO_RESULT
        for name, value in manifest.inputs.items():
            if content["inputs"].get(name) != value:
                return f"other {name}"
        if any(_digest_file(Path(path)) != digest for path, digest in content["files"].items()):
            return "other program"
        if content["bag"] != list_file_versions(manifest.bag):
            return "other bag"
        # Last, because the whole result is read.
        if content["result"] != _describe_result(result):
            return "a changed result"
        outcome: Mapping[str, Any] = dict(content["outcome"])
    except (RetalisError, ValueError, KeyError, TypeError, AttributeError):
        return "an unreadable manifest"
    return outcome
