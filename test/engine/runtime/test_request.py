import threading

import pytest

from retalis.engine.runtime.serial_executor import Request


def test_work_is_done_once_and_its_result_waits_for_the_caller():
    done = []
    call = Request(lambda: done.append(1) or 7)
    assert not call.begun
    call()
    call()
    assert done == [1]
    assert call.wait(10)
    assert call.result() == 7


def test_an_interrupt_is_no_result():
    def interrupted():
        raise KeyboardInterrupt

    call = Request(interrupted)
    with pytest.raises(KeyboardInterrupt):
        call()
    with pytest.raises(KeyboardInterrupt):  # for the caller that waits, who may be another
        call.result()


def test_what_its_caller_has_given_up_is_not_done():
    done = []
    call = Request(lambda: done.append(1))
    assert call.take()
    call()
    assert (done, call.take()) == ([], False)


def test_work_that_an_interrupt_has_ended_anywhere_wakes_who_waits():
    call = Request(lambda: None)
    waiting = threading.Thread(target=call.wait, args=(10,))
    waiting.start()
    call.abandon()
    assert not call.over  # it has not begun
    call.take()
    call.abandon()
    waiting.join(10)
    assert not waiting.is_alive()
    with pytest.raises(KeyboardInterrupt):
        call.result()
