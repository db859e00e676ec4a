"""Answers of the dashboard that are computed in threads at the same time: their number is limited."""

import asyncio
import threading
from typing import Any, List

import pytest

pytest.importorskip("tornado", reason="the page needs tornado")

from retalis import Engine
from retalis.dashboard.request_handlers import BUSY_ANSWER, MAX_CONCURRENT_ANSWERS, AnswerService, ErrorAnswer
from retalis.dashboard.view_model import DashboardSource, Snapshots


def test_thread_that_does_not_start_occupies_no_slot(monkeypatch: pytest.MonkeyPatch) -> None:
    source = DashboardSource(Engine(), "test")
    service = AnswerService(source, Snapshots(source))
    answers: List[Any] = []

    def refuse(thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    async def ask() -> None:
        with monkeypatch.context() as context:
            context.setattr(threading.Thread, "start", refuse)
            for _ in range(MAX_CONCURRENT_ANSWERS):
                answers.append(await service.answer_in_thread(lambda: ErrorAnswer("x")))
        answers.append(await service.answer_in_thread(lambda: ErrorAnswer("answer")))

    # `asyncio.run` would leave this thread without an event loop.
    loop = asyncio.new_event_loop()
    loop.run_until_complete(ask())
    loop.close()
    assert answers == [ErrorAnswer(BUSY_ANSWER)] * MAX_CONCURRENT_ANSWERS + [ErrorAnswer("answer")]
