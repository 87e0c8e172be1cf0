"""Scans kept from one reading of a flight to the next, where they are few enough."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from beamseg_batch.model import Scan, SkippedScan

__all__ = ["KeptScans"]

_MOST_BYTES = 32 * 2**20


class KeptScans:
    """Scans of a reading that went to its end, so that the next need not decode them again.

    More points than 32 MB are not kept: memory must not grow with the flight.
    """

    def __init__(self) -> None:
        self._scans: list[Scan | SkippedScan] | None = None

    def reading(self, scans: Iterable[Scan | SkippedScan]) -> Iterator[Scan | SkippedScan]:
        """Give what was kept, else what is read.

        Parameters
        ----------
        scans : iterable of Scan or SkippedScan
            Not begun where all was kept.

        Yields
        ------
        Scan or SkippedScan
        """
        if self._scans is not None:
            yield from self._scans
            return
        kept: list[Scan | SkippedScan] = []
        room = _MOST_BYTES
        for scan in scans:
            room -= scan.points.nbytes if isinstance(scan, Scan) else 0
            kept.append(scan)
            if room < 0:
                kept.clear()
            yield scan
        if room >= 0:
            self._scans = kept
