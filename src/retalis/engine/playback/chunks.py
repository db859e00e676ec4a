"""The chunks of a bag, in the order in which its messages ask for them."""

import bz2
import os
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import groupby
from typing import Any, Deque, Generator, Iterable, Iterator

AHEAD = 3
"""Chunks that are decompressed before they are asked for; so many more are held."""

_LARGEST = 4 << 20
"""Bytes of a compressed chunk up to which it is decompressed before it is asked for."""


def chunks(reader: Any, positions: Iterable[int]) -> Generator[bytes, None, None]:
    """Yield the records of chunks, one after the other; a chunk that is asked for twice in a row comes once.

    Those that are compressed by bz2, which takes most of the time of reading, are decompressed by other threads
    meanwhile: that needs no lock of the interpreter's.

    Args:
        reader: of ``rosbags``, open.
        positions: of the chunks, as the messages need them.

    Raises:
        Exception: whatever the bytes of a broken bag lead to, when that chunk's turn comes.
    """
    order = [position for position, _ in groupby(positions)]
    others = min(2, (os.cpu_count() or 1) - 1)
    if others and any(_is_slow(reader.chunks.get(position)) for position in order):
        with ThreadPoolExecutor(others, "chunks of a bag") as pool:
            yield from _ahead(pool, reader, order)
        return
    for position in order:
        chunk = reader.chunks[position]
        yield _records(chunk, _raw(reader, chunk))


def _is_slow(chunk: Any) -> bool:
    return chunk is not None and chunk.decompressor is bz2.decompress and chunk.datasize <= _LARGEST


def _ahead(pool: ThreadPoolExecutor, reader: Any, order: Iterable[int]) -> Iterator[bytes]:
    waiting: Deque[Future[bytes]] = deque()
    for position in order:
        waiting.append(_begin(pool, reader, position))
        if len(waiting) > AHEAD:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


def _begin(pool: ThreadPoolExecutor, reader: Any, position: int) -> "Future[bytes]":
    try:
        chunk = reader.chunks[position]
        raw = _raw(reader, chunk)
    except (KeyError, OSError, ValueError) as error:  # what comes before is there all the same
        broken: Future[bytes] = Future()
        broken.set_exception(error)
        return broken
    return pool.submit(_records, chunk, raw)


def _raw(reader: Any, chunk: Any) -> bytes:
    reader.bio.seek(chunk.datapos)
    raw: bytes = reader.bio.read(chunk.datasize)
    return raw


def _records(chunk: Any, raw: bytes) -> bytes:
    if len(raw) != chunk.datasize:
        raise ValueError("a chunk is truncated")
    return bytes(chunk.decompressor(raw))
