"""apt sources of ROS on Ubuntu, the key of its packages, and errors in apt's output. Needs only Python 3.8."""

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
DEFAULT_KEY_FILE = "/etc/apt/trusted.gpg.d/ros-archive-keyring.asc"
"""Key file for sources that do not name one."""

ROS_REPOSITORY = "packages.ros.org/ros/"
_SIGNED_BY = re.compile(r"signed-by=([^\s\],]+)", re.IGNORECASE)
_WRONG_KEY = re.compile(r"(?:EXPKEYSIG|KEYEXPIRED|NO_PUBKEY|REVKEYSIG)[^\n]*")


def ros_source_lines(root: Path = Path("/etc/apt")) -> List[str]:
    """Return the lines of apt's sources that name ROS's packages."""
    files = [root / "sources.list", *sorted((root / "sources.list.d").glob("*"))]
    texts = [path.read_text(errors="replace") for path in files if path.is_file()]
    return [
        line
        for text in texts
        for line in text.splitlines()
        if ROS_REPOSITORY in line and not line.lstrip().startswith("#")
    ]


def key_file(lines: Sequence[str]) -> str:
    """Return the key file of a source, given the source's lines."""
    matches = (_SIGNED_BY.search(line) for line in lines)
    return next((match.group(1) for match in matches if match is not None), DEFAULT_KEY_FILE)


def key_problem(log: str) -> Optional[str]:
    """Return apt's error about an expired or missing ROS key in the output of an update; None if there is none."""
    for line in log.splitlines():
        match = _WRONG_KEY.search(line)
        if match is not None and ROS_REPOSITORY in line:
            return match.group()
    return None


_UNREACHABLE = re.compile(
    r"(?:Temporary failure resolving|Could not resolve|Could not connect|Unable to connect|Cannot initiate"
    r"|Connection (?:failed|timed out|refused)|Network is unreachable|Failed to fetch)[^\n]*"
)
_UNKNOWN = re.compile(r"Unable to locate package|has no installation candidate")


def network_problem(log: str, lists: str = "") -> Optional[str]:
    """Return the network error that made apt fail; None if it failed for another reason.

    Args:
        log: output of the command that failed.
        lists: output of the preceding update, which exits with 0 even without a network.
    """
    match = _UNREACHABLE.search(log) or (_UNKNOWN.search(log) and _UNREACHABLE.search(lists))
    return match.group().strip() if match else None


def fetch_key() -> bytes:
    """Download the key of the ROS packages, in ASCII armour.

    Raises:
        Problem: if it cannot be downloaded.
    """
    try:
        with urllib.request.urlopen(KEY_URL, timeout=60) as answer:
            key: bytes = answer.read()
    except (urllib.error.URLError, OSError) as error:
        raise Problem(f"no key for packages.ros.org ({error}); add it as {INSTRUCTIONS} says") from None
    return key


def encode_key(key: bytes, path: str) -> bytes:
    """Return a key in the form that apt expects in a file: armoured if its name ends in .asc, otherwise binary."""
    return key if path.endswith(".asc") else dearmor(key)


def dearmor(key: bytes) -> bytes:
    """Return the binary form of keys in ASCII armour (RFC 4880, 6.2), without the checksum line.

    Raises:
        Problem: if the text contains no key.
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
