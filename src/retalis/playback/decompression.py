"""Decompression with a bound: a few bytes can hold gigabytes.

A chunk's header states the size that it has unpacked, and the reader allows a largest size. No more than the smaller
of the two is ever unpacked. Libraries are asked for one byte more than stated, to find out that a chunk has more.
"""

import bz2
from io import BytesIO
from typing import Any, BinaryIO, List

MAX_CHUNK_MEGABYTES = 512
"""Default of the largest chunk, or single message, that is unpacked."""

_MEGABYTE = 1_000_000

_BLOCK = 1 << 20


class ChunkLimit:
    """The largest size of a chunk, in bytes.

    Args:
        megabytes: the size.
    """

    def __init__(self, megabytes: int = MAX_CHUNK_MEGABYTES):
        self.bytes = megabytes * _MEGABYTE
        self._megabytes = megabytes

    def check(self, size: int, what: str) -> None:
        """Refuse a size.

        Raises:
            ValueError: if it is larger than allowed.
        """
        if size > self.bytes:
            raise ValueError(f"{what} {size} bytes: expected {self._allowed()}")

    def unpack_message(self, packed: bytes) -> bytes:
        """Return a message that was compressed by zstd, which does not have to state its size.

        Raises:
            ValueError: if it is larger than allowed.
        """
        data = read_up_to(zstd_reader(BytesIO(packed)), self.bytes + 1)
        if len(data) > self.bytes:
            raise ValueError(f"a compressed message has more bytes than allowed: expected {self._allowed()}")
        return data

    def _allowed(self) -> str:
        return f"at most {self._megabytes:g} MB, the limit that --max-chunk-megabytes raises"


def unpack(compression: str, packed: bytes, size: int) -> bytes:
    """Return what a chunk holds.

    Args:
        compression: ``none`` or nothing, ``bz2``, ``lz4``, ``zstd``.
        packed: the chunk as it is in the file.
        size: the bytes that its header states, which the caller has compared with the limit.

    Raises:
        ValueError: if it has more or less than stated.
        Exception: of the library, if it cannot be unpacked.
    """
    decompressor: Any
    complete = True
    if compression in ("", "none"):
        data = packed
    elif compression == "zstd":
        data = read_up_to(zstd_reader(BytesIO(packed)), size + 1)
    else:
        if compression == "bz2":
            decompressor = bz2.BZ2Decompressor()
        elif compression == "lz4":
            from lz4.frame import LZ4FrameDecompressor  # noqa: PLC0415 - ``rosbags`` needs it

            decompressor = LZ4FrameDecompressor()
        else:
            raise ValueError(f"compression '{compression[:20]}' is unknown: expected none, bz2, lz4 or zstd")
        data = decompressor.decompress(packed, max_length=size + 1)
        complete = decompressor.eof
    if len(data) > size:
        raise ValueError(f"it has more than the {size} bytes that its header states")
    if len(data) < size or not complete:
        raise ValueError(f"it ends after {len(data)} bytes: its header states {size}")
    return data


def read_up_to(source: BinaryIO, size: int) -> bytes:
    """Return what a stream holds, up to a size; no more memory than for twice of that is used."""
    blocks: List[bytes] = []
    while size > 0:
        block = source.read(min(size, _BLOCK))
        if not block:
            break
        blocks.append(block)
        size -= len(block)
    return blocks[0] if len(blocks) == 1 else b"".join(blocks)


def copy_up_to(source: BinaryIO, target: BinaryIO, size: int) -> int:
    """Copy a stream until its end, or until more than a size has been copied; return how many bytes were."""
    copied = 0
    while copied <= size:
        block = source.read(_BLOCK)
        if not block:
            break
        copied += len(block)
        target.write(block)
    return copied


def zstd_reader(packed: BinaryIO) -> Any:
    """Return a reader of what zstd has packed, by the package that this version of ``rosbags`` imports."""
    from rosbags.rosbag2 import reader  # noqa: PLC0415 - an optional package

    zstd = getattr(reader, "zstd", None)
    if zstd is not None:
        return zstd.open(packed, "rb")
    zstandard: Any = vars(reader)["zstandard"]  # before version 0.11
    return zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)


def reason(error: BaseException) -> str:
    """Return what went wrong, without a full stop at its end."""
    return str(error).rstrip(".") or type(error).__name__
