"""Worker processes: order, bounds, errors, and their end."""

from __future__ import annotations

import os
import signal
import time
from multiprocessing import active_children

import numpy as np
import pytest

from beamseg_batch import parallel
from beamseg_batch.errors import ConfigError, WorkerError
from beamseg_batch.parallel import Workers, usable_cores

LIMIT_S = 30.0


@pytest.fixture(autouse=True)
def soon():
    """Fail a test that hangs, and one that leaves a process."""

    def give_up(*_):
        raise TimeoutError(f"still waiting after {LIMIT_S} s")

    previous = signal.signal(signal.SIGALRM, give_up)
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, previous)
    assert active_children() == []


@pytest.fixture
def three():
    with Workers(3) as workers:
        workers.start(abs, 0)
        yield workers


@pytest.fixture
def two():
    with Workers(2) as workers:
        workers.start(abs, 0)
        yield workers


def late_first(number):
    """Square, taking longest for the first of three."""
    time.sleep(0.02 * (2 - number % 3))
    return number**2


def refused_at_five(number):
    if number == 5:
        raise ValueError("five")
    return number


def ends_at_five(number):
    if number == 5:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def exits(number):
    os._exit(7)


def is_killed_answering(number):
    """Be killed while half of an answer is on its way."""
    if number == 3:
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        signal.signal(signal.SIGALRM, lambda *_: os.kill(os.getpid(), signal.SIGKILL))
    return np.ones(20_000_000 if number == 3 else 1)


def sleeps(number):
    time.sleep(60.0)


def of_array(array):
    return os.getpid(), float(array.sum()), array.flags.writeable, array.flags.c_contiguous


class Prepared:
    value = 0


def prepare(value):
    Prepared.value = value


def prepared(_):
    return Prepared.value


def numbers_until_damage(count):
    yield from range(count)
    raise OSError("damaged")


# --- answers ----------------------------------------------------------------------------


@pytest.mark.parametrize("chunk", [1, 4])
def test_map__gives_items_and_results_in_order(three, chunk):
    expected = [(number, number**2) for number in range(10)]
    assert list(three.map(late_first, range(10), chunk)) == expected
    assert list(Workers(1).map(late_first, range(10), chunk)) == expected
    assert list(three.map(late_first, [], chunk)) == []


def test_map__takes_one_function_after_another(three):
    assert [result for _, result in three.map(abs, [-1, -2, -3])] == [1, 2, 3]
    assert [result for _, result in three.map(str, [-1, -2, -3])] == ["-1", "-2", "-3"]


def test_map__reads_few_items_ahead(three):
    read = []
    items = (read.append(number) or number for number in range(100))
    for item, _ in three.map(abs, items, 2):
        assert len(read) - item <= 2 * 2 * three.jobs
    assert len(read) == 100


def test_map__arrays_arrive_as_they_are_and_cannot_be_written(two):
    arrays = [np.full(size, 0.5) for size in (10, 100_000, 1_000, 500_000, 0)]
    for array in arrays:
        array.flags.writeable = False
    answers = list(two.map(of_array, arrays))
    assert [answer[1:] for _, answer in answers] == [(0.5 * len(a), False, True) for a in arrays]
    assert os.getpid() not in {answer[0] for _, answer in answers}
    assert answers[1][0] is arrays[1]


def test_map__elsewhere_than_on_linux(monkeypatch):
    monkeypatch.setattr(parallel, "_FORKED", False)
    monkeypatch.setattr(parallel, "_SHARING", False)
    array = np.full(100_000, 0.5)
    array.flags.writeable = False
    with Workers(2) as workers:
        workers.start(abs, 0)
        answers = [answer[1:] for _, answer in workers.map(of_array, [array] * 4)]
        assert answers == [(50_000.0, False, True)] * 4
        with pytest.raises(WorkerError, match="SIGKILL"):
            list(workers.map(ends_at_five, range(10)))


def test_start__processes_that_cannot_be_started(monkeypatch):
    def refuse(*_):
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(parallel, "send_handle", refuse)
    with Workers(2) as workers, pytest.raises(WorkerError, match=r"1 of 2 cannot be .*; use --jo"):
        workers.start(abs, 0)


def test_start__prepares_every_process():
    with Workers(2) as workers:
        workers.start(prepare, 5)
        assert [result for _, result in workers.map(prepared, range(8))] == [5] * 8
    assert Prepared.value == 0


def test_workers__one_job_makes_no_process():
    with Workers(1) as workers:
        workers.start(prepare, 5)
        ((_, process),) = workers.map(lambda _: os.getpid(), [0])
        assert process == os.getpid()
        assert active_children() == []


def test_workers__zero_is_all_cores(monkeypatch):
    monkeypatch.setattr("beamseg_batch.parallel.usable_cores", lambda: 1)
    assert Workers(0).jobs == 1
    assert usable_cores() >= 1


def test_workers__less_is_refused():
    with pytest.raises(ConfigError, match="jobs is -1: it must be 0, for all cores, or more"):
        Workers(-1)


# --- errors -----------------------------------------------------------------------------


@pytest.mark.parametrize("chunk", [1, 4])
def test_map__error_of_the_items_comes_after_what_was_read(three, chunk):
    results = []
    with pytest.raises(OSError, match="damaged"):
        results.extend(result for _, result in three.map(abs, numbers_until_damage(7), chunk))
    assert results == list(range(7))


def test_map__error_of_the_function_is_raised_as_itself(three):
    results = []
    with pytest.raises(ValueError, match="five") as caught:
        results.extend(result for _, result in three.map(refused_at_five, range(20)))
    assert results == list(range(5))
    assert "in refused_at_five" in str(caught.value.__cause__)
    assert [result for _, result in three.map(abs, range(20))] == list(range(20))


def test_map__dead_worker_is_an_error(two):
    results = []
    with pytest.raises(WorkerError, match="of 2 ended unexpectedly, killed by signal SIGKILL"):
        results.extend(result for _, result in two.map(ends_at_five, range(20)))
    assert results == list(range(5))


def test_map__worker_killed_from_outside_is_an_error(two):
    with pytest.raises(WorkerError, match="for lack of memory: use fewer --jobs, or --jobs 1"):
        for number, _ in two.map(abs, range(1000)):
            if number == 5:
                for process in active_children():
                    process.kill()


def test_map__half_an_answer_is_an_error(two):
    with pytest.raises(WorkerError, match="SIGKILL"):
        list(two.map(is_killed_answering, range(12)))


def test_map__worker_that_exits_is_an_error(two):
    with pytest.raises(WorkerError, match="with exit code 7; use --jobs 1"):
        list(two.map(exits, range(3)))


# --- the end ----------------------------------------------------------------------------


def test_map__closed_early_leaves_the_workers_free(three):
    answers = three.map(late_first, range(1000))
    assert next(answers) == (0, 0)
    answers.close()
    assert [result for _, result in three.map(abs, range(10))] == list(range(10))


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_workers__end_at_once_whatever_they_are_doing(error):
    with pytest.raises(error), Workers(2) as workers:
        workers.start(abs, 0)
        answers = workers.map(sleeps, range(10))
        signal.signal(signal.SIGALRM, lambda *_: (_ for _ in ()).throw(error))
        signal.setitimer(signal.ITIMER_REAL, 0.5)
        next(answers)
