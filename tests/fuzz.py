"""Damaged recordings through the commands: nothing may crash, hang or eat the memory.

``python -m tests.fuzz --seed 1 --info 2000 --run 200``, which ``make fuzz`` calls, says how
many recordings were read how, and fails with the seed of the first that breaks a promise.
"""

from __future__ import annotations

import argparse
import gc
import resource
import signal
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from click.testing import CliRunner, Result

from beamseg_batch.cli.main import beamseg
from beamseg_batch.recording.container_mcap import MCAP_MAGIC, McapFormat
from beamseg_batch.recording.container_rosbag import RosbagFormat
from beamseg_batch.recording.records import BufferSource, Record, follow
from tests.recordings import START_NS, write_recording

KINDS = ("bag", "bag-bz2", "bag-lz4", "mcap", "mcap-ros1", "mcap-cdr", "db3")
MOST_SECONDS = 10
MOST_BYTES = 1 << 30
MS = 1_000_000
_SQLITE_PAGE = 4096

Mutation = Callable[[np.random.Generator, bytearray], None]


class BrokenPromiseError(AssertionError):
    """A command did with a recording what it must never do."""


def sample(folder: Path, kind: str, n_clouds: int = 12) -> Path:
    """Write a short flight past one beam."""
    generator = np.random.default_rng(3)
    clouds = []
    for k in range(n_clouds):
        points = generator.uniform((0.9, -0.02, -0.6), (0.95, 0.02, 0.6), (150, 3))
        clouds.append((START_NS + k * 100 * MS, points.astype(np.float32)))
    poses = [
        (START_NS + k * 10 * MS, (0.0, 0.001 * k, 2.0), (0.0, 0.0, 0.0, 1.0))
        for k in range(10 * n_clouds)
    ]
    return write_recording(folder, kind, clouds, poses)


def mutated(content: bytes, seed: int) -> bytes:
    """Damage a file, the same way for the same seed."""
    generator = np.random.default_rng(seed)
    data = bytearray(content)
    for _ in range(int(generator.integers(1, 4))):
        if len(data) > 16:
            _MUTATIONS[int(generator.integers(len(_MUTATIONS)))](generator, data)
    return bytes(data)


def _flip(generator: np.random.Generator, data: bytearray) -> None:
    for position in generator.integers(len(data), size=int(generator.integers(1, 20))):
        data[position] ^= 1 << int(generator.integers(8))


def _cut(generator: np.random.Generator, data: bytearray) -> None:
    del data[int(generator.integers(len(data))) :]


def _remove(generator: np.random.Generator, data: bytearray) -> None:
    start = int(generator.integers(len(data)))
    del data[start : start + int(generator.integers(1, 5000))]


def _zero(generator: np.random.Generator, data: bytearray) -> None:
    start = int(generator.integers(len(data)))
    size = min(int(generator.integers(1, 5000)), len(data) - start)
    data[start : start + size] = bytes(size)


def _swap(generator: np.random.Generator, data: bytearray) -> None:
    """Swap two records, or two pages of a database."""
    spans = _spans(bytes(data))
    if len(spans) < 2:
        return
    (a, b), (c, d) = sorted(spans[k] for k in generator.choice(len(spans), 2, replace=False))
    if b <= c:
        data[a:d] = data[c:d] + data[b:c] + data[a:b]


def _lie(generator: np.random.Generator, data: bytearray) -> None:
    """Change a length in the first bytes of a record."""
    spans = _spans(bytes(data))
    if not spans:
        return
    start = spans[int(generator.integers(len(spans)))][0] + int(generator.integers(0, 60))
    width = int(generator.choice((1, 4, 8)))
    values = (0, 1, 255, 1 << 31, (1 << 32) - 1, 10 << 30, (1 << 63) - 1, (1 << 64) - 1)
    value = values[int(generator.integers(len(values)))] & ((1 << 8 * width) - 1)
    if start + width <= len(data):
        data[start : start + width] = value.to_bytes(width, "little")


_MUTATIONS: tuple[Mutation, ...] = (_flip, _cut, _remove, _zero, _swap, _lie)


def _spans(content: bytes) -> list[tuple[int, int]]:
    """Where the records of a file lie."""
    if content.startswith(b"SQLite"):
        return [(k, k + _SQLITE_PAGE) for k in range(0, len(content), _SQLITE_PAGE)]
    if content.startswith(MCAP_MAGIC):
        records = follow(McapFormat(), BufferSource(content), len(MCAP_MAGIC))
    else:
        records = follow(RosbagFormat(), BufferSource(content), 13)
    return [(r.offset, r.end) for r in records if isinstance(r, Record) and r.end <= len(content)]


@contextmanager
def _watched() -> Iterator[None]:
    """Raise when it takes too long or too much memory."""

    def too_long(*_: Any) -> None:
        raise BrokenPromiseError(f"takes longer than {MOST_SECONDS} s")

    before = signal.signal(signal.SIGALRM, too_long)
    signal.alarm(MOST_SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    peak = peak_memory()
    if peak > MOST_BYTES:
        raise BrokenPromiseError(f"peak memory is {peak >> 20} MB")


def peak_memory() -> int:
    """Return the most memory that this program has held [bytes].

    ``ru_maxrss`` of a child starts at what its parent held when it made it; what the kernel
    keeps per address space does not.
    """
    status = Path("/proc/self/status")
    if not status.exists():  # not Linux
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1]) * 1024


def invoke(folder: Path, kind: str, content: bytes, command: str) -> Result:
    """Put a recording through a command."""
    path = folder / f"flight.{kind.partition('-')[0]}"
    path.write_bytes(content)
    arguments = [command, str(path)]
    if command == "run":
        arguments += ["-o", str(folder / "out"), "--overwrite", "-q"]
        arguments += ["--set", "outputs.report=false"]
    return CliRunner().invoke(beamseg, arguments)


def try_one(folder: Path, kind: str, content: bytes, seed: int, command: str) -> int:
    """Put one damaged recording through a command.

    Returns
    -------
    int
        The exit code: 0, 1 or 2.

    Raises
    ------
    BrokenPromiseError
    """
    damaged = mutated(content, seed)
    try:
        with _watched():
            result = invoke(folder, kind, damaged, command)
    except BrokenPromiseError as error:
        raise BrokenPromiseError(f"{kind}, seed {seed}, {command}: {error}") from error
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        text = "".join(traceback.format_exception(result.exception))
        raise BrokenPromiseError(f"{kind}, seed {seed}, {command}: {text}")
    if result.exit_code not in (0, 1, 2) or "Traceback" in result.output:
        raise BrokenPromiseError(f"{kind}, seed {seed}, {command}: {result.output}")
    return result.exit_code


def fuzz(folder: Path, command: str, count: int, seed: int) -> Counter[tuple[str, int]]:
    """Put many damaged recordings, of each kind in turn, through a command.

    Returns
    -------
    Counter of (kind, exit code)
    """
    contents = {kind: sample(folder / f"whole-{kind}", kind).read_bytes() for kind in KINDS}
    codes: Counter[tuple[str, int]] = Counter()
    # Whole, and not watched: kernels may have to be compiled.
    invoke(folder, KINDS[0], contents[KINDS[0]], command)
    for number in range(count):
        kind = KINDS[number % len(KINDS)]
        code = try_one(folder, kind, contents[kind], seed * 1_000_003 + number, command)
        codes[kind, code] += 1
        if number % 50 == 0:  # a command leaves its objects to the end of its process
            gc.unfreeze()
            gc.collect()
    return codes


def main() -> int:
    """Run it as a program."""
    parser = argparse.ArgumentParser(description="Damaged recordings through the commands")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--info", type=int, default=2000, help="recordings through info")
    parser.add_argument("--run", type=int, default=200, help="recordings through run")
    asked = parser.parse_args()
    for command, count in (("info", asked.info), ("run", asked.run)):
        if not count:
            continue
        with tempfile.TemporaryDirectory() as folder:
            codes = fuzz(Path(folder), command, count, asked.seed)
        for (kind, code), number in sorted(codes.items()):
            sys.stdout.write(f"{command:5} {kind:10} exit {code}: {number}\n")
    peak = peak_memory() >> 20
    sys.stdout.write(f"no promise broken with seed {asked.seed}; peak memory {peak} MB\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
