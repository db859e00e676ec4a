import pytest
from events.stream_programs import Program


@pytest.fixture
def program(tmp_path, monkeypatch):
    """A program that may read the files of the current folder, which is `tmp_path`."""
    monkeypatch.chdir(tmp_path)
    return Program(folder=tmp_path)
