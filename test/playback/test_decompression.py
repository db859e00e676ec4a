"""Decompression up to the stated size and up to the limit; bombs of each format."""

import io
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, List

import pytest

pytest.importorskip("rosbags")

from malicious_bags import (  # noqa: E402
    MEGABYTE,
    PACK,
    folder_bag,
    mcap,
    mcap_message,
    packed_zeros,
    ros1_bag,
    sqlite_bag,
    zstd,
)
from subprocess_python_path import python_path

from retalis.playback.decompression import ChunkLimit, ChunkLimitError, copy_up_to, read_up_to, unpack  # noqa: E402


@pytest.mark.parametrize("compression", PACK)
@pytest.mark.parametrize("data", [b"", b"a", bytes(range(256)) * 900], ids=len)
def test_only_data_of_stated_size_is_unpacked(compression: Any, data: bytes) -> None:
    packed = PACK[compression](data)
    assert unpack(compression, packed, len(data)) == data
    with pytest.raises(
        ValueError, match=f"it ends after {len(data)} bytes: its header states {len(data) + 1}$"
    ):
        unpack(compression, packed, len(data) + 1)
    if data:
        with pytest.raises(ValueError, match=f"more than the {len(data) - 1} bytes that its header states"):
            unpack(compression, packed, len(data) - 1)


@pytest.mark.parametrize("compression", ["bz2", "lz4", "zstd"])
def test_truncated_data_is_an_error(compression: str) -> None:
    data = bytes(range(256)) * 50
    packed = PACK[compression](data)
    for end in range(0, len(packed), 7):
        with pytest.raises((ValueError, RuntimeError, EOFError)):
            unpack(compression, packed[:end], len(data))


def test_unknown_compression_is_an_error() -> None:
    with pytest.raises(ValueError, match="compression 'xz' is unknown: expected none, bz2, lz4 or zstd"):
        unpack("xz", b"", 0)


def test_message_is_unpacked_up_to_limit() -> None:
    limit = ChunkLimit(1)
    assert limit.unpack_message(zstd(b"a" * MEGABYTE)) == b"a" * MEGABYTE
    with pytest.raises(
        ChunkLimitError, match=r"expected at most 1 MB, the limit that --max-chunk-megabytes raises"
    ):
        limit.unpack_message(zstd(b"a" * (MEGABYTE + 1)))
    with pytest.raises(ValueError, match="it states 1000001 bytes: expected at most 1 MB"):
        limit.check(MEGABYTE + 1, "it states")
    limit.check(MEGABYTE, "it states")


def test_large_limit_is_written_in_full() -> None:
    with pytest.raises(ChunkLimitError, match="expected at most 1234567 MB"):
        ChunkLimit(1_234_567).check(10**13, "it states")


def test_stream_is_read_and_copied_up_to_size() -> None:
    data = bytes(5 * MEGABYTE)
    assert len(read_up_to(io.BytesIO(data), 3 * MEGABYTE + 7)) == 3 * MEGABYTE + 7
    assert read_up_to(io.BytesIO(b"abc"), 9) == b"abc"
    target = io.BytesIO()
    assert copy_up_to(io.BytesIO(data).read, target, len(data)) == len(data) == len(target.getvalue())
    assert MEGABYTE < copy_up_to(io.BytesIO(data).read, io.BytesIO(), MEGABYTE) <= 2 * MEGABYTE


def bombs(folder: Path) -> Any:
    """Write small files that contain or state 200 MB; return each path with a part of its error message."""
    zeros = {compression: packed_zeros(compression, 200) for compression in ("bz2", "lz4", "zstd")}
    size = 200 * MEGABYTE
    expected_errors: List[Any] = []

    def write(name: str, data: Any, expected: str) -> None:
        (folder / name).write_bytes(data)
        expected_errors.append((folder / name, expected))

    for compression in ("bz2", "lz4"):
        chunk = {"compression": compression, "packed": zeros[compression]}
        write(f"more-{compression}.bag", ros1_bag([[b"hello"]], **chunk), "has more than the 55 bytes")
        write(
            f"much-{compression}.bag",
            ros1_bag([[b"hello"]], **chunk, stated=size),
            f"states {size} bytes: expected at",
        )
    for compression in ("lz4", "zstd"):
        for index in (True, False):
            chunk = {"compression": compression, "packed": zeros[compression], "has_index": index}
            message = [mcap_message(1)]
            write(f"more-{compression}-{index}.mcap", mcap(message, **chunk), "has more than the 45 bytes")
            write(
                f"much-{compression}-{index}.mcap",
                mcap(message, **chunk, stated=size),
                f"states {size} bytes",
            )
    several = [mcap_message(1) + mcap_message(second, b"\0" * 4 * MEGABYTE) for second in range(9, 29)]
    write("overlapping.mcap", mcap(several, "zstd"), "chunks that overlap in time have")
    for suffix in (".mcap.zstd", ".db3.zstd"):
        write(
            f"whole{suffix}",
            zeros["zstd"],
            "is too large: unpacked it would have more than 20000000 bytes",
        )
    file = folder_bag(folder / "file", "whole.mcap.zstd", "mcap", "file")
    (file / "whole.mcap.zstd").write_bytes(zeros["zstd"])
    expected_errors.append((file, "is too large: unpacked"))
    message = folder_bag(folder / "message", "one.db3", "sqlite3", "message")
    sqlite_bag(message / "one.db3", messages=[(1, zeros["zstd"])])
    expected_errors.append(
        (message, "a compressed message has more bytes than allowed: expected at most 20 MB")
    )
    return expected_errors


READ = """
import resource, sys
from retalis.playback.bag_locations import MergedBag; from retalis.playback.rosbag1 import BagError
def read(path):
    try:
        with MergedBag([path], max_chunk_megabytes=20) as bag:
            return str(len(list(bag.records())))
    except BagError as error:
        return str(error)
for path in sys.argv[2].split():  # imports modules before the limit is set
    assert read(path) == "1", read(path)
usage = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
limit = usage + int(sys.argv[1])
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
for path in sys.argv[3:]:
    print(read(path))
"""


@pytest.mark.slow
@pytest.mark.skipif(
    not Path("/proc/self/statm").exists(), reason="the system does not report the size of a process"
)
def test_bomb_of_each_format_is_an_error(tmp_path: Path) -> None:
    """100 MB suffice for chunks of at most 20 MB, which are in memory twice while their blocks are joined."""
    expected_errors = bombs(tmp_path)
    assert max(path.stat().st_size for path, _ in expected_errors if path.is_file()) < 3 * MEGABYTE
    valid_folder = tmp_path / "fine"
    valid_folder.mkdir()
    (valid_folder / "a.bag").write_bytes(ros1_bag([[b"hello"]], compression="lz4"))
    (valid_folder / "a.mcap").write_bytes(mcap([mcap_message(1)], "zstd"))
    (valid_folder / "a.mcap.zstd").write_bytes(zstd((valid_folder / "a.mcap").read_bytes()))
    sqlite_bag(valid_folder / "a.db3")
    folder_bag(valid_folder, "a.db3", "sqlite3")
    valid_paths = " ".join(map(str, [valid_folder, *sorted(valid_folder.glob("a.*"))]))
    environment = {**os.environ, "PYTHONPATH": python_path()}
    command = [
        sys.executable,
        "-c",
        READ,
        str(100 * MEGABYTE),
        valid_paths,
        *(str(path) for path, _ in expected_errors),
    ]
    process = subprocess.run(command, stdout=subprocess.PIPE, env=environment, text=True, check=True)
    lines = process.stdout.splitlines()
    mismatches = [
        (path.name, line)
        for (path, expected), line in zip(expected_errors, lines)
        if expected not in line or str(path) not in line
    ]
    assert mismatches == []
    assert len(lines) == len(expected_errors)
