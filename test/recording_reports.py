"""Reports of problems for tests that read them."""

from typing import List, Tuple

from retalis import Reports


class RecordingReports(Reports):
    """Reports that are recorded, and not logged.

    Attributes:
        records: kind of each report, "error" or "warning", and its text.
    """

    def __init__(self) -> None:
        super().__init__()
        self.records: List[Tuple[str, str]] = []

    @property
    def texts(self) -> List[str]:
        """The texts of all reports."""
        return [text for _, text in self.records]

    def error(self, error: Exception, kind: object = None) -> None:
        self.records.append(("error", str(error)))

    def warning(self, problem: object, kind: object = None, texts: int = 1, once: bool = False) -> None:
        self.records.append(("warning", str(problem)))
