"""Texts of files that an editor has not saved yet; functions that read files of programs prefer them."""

import os
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Iterator, Mapping, Optional, Union

_texts: "ContextVar[Mapping[str, str]]" = ContextVar("unsaved_files")


@contextmanager
def unsaved_files(texts: Mapping[str, str]) -> Iterator[None]:
    """Let the readers of files return other texts, given by real path, than those of the disk."""
    token = _texts.set(texts)
    try:
        yield
    finally:
        _texts.reset(token)


def unsaved_text(path: Union[str, "os.PathLike[str]"]) -> Optional[str]:
    """Return the text of a file that is not saved yet, or None."""
    texts = _texts.get(None)
    return texts.get(os.path.realpath(path)) if texts else None
