"""Work on many items in several processes, with the answers in the order of the items.

Every worker has a pipe of its own to the process that asks, and a thread there that waits
at it. Nothing is shared between workers: the end of one, however it comes, closes its pipe
and is an error at once, and the end of the process that asks is the end of the workers.
(The pools of the standard library share two queues among their processes: one that is
killed while it answers can leave the lock, or half an answer, for good.)

Large arrays go through a block of memory that each worker shares with the process that
asks, where the system has such: through the pipe they would take as long as the work.
"""

from __future__ import annotations

import mmap
import multiprocessing
import os
import pickle
import signal
import sys
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle, send_handle
from queue import SimpleQueue
from typing import Any, Generic, TypeVar

from beamseg_batch.errors import ConfigError, WorkerError

__all__ = ["Workers", "load_ahead", "one_thread_each", "usable_cores"]

_PROTOCOL = 5  # arrays that cannot be written stay so, and kernels are compiled for such
_LARGE_BYTES = 4096
_ALIGNED_BYTES = 64
_FORKED = sys.platform == "linux"  # elsewhere the system's own libraries may not be forked
_SHARING = hasattr(os, "memfd_create")
_PRELOADED = "beamseg_batch.preloaded"
_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")

T = TypeVar("T")
R = TypeVar("R")


def usable_cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def one_thread_each() -> None:
    """Have numpy's linear algebra use one thread, here and in workers, unless told otherwise.

    It is read when numpy is first imported.
    """
    for name in _THREADS:
        os.environ.setdefault(name, "1")


def load_ahead() -> None:
    """Begin to load what workers need, so that they start at once when they are wanted."""
    if _FORKED:
        from multiprocessing import forkserver

        _context().set_forkserver_preload([_PRELOADED])
        with _started():
            forkserver.ensure_running()


class Workers:
    """Processes that apply functions to items; with one job the caller does it all itself.

    A context: the processes end with it, whatever they are doing.

    Parameters
    ----------
    jobs : int
        Number of processes; 0 for as many as there are cores.

    Raises
    ------
    ConfigError
        If `jobs` is negative.
    WorkerError
        If processes cannot be started here.
    """

    def __init__(self, jobs: int) -> None:
        if jobs < 0:
            raise ConfigError(f"jobs is {jobs}: it must be 0, for all cores, or more")
        self.jobs = jobs or usable_cores()
        self._workers: list[_Worker] = []
        self._idle: SimpleQueue[_Worker] = SimpleQueue()
        if self.jobs > 1:
            self._threads = ThreadPoolExecutor(self.jobs)
            load_ahead()

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.end()
        if self.jobs > 1:
            self._threads.shutdown(cancel_futures=True)
        for worker in self._workers:
            worker.close()

    def start(self, prepare: Callable[[T], object], argument: T) -> None:
        """Start the processes, and have each prepare itself; nothing to do with one job.

        Parameters
        ----------
        prepare : callable
        argument : object
            What it is called with.

        Raises
        ------
        WorkerError
            If one cannot be started.
        """
        if self.jobs == 1:
            return
        for number in range(self.jobs):
            self._workers.append(_Worker(f"{number + 1} of {self.jobs}"))
        question = _pickled(prepare)
        for worker in self._workers:
            self._idle.put(worker)
        # Each is asked by a thread of its own; the first in need of work takes the first free.
        for future in [self._threads.submit(w.ask, question, [argument]) for w in self._workers]:
            future.result()

    def map(
        self, function: Callable[[T], R], items: Iterable[T], chunk: int = 1
    ) -> Iterator[tuple[T, R]]:
        """Apply a function to items; several are read ahead, however many there are.

        Parameters
        ----------
        function : callable
            Sent to each worker once. It must not keep arrays of an item: their memory is used
            again for the next.
        items : iterable
        chunk : int
            How many are sent to a worker at a time.

        Yields
        ------
        item : object
        result : object
            In the order of the items.

        Raises
        ------
        WorkerError
            If a worker ended.
        Exception
            What the function or the items raise, when all results before are out.
        """
        if self.jobs == 1:
            for item in items:
                yield item, function(item)
            return
        question, chunks = _pickled(function), _Chunks(items, chunk)
        unread = iter(chunks)
        waiting: deque[tuple[list[T], Future[list[R]]]] = deque()
        try:
            while True:
                while len(waiting) < 2 * self.jobs and (part := next(unread, None)) is not None:
                    waiting.append((part, self._threads.submit(self._ask, question, part)))
                if not waiting:
                    break
                part, future = waiting.popleft()
                yield from zip(part, future.result(), strict=True)
        finally:
            for _, future in waiting:
                future.cancel()
        if chunks.error is not None:
            raise chunks.error

    def _ask(self, question: bytes, items: list[Any]) -> list[Any]:
        worker = self._idle.get()
        try:
            return worker.ask(question, items)
        finally:
            self._idle.put(worker)


class _Worker:
    """One process, as seen from the one that asks it."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._question: bytes | None = None
        self._block = _Block(os.memfd_create("beamseg")) if _SHARING else None
        self._connection, theirs = multiprocessing.Pipe()
        self._process = _context().Process(target=_work, args=(theirs, _SHARING), daemon=True)
        try:
            if _FORKED:
                self._process.start()  # waits until all is loaded, which may be interrupted
            else:
                with _started():
                    self._process.start()
            if self._block is not None:
                send_handle(self._connection, self._block.handle, self._process.pid)
        except (EOFError, OSError) as error:
            self.end()
            self.close()
            raise WorkerError(
                f"worker process {name} cannot be started: {str(error) or type(error).__name__}; "
                "use --jobs 1"
            ) from error
        finally:
            theirs.close()  # else its end would not be the end of the pipe

    def ask(self, question: bytes, items: list[Any]) -> list[Any]:
        """Apply a function, pickled, to items; it is sent when it is another than the last."""
        is_new = question is not self._question
        self._question = question
        try:
            self._connection.send_bytes(
                _pickled((question if is_new else None, *_packed(items, self._block)))
            )
            reply = self._connection.recv_bytes()
        except (EOFError, OSError) as error:
            raise self._death() from error
        answers, failure = pickle.loads(reply)
        if failure is not None:
            raised, where = failure
            raise raised from _RemoteError(where)
        results: list[Any] = answers
        return results

    def end(self) -> None:
        """End the process at once; whoever waits for its answer is told."""
        if self._process.pid is not None:
            self._process.kill()
            self._process.join()

    def close(self) -> None:
        """Give back what it was asked through, when nobody asks any more."""
        self._connection.close()
        if self._block is not None:
            self._block.close()

    def _death(self) -> WorkerError:
        self._process.join(1.0)
        code = self._process.exitcode
        where = f"worker process {self._name} ended unexpectedly"
        if code is None or code >= 0:
            return WorkerError(
                f"{where}, with exit code {code}; use --jobs 1. A script that asks for several "
                'jobs has to do so below `if __name__ == "__main__":`'
            )
        how: int | str = -code
        with suppress(ValueError):
            how = signal.Signals(-code).name
        return WorkerError(
            f"{where}, killed by signal {how}, most often for lack of memory: use fewer --jobs, "
            "or --jobs 1"
        )


class _Block:
    """Memory that two processes share: one puts arrays into it, the other looks at them.

    Parameters
    ----------
    handle : int
        File descriptor of the memory.
    """

    def __init__(self, handle: int) -> None:
        self.handle = handle
        self._memory: mmap.mmap | None = None

    def put(self, arrays: list[memoryview]) -> list[slice]:
        """Copy the bytes of arrays into the block; where each lies."""
        places, end = [], 0
        for array in arrays:
            places.append(slice(end, end + array.nbytes))
            end += -(-array.nbytes // _ALIGNED_BYTES) * _ALIGNED_BYTES
        if end > os.fstat(self.handle).st_size:
            os.ftruncate(self.handle, end)
        memory = self._reaching(end)
        for place, array in zip(places, arrays, strict=True):
            memory[place] = array
        return places

    def look(self, places: list[slice]) -> list[memoryview]:
        """Read-only views of what lies in the block, until it is used again."""
        memory = memoryview(self._reaching(places[-1].stop if places else 0)).toreadonly()
        return [memory[place] for place in places]

    def _reaching(self, end: int) -> Any:
        """Map the block anew if it has grown; views of the old one keep that alive."""
        if end and (self._memory is None or len(self._memory) < end):
            self._memory = mmap.mmap(self.handle, os.fstat(self.handle).st_size)
        return self._memory if self._memory is not None else b""

    def close(self) -> None:
        """Give the memory back."""
        self._memory = None
        os.close(self.handle)


def _packed(items: list[Any], block: _Block | None) -> tuple[bytes, list[slice]]:
    """Pickle items, but for their large arrays, which are put into the block."""
    if block is None:
        return _pickled(items), []
    arrays: list[memoryview] = []

    def stays(buffer: pickle.PickleBuffer) -> bool:
        array = buffer.raw()
        is_small = array.nbytes < _LARGE_BYTES
        if not is_small:
            arrays.append(array)
        return is_small

    return pickle.dumps(items, _PROTOCOL, buffer_callback=stays), block.put(arrays)


class _RemoteError(Exception):
    """Where in a worker an error arose."""


class _Chunks(Generic[T]):
    """Items some at a time; an error among them is kept until those before it are done."""

    def __init__(self, items: Iterable[T], size: int) -> None:
        self._items, self._size = items, size
        self.error: Exception | None = None

    def __iter__(self) -> Iterator[list[T]]:
        chunk: list[T] = []
        try:
            for item in self._items:
                chunk.append(item)
                if len(chunk) == self._size:
                    yield chunk
                    chunk = []
        except Exception as error:
            self.error = error
        if chunk:
            yield chunk


def _work(connection: Connection, shares: bool) -> None:
    """Answer until nobody asks any more; the body of a worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that asks
    function: Callable[[Any], Any] | None = None
    with suppress(EOFError, OSError):
        block = _Block(recv_handle(connection)) if shares else None
        while True:
            question, packed, places = pickle.loads(connection.recv_bytes())
            if question is not None:
                function = pickle.loads(question)
            assert function is not None
            arrays = block.look(places) if block is not None else []
            connection.send_bytes(_answer(function, packed, arrays))


def _answer(function: Callable[[Any], Any], packed: bytes, arrays: list[memoryview]) -> bytes:
    """Pickled answers, or the error that came in their place."""
    try:
        items = pickle.loads(packed, buffers=arrays)
        return _pickled(([function(item) for item in items], None))
    except Exception as error:
        return _pickled((None, (error, traceback.format_exc())))


def _pickled(content: object) -> bytes:
    return pickle.dumps(content, _PROTOCOL)


def _context() -> Any:
    """How processes are started: never as a copy of one that has threads."""
    return multiprocessing.get_context("forkserver" if _FORKED else "spawn")


@contextmanager
def _started() -> Iterator[None]:
    """Have what is started meanwhile ignore Ctrl-C from its first moment on."""
    try:
        previous = signal.signal(signal.SIGINT, signal.SIG_IGN)
    except ValueError:  # not the main thread
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)
