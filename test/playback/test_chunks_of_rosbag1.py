"""Chunks of a bag come in the order in which messages ask for them, whoever decompresses them."""

import bz2
import threading
from io import BytesIO

import pytest

from retalis import BagReader
from retalis.playback import rosbag1 as module
from retalis.playback.decompression import ChunkLimit
from retalis.playback.rosbag1 import MAX_CHUNKS_AHEAD, MAX_REPEATS, Chunk, read_chunks

LIMIT = ChunkLimit(1)
TEXTS = [bytes([number]) * (number * 1000) for number in range(1, 9)]


def packed(kind, texts=TEXTS):
    """Return a file of packed chunks, and their places."""
    data, places = b"", {}
    for number, text in enumerate(texts):
        part = bz2.compress(text) if kind == "bz2" else text
        places[number] = Chunk(len(data), len(part), len(text), kind)
        data += part
    return BytesIO(data), places


@pytest.fixture(params=["none", "bz2"])
def kept(request, monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: 4)
    return packed(request.param)


def helpers():
    return [one for one in threading.enumerate() if one.name.startswith("chunks of a bag")]


@pytest.mark.parametrize("cores", [1, 2, 8])
def test_they_come_as_they_are_asked_for(kept, cores, monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: cores)
    order = [0, 0, 0, 1, 2, 2, 1, 7, 0, 0, 3]
    assert list(read_chunks(*kept, order, LIMIT)) == [TEXTS[at] for at in (0, 1, 2, 1, 7, 0, 3)]
    assert list(read_chunks(*kept, [], LIMIT)) == []
    assert helpers() == []


def test_what_is_broken_is_told_when_its_turn_comes(kept):
    file, places = kept
    good = places[2]
    for broken in (
        good._replace(position=len(file.getvalue()) + 10),
        good._replace(size=good.size + 1),
        good._replace(size=good.size - 1),
        good._replace(size=2 << 20),
        good._replace(compression="xz"),
        None,
    ):
        places[2] = broken
        if broken is None:
            del places[2]
        found = read_chunks(file, places, [0, 1, 2, 3], LIMIT)
        assert [next(found), next(found)] == TEXTS[:2]
        with pytest.raises(ValueError, match="chunk at byte 2"):
            next(found)
    assert helpers() == []


def test_few_are_decompressed_before_they_are_asked_for(monkeypatch):
    done = threading.Semaphore(0)
    number = []

    def unpack(*arguments, really=module.unpack):
        number.append(1)
        done.release()
        return really(*arguments)

    monkeypatch.setattr("os.cpu_count", lambda: 4)
    monkeypatch.setattr(module, "unpack", unpack)
    found = read_chunks(*packed("bz2"), range(8), LIMIT)
    assert next(found) == TEXTS[0]
    for _ in range(MAX_CHUNKS_AHEAD + 1):
        assert done.acquire(timeout=60)
    assert len(number) == MAX_CHUNKS_AHEAD + 1
    found.close()
    assert len(number) == MAX_CHUNKS_AHEAD + 1
    assert helpers() == []


@pytest.mark.parametrize("cores", [1, 4])
def test_a_chunk_that_is_asked_for_again_is_held_if_there_is_room(cores, monkeypatch):
    read = []

    def unpack(kind, data, size, really=module.unpack):
        read.append(size)
        return really(kind, data, size)

    monkeypatch.setattr("os.cpu_count", lambda: cores)
    monkeypatch.setattr(module, "unpack", unpack)
    texts = [bytes(300_000), bytes(400_000), bytes(900_000)]
    file, places = packed("bz2", texts)
    order = [0, 1] * 50
    assert [len(chunk) for chunk in read_chunks(file, places, order, LIMIT)] == [300_000, 400_000] * 50
    assert sorted(read) == [300_000, 400_000]
    read.clear()
    found = read_chunks(file, places, [1, 2] * 50, LIMIT)  # both together are larger than what may be held
    with pytest.raises(ValueError, match="messages of large chunks alternate in time too often"):
        for _ in found:
            pass
    assert 0 < read.count(900_000) <= MAX_REPEATS * 2 + 1


def test_a_compressed_bag_is_read_as_another(tmp_path):
    rosbag1 = pytest.importorskip("rosbags.rosbag1")
    found = []
    for name in ("NONE", "BZ2"):
        writer = rosbag1.Writer(tmp_path / f"{name}.bag")
        if name != "NONE":
            writer.set_compression(getattr(rosbag1.Writer.CompressionFormat, name))
        writer.chunk_threshold = 1000
        writer.open()
        talk = writer.add_connection("/talk", "std_msgs/msg/String", msgdef="string data\n", md5sum="0" * 32)
        for number in range(1, 300):
            writer.write(talk, number, bytes([number % 256]) * number)
        writer.close()
        with BagReader(tmp_path / f"{name}.bag") as bag:
            found.append([(record.time, record.data) for record in bag.records(start=5, stop=290)])
    assert found[0] == found[1]
    assert len(found[0]) == 285
