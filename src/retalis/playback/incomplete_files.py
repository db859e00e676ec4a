"""Incomplete files of bags: what is missing in a file that a crash has cut, and the exit status for it."""

from typing import NamedTuple, Optional

from ..foundation.displayed_text import format_count
from ..prolog.terms.timestamps import SECOND

INCOMPLETE_STATUS = 3
"""Exit status of a command that has read an incomplete bag up to the break."""


class IncompleteFile(NamedTuple):
    """A file of a bag that was read up to a break, or whose recorder did not close it.

    >>> file = IncompleteFile("a.bag", "its index is missing", 2, 1_500_000_000, 4200, 17)
    >>> print(file)  # doctest: +NORMALIZE_WHITESPACE
    a.bag is incomplete: its index is missing: 2 messages were read, the last of time 1.500000000 s;
    17 bytes from byte 4200 on were not, the number of lost messages is unknown

    Attributes:
        path: path of the file, or of the folder that lacks ``metadata.yaml``.
        problem: description of what is missing.
        messages: number of messages that can be read.
        end: time of the last of these messages in nanoseconds; 0 if there are none.
        position: offset of the first byte that is not read; None if the break has no offset.
        unread_bytes: number of bytes from there to the end of the file.
        missing_bytes: minimum number of bytes that the file lacks by what it states; 0 if it states nothing.
        is_data_complete: whether all messages that the recorder had written are read.
        lost_messages: number of messages that the recorder had written and that cannot be read; None if no file
            states it.
    """

    path: str
    problem: str
    messages: int = 0
    end: int = 0
    position: Optional[int] = None
    unread_bytes: int = 0
    missing_bytes: int = 0
    is_data_complete: bool = False
    lost_messages: Optional[int] = None

    def __str__(self) -> str:
        read_text = f"{format_count(self.messages, 'message')} {'was' if self.messages == 1 else 'were'} read"
        if self.messages:
            seconds, nanoseconds = divmod(self.end, SECOND)
            read_text += f", the last of time {seconds}.{nanoseconds:09} s"
        return f"{self.path} is incomplete: {self.problem}: {read_text}; {self._describe_loss()}"

    def _describe_loss(self) -> str:
        """Return what is lost, as far as the file shows it."""
        losses = []
        if self.unread_bytes:
            verb = "was" if self.unread_bytes == 1 else "were"
            losses.append(
                f"{format_count(self.unread_bytes, 'byte')} from byte {self.position} on {verb} not"
            )
        if self.missing_bytes:
            verb = "is" if self.missing_bytes == 1 else "are"
            losses.append(f"at least {format_count(self.missing_bytes, 'byte')} {verb} missing")
        if self.is_data_complete:
            losses.append("no message in it is lost")
        elif self.lost_messages is not None:
            verb = "is" if self.lost_messages == 1 else "are"
            losses.append(f"{format_count(self.lost_messages, 'message')} {verb} lost")
        elif losses:
            losses.append("the number of lost messages is unknown")
        else:
            losses.append("messages that the recorder had not written are lost, their number is unknown")
        return ", ".join(losses)
