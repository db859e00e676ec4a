"""Chunks of a bag come in the order in which messages ask for them, whoever decompresses them."""

import bz2
import threading
from collections import namedtuple
from io import BytesIO

import pytest

from retalis.engine.playback import BagReader
from retalis.engine.playback.chunks import AHEAD, chunks

Chunk = namedtuple("Chunk", "datasize datapos decompressor")
Reader = namedtuple("Reader", "chunks bio")
TEXTS = [bytes([number]) * (number * 1000) for number in range(1, 9)]


def reader(compress, decompress):
    made, found = b"", {}
    for number, text in enumerate(TEXTS):
        data = compress(text)
        found[number] = Chunk(len(data), len(made), decompress)
        made += data
    return Reader(found, BytesIO(made))


@pytest.fixture(params=["none", "bz2"])
def kept(request, monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: 4)
    return reader(bz2.compress, bz2.decompress) if request.param == "bz2" else reader(bytes, bytes)


def helpers():
    return [one for one in threading.enumerate() if one.name.startswith("chunks of a bag")]


@pytest.mark.parametrize("cores", [1, 2, 8])
def test_they_come_as_they_are_asked_for(kept, cores, monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: cores)
    order = [0, 0, 0, 1, 2, 2, 1, 7, 0, 0, 3]
    assert list(chunks(kept, order)) == [TEXTS[at] for at in (0, 1, 2, 1, 7, 0, 3)]
    assert list(chunks(kept, [])) == []
    assert helpers() == []


def test_what_is_broken_is_told_when_its_turn_comes(kept):
    size, place, decompress = kept.chunks[2]
    beyond = Chunk(size, len(kept.bio.getvalue()) + 10, decompress)
    for broken in (beyond, Chunk(size, place, lambda raw: 1 // 0), None):
        kept.chunks[2] = broken
        if broken is None:
            del kept.chunks[2]
        found = chunks(kept, [0, 1, 2, 3])
        assert [next(found), next(found)] == TEXTS[:2]
        with pytest.raises((ValueError, KeyError, ZeroDivisionError)):
            next(found)
    assert helpers() == []


def test_few_are_decompressed_before_they_are_asked_for(monkeypatch):
    done = threading.Semaphore(0)
    number = []

    def decompress(data, really=bz2.decompress):
        number.append(1)
        done.release()
        return really(data)

    monkeypatch.setattr("os.cpu_count", lambda: 4)
    monkeypatch.setattr(bz2, "decompress", decompress)
    found = chunks(reader(bz2.compress, decompress), range(8))
    assert next(found) == TEXTS[0]
    for _ in range(AHEAD + 1):
        assert done.acquire(timeout=60)
    assert len(number) == AHEAD + 1
    found.close()
    assert len(number) == AHEAD + 1
    assert helpers() == []


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
