"""Decompression with a size limit, because a few compressed bytes can expand to gigabytes.

The header of a chunk states its size after decompression, and the reader has a limit. Output never exceeds the
smaller of the two. To detect chunks that are larger than stated, libraries are asked for one byte more.
"""

import bz2
from contextlib import suppress
from io import BytesIO
from typing import Any, BinaryIO, Callable, List

MAX_CHUNK_MEGABYTES = 512
"""Default limit for a chunk or a single message after decompression."""

_BYTES_PER_MEGABYTE = 1_000_000

_BLOCK_BYTES = 1 << 20

_PART_BYTES = 1 << 14
"""Number of bytes that are decompressed at once of a chunk that is cut."""


class ChunkLimitError(ValueError):
    """A chunk or a message that is larger than the limit."""


class MissingPackageError(Exception):
    """A Python package that decompresses is not installed."""


class ChunkLimit:
    """Maximum size of a chunk after decompression.

    Args:
        megabytes: the limit in units of 10**6 bytes.
    """

    def __init__(self, megabytes: int = MAX_CHUNK_MEGABYTES):
        self.bytes = megabytes * _BYTES_PER_MEGABYTE
        self._megabytes = megabytes

    def check(self, size: int, subject: str) -> None:
        """Check the size of a chunk in bytes.

        Raises:
            ChunkLimitError: if it exceeds the limit.
        """
        if size > self.bytes:
            raise ChunkLimitError(f"{subject} {size} bytes: expected {self._describe_limit()}")

    def unpack_message(self, packed: bytes) -> bytes:
        """Decompress a message that was compressed with zstd, whose frame need not state the size.

        Raises:
            ChunkLimitError: if the message exceeds the limit.
        """
        data = read_up_to(zstd_reader(BytesIO(packed)), self.bytes + 1)
        if len(data) > self.bytes:
            raise ChunkLimitError(
                f"a compressed message has more bytes than allowed: expected {self._describe_limit()}"
            )
        return data

    def _describe_limit(self) -> str:
        return f"at most {self._megabytes} MB, the limit that --max-chunk-megabytes raises"


def unpack(compression: str, packed: bytes, size: int) -> bytes:
    """Return the decompressed content of a chunk.

    Args:
        compression: ``none`` or an empty string, ``bz2``, ``lz4``, or ``zstd``.
        packed: the content as it is in the file.
        size: size after decompression as stated in the header; the caller has compared it with the limit.

    Raises:
        ValueError: if the content does not have the stated size.
        MissingPackageError: if the package for the compression is not installed.
        Exception: of the library, if the content cannot be decompressed.
    """
    is_complete = True
    if compression in ("", "none"):
        data = packed
    elif compression == "zstd":
        data = _unpack_zstd(packed, size + 1)
    else:
        decompressor = _create_decompressor(compression)
        # `max_length` bounds the memory even if the stream expands without end.
        data = decompressor.decompress(packed, max_length=size + 1)
        # A truncated stream can have the right number of bytes without its checksum.
        is_complete = decompressor.eof
    if len(data) > size:
        raise ValueError(f"it has more than the {size} bytes that its header states")
    if len(data) < size or not is_complete:
        raise ValueError(f"it ends after {len(data)} bytes: its header states {size}")
    return data


def unpack_available(compression: str, packed: bytes, size: int) -> bytes:
    """Return the start of a chunk that is cut, as far as it can be decompressed.

    Args:
        compression: as for `unpack`.
        packed: the bytes of the content that the file has.
        size: size after decompression as stated in the header; the caller has compared it with the limit.

    Raises:
        ValueError: if the compression is unknown.
        MissingPackageError: if the package for the compression is not installed.
    """
    if compression in ("", "none"):
        return packed[:size]
    if compression == "zstd":
        read_block: Callable[[int], bytes] = zstd_reader(BytesIO(packed)).read1
    else:
        source, decompressor = BytesIO(packed), _create_decompressor(compression)

        def read_block(max_size: int) -> bytes:
            block = b""
            # A decompressor returns bytes only when a block of the compression is complete.
            while not (block or decompressor.eof):
                packed_block = source.read(_PART_BYTES) if decompressor.needs_input else b""
                if decompressor.needs_input and not packed_block:
                    break
                block = decompressor.decompress(packed_block, max_length=max_size)
            return block

    blocks: List[bytes] = []
    # The cut is an error of the library, which differs; the blocks before it are valid.
    with suppress(Exception):
        while size > 0:
            block = read_block(min(size, _PART_BYTES))
            if not block:
                break
            blocks.append(block)
            size -= len(block)
    return b"".join(blocks)


def _create_decompressor(compression: str) -> Any:
    """Return a decompressor with the interface of `bz2.BZ2Decompressor`."""
    if compression == "bz2":
        return bz2.BZ2Decompressor()
    if compression == "lz4":
        try:
            from lz4.frame import LZ4FrameDecompressor  # noqa: PLC0415 - ``rosbags`` needs it
        except ImportError:
            raise _describe_missing_package("lz4", "lz4") from None
        return LZ4FrameDecompressor()
    raise ValueError(f"compression '{compression[:20]}' is unknown: expected none, bz2, lz4 or zstd")


def _describe_missing_package(compression: str, package: str) -> MissingPackageError:
    return MissingPackageError(
        f"it is compressed with {compression}, which needs the Python package {package}: pip install {package}"
    )


def _unpack_zstd(packed: bytes, max_size: int) -> bytes:
    """Return at most ``max_size`` bytes of decompressed zstd frames."""
    zstd = _find_zstd()
    if zstd is not None:
        # Most chunks are one frame, which is decompressed in a seventh of the time of a file object.
        decompressor = zstd.ZstdDecompressor()
        data: bytes = decompressor.decompress(packed, max_length=max_size)
        if len(data) == max_size or (decompressor.eof and not decompressor.unused_data):
            return data
    return read_up_to(zstd_reader(BytesIO(packed)), max_size)


def read_up_to(source: BinaryIO, size: int) -> bytes:
    """Return at most ``size`` bytes of a stream, using memory for at most twice the bytes that are read."""
    blocks: List[bytes] = []
    while size > 0:
        # Read in blocks: a reader may allocate the requested size before it knows how much there is.
        block = source.read(min(size, _BLOCK_BYTES))
        if not block:
            break
        blocks.append(block)
        size -= len(block)
    return blocks[0] if len(blocks) == 1 else b"".join(blocks)


def copy_up_to(read: Callable[[int], bytes], target: BinaryIO, size: int) -> int:
    """Copy a stream until its end or until more than ``size`` bytes are copied; return the number of copied bytes.

    Args:
        read: method of the stream that returns at most a number of bytes.
        target: file to write to.
        size: the limit.
    """
    copied = 0
    while copied <= size:
        block = read(_BLOCK_BYTES)
        if not block:
            break
        copied += len(block)
        target.write(block)
    return copied


def zstd_reader(packed: BinaryIO) -> Any:
    """Return a decompressing reader, based on the zstd package that the installed version of ``rosbags`` imports."""
    zstd = _find_zstd()
    if zstd is not None:
        return zstd.open(packed, "rb")
    # Before version 0.11, rosbags imported the package `zstandard`.
    zstandard: Any = vars(_import_rosbag2_reader("zstandard"))["zstandard"]
    return zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)


def _find_zstd() -> Any:
    """Return the module of Python 3.14 or of its backport that ``rosbags`` imports; None before version 0.11."""
    return getattr(_import_rosbag2_reader("backports.zstd"), "zstd", None)


def _import_rosbag2_reader(package: str) -> Any:
    """Return the module of ``rosbags`` that imports the package for zstd.

    Raises:
        MissingPackageError: if that package is not installed.
    """
    try:
        from rosbags.rosbag2 import reader  # noqa: PLC0415 - an optional package
    except ImportError as error:
        raise _describe_missing_package("zstd", error.name or package) from None
    return reader


def describe_error(error: BaseException) -> str:
    """Return the text of an exception without a final full stop, or its class if it has no text."""
    return str(error).rstrip(".") or type(error).__name__
