"""Where apt finds ROS on Ubuntu, and the key of its packages. Needs Python 3.8 only."""

import base64
import re
import urllib.error
import urllib.request
from pathlib import Path
from typing import List, Optional, Sequence, Tuple

from install_shell import Problem

INSTRUCTIONS = "http://wiki.ros.org/noetic/Installation/Ubuntu"
KEY_URL = "https://raw.githubusercontent.com/ros/rosdistro/master/ros.asc"
KEY_FILE = "/usr/share/keyrings/ros-archive-keyring.asc"
SOURCE_FILE = "/etc/apt/sources.list.d/ros-noetic.list"
TRUSTED = "/etc/apt/trusted.gpg.d/ros-archive-keyring.asc"
"""Where a key goes that apt takes for sources which name none."""

ROS = "packages.ros.org/ros/"
_SIGNED_BY = re.compile(r"signed-by=([^\s\],]+)", re.IGNORECASE)
_WRONG_KEY = re.compile(r"(?:EXPKEYSIG|KEYEXPIRED|NO_PUBKEY|REVKEYSIG)[^\n]*")


def ros_lines(root: Path = Path("/etc/apt")) -> List[str]:
    """Return the lines of apt's sources that name ROS's packages."""
    files = [root / "sources.list", *sorted((root / "sources.list.d").glob("*"))]
    texts = [path.read_text(errors="replace") for path in files if path.is_file()]
    return [
        line
        for text in texts
        for line in text.splitlines()
        if ROS in line and not line.lstrip().startswith("#")
    ]


def key_place(lines: Sequence[str]) -> str:
    """Return the file of the key by which apt checks a source, given the source's lines."""
    found = (_SIGNED_BY.search(line) for line in lines)
    return next((one.group(1) for one in found if one is not None), TRUSTED)


def key_problem(log: str) -> Optional[str]:
    """Return what apt says of ROS's key where it has expired or is missing, given the output of an update."""
    for line in log.splitlines():
        wrong = _WRONG_KEY.search(line)
        if wrong is not None and ROS in line:
            return wrong.group()
    return None


_UNREACHABLE = re.compile(
    r"(?:Temporary failure resolving|Could not resolve|Could not connect|Unable to connect|Cannot initiate"
    r"|Connection (?:failed|timed out|refused)|Network is unreachable|Failed to fetch)[^\n]*"
)
_UNKNOWN = re.compile(r"Unable to locate package|has no installation candidate")


def network_problem(log: str, lists: str = "") -> Optional[str]:
    """Return why apt could fetch nothing, or None if it failed for another reason.

    Args:
        log: Output of the command that failed.
        lists: Output of the update before it, which ends with 0 without a network too, and makes packages unknown.
    """
    found = _UNREACHABLE.search(log) or (_UNKNOWN.search(log) and _UNREACHABLE.search(lists))
    return found.group().strip() if found else None


def fetch_key() -> bytes:
    """Return the key of ROS's packages, in ASCII armour.

    Raises:
        Problem: It cannot be had.
    """
    try:
        with urllib.request.urlopen(KEY_URL, timeout=60) as answer:
            key: bytes = answer.read()
    except (urllib.error.URLError, OSError) as error:
        raise Problem(f"no key for packages.ros.org ({error}); add it as {INSTRUCTIONS} says") from None
    return key


def for_file(key: bytes, place: str) -> bytes:
    """Return a key as apt wants it in a file: in armour where its name ends in .asc, in binary else."""
    return key if place.endswith(".asc") else without_armour(key)


def without_armour(key: bytes) -> bytes:
    """Return the binary form of keys in ASCII armour (RFC 4880, 6.2): the checksum's line is left out.

    Raises:
        Problem: There is none in the text.
    """
    blocks = re.findall(
        rb"-----BEGIN PGP PUBLIC KEY BLOCK-----(.*?)-----END PGP PUBLIC KEY BLOCK-----", key, re.DOTALL
    )
    if not blocks:
        raise Problem(f"what {KEY_URL} returned is not a key; add it as {INSTRUCTIONS} says")
    return b"".join(base64.b64decode(b"".join(_body(block))) for block in blocks)


def _body(block: bytes) -> Tuple[bytes, ...]:
    lines = block.strip(b"\r\n").splitlines()
    headers_end = next((at for at, line in enumerate(lines) if not line.strip()), -1)
    body = lines[headers_end + 1 :]
    return tuple(line.strip() for line in body if line.strip() and not line.startswith(b"="))
