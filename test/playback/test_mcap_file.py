"""MCAP files: order, limits, and damaged files."""

import struct
from pathlib import Path
from typing import Any, List, Tuple

import pytest

pytest.importorskip("rosbags.rosbag2")

from malicious_bags import mcap, mcap_message  # noqa: E402

from retalis import BagError  # noqa: E402
from retalis.playback.bag_locations import MergedBag  # noqa: E402
from retalis.playback.decompression import ChunkLimit  # noqa: E402
from retalis.playback.mcap_file import McapFile  # noqa: E402

SECOND = 10**9


def read(path: Any) -> List[Tuple[Any, ...]]:
    with MergedBag([path], max_chunk_megabytes=1) as bags:
        return [(record.time // SECOND, record.data[8:-1]) for record in bags.records()]


CHUNKS = [
    mcap_message(5) + mcap_message(1),
    mcap_message(3) + mcap_message(9),
    mcap_message(10) + mcap_message(12),
]


@pytest.mark.parametrize("has_index", [True, False])
@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
def test_chunks_are_merged_by_time(tmp_path: Path, compression: str, has_index: bool) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(mcap(CHUNKS, compression, has_index=has_index))
    assert [time for time, _ in read(path)] == [1, 3, 5, 9, 10, 12]


INDEX_OF_CHANNEL_1, INDEX_OF_CHANNEL_2 = (struct.pack("<IHQ", 10, channel, 0) for channel in (1, 2))
DAMAGED_INDEX = struct.pack("<I", 1_000_000)


def test_chunks_without_requested_channels_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    content = mcap(CHUNKS, indexed_channels=[INDEX_OF_CHANNEL_1, INDEX_OF_CHANNEL_2, INDEX_OF_CHANNEL_1])
    # A record that states too many bytes would be an error.
    damaged = content.index(CHUNKS[1]) + 1
    path.write_bytes(content[:damaged] + b"\xff" * 8 + content[damaged + 8 :])
    assert [time for time, _ in read(path)] == [1, 5, 10, 12]


@pytest.mark.parametrize("index", [struct.pack("<I", 0), DAMAGED_INDEX, struct.pack("<I3s", 3, b"abc")])
def test_chunks_without_valid_index_of_channels_are_read(tmp_path: Path, index: Any) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(mcap(CHUNKS, indexed_channels=[INDEX_OF_CHANNEL_1, index, INDEX_OF_CHANNEL_1]))
    assert [time for time, _ in read(path)] == [1, 3, 5, 9, 10, 12]


def mcap_without_chunks(seconds: Any, chunks: Any = (), profile: str = "ros2") -> Any:
    """Return a file with messages outside of chunks, each with its number as data."""
    data = mcap(chunks, has_index=False, profile=profile)
    end = len(data) - 37
    messages = (
        mcap_message(second, b"\0\1\0\0" + struct.pack("<I2s", 2, b"%d\0" % number))
        for number, second in enumerate(seconds)
    )
    return data[:end] + b"".join(messages) + data[end:]


@pytest.mark.parametrize(
    ("seconds", "chunks", "expected"),
    [
        ([1, 2, 2, 7], [mcap_message(1)], [1, 1, 2, 2, 7]),
        ([1, 3, 2], [], [1, 2, 3]),
        ([5, 7, 3, 6, 0, 8], CHUNKS[:1], [0, 1, 3, 5, 5, 6, 7, 8]),
    ],
)
def test_messages_outside_of_chunks_are_sorted(
    tmp_path: Path, seconds: List[int], chunks: Any, expected: List[int]
) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(mcap_without_chunks(seconds, chunks))
    assert [time for time, _ in read(path)] == expected


def test_messages_of_equal_time_keep_their_order(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(mcap_without_chunks([2, 2, 1, 2]))
    assert read(path) == [(1, b"2"), (2, b"0"), (2, b"1"), (2, b"3")]
    file = McapFile(path, ChunkLimit(1))
    assert [time // SECOND for _, time, _ in file.read([1], 2 * SECOND, None)] == [2, 2, 2]
    assert list(file.read([2], None, None)) == []
    file.close()


def test_index_of_unsorted_messages_is_limited(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(mcap_without_chunks([2, 1, 3, 4] * 8000))
    with pytest.raises(
        BagError, match="the index of 32000 unsorted messages takes 1024000 bytes: expected at"
    ):
        read(path)


@pytest.mark.parametrize("profile", ["", "ros1", "any"])
def test_profile_of_header_is_not_needed(tmp_path: Path, profile: str) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(mcap_without_chunks([1], profile=profile))
    assert read(path) == [(1, b"0")]


def test_missing_message_counts_are_computed(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(mcap(CHUNKS, has_counts=False))
    with MergedBag([path]) as bags:
        assert [topic.messages for topic in bags.topics] == [6]
    assert [time for time, _ in read(path)] == [1, 3, 5, 9, 10, 12]


WRONG_MCAP = [
    (mcap([CHUNKS[0]], repeated=2), "the index names the chunk at byte 124 inside another one"),
    (mcap([b"\0" * 900]), "a chunk has a record with opcode 0: expected schemas, channels, messages"),
    (
        mcap([struct.pack("<BQ", 5, 1 << 62)]),
        "a record in a chunk states 4611686018427387904 bytes: there are fewer",
    ),
    (b"\x89MCAP0\r\n", "its header is cut or damaged"),
    (
        mcap([mcap_message(1, bytes(400_000))] * 3),
        "chunks that overlap in time have 1200093 bytes: expected at most 1 ",
    ),
]


@pytest.mark.parametrize(("data", "expected"), WRONG_MCAP, ids=range(len(WRONG_MCAP)))
def test_malicious_file_is_an_error(tmp_path: Path, data: Any, expected: str) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    with pytest.raises(BagError, match=expected):
        read(path)


def test_disjoint_chunks_are_held_one_at_a_time(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    chunks = [mcap_message(second, bytes(400_000)) for second in range(9)]
    path.write_bytes(mcap(chunks, times=[(second, second) for second in range(9)]))
    file = McapFile(path, ChunkLimit(1))
    assert [time // SECOND for _, time, _ in file.read([1], None, None)] == list(range(9))
    file.close()
