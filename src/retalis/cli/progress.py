"""A progress bar on standard error, where somebody looks."""

import sys
from contextlib import contextmanager
from typing import Callable, Iterator


@contextmanager
def progress(what: str, total: int) -> Iterator[Callable[[int], None]]:
    """Give a function that is told how much is done; it shows a bar where standard error is a terminal.

    The bar needs the package ``tqdm``; without it, or with no terminal, nothing is shown.
    """
    try:
        from tqdm import tqdm  # noqa: PLC0415 - an optional package
    except ImportError:
        yield lambda done: None
        return
    with tqdm(total=total, unit=f" {what}", disable=not sys.stderr.isatty(), leave=False) as bar:
        yield lambda done: bar.update(done - bar.n)
