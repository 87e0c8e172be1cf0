"""The beams known so far, kept in time order (report, sections 3.2.6 and 3.2.7)."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import replace

import numpy as np

from beamseg_batch.config import RunConfig
from beamseg_batch.geometry import FloatArray
from beamseg_batch.model import Detections, Intersection, Segment
from beamseg_batch.structure.arrays import SegmentArrays
from beamseg_batch.structure.fusion import fuse
from beamseg_batch.structure.intersections import intersections_of
from beamseg_batch.structure.similarity import similarity_by

__all__ = ["Structure"]


class Structure:
    """Segments of all scans so far, fused, and their intersections.

    Parameters
    ----------
    config : RunConfig
    """

    def __init__(self, config: RunConfig) -> None:
        self.config = config
        self._scores = similarity_by(config.structure, config.filtering)
        self._segments: list[Segment] = []
        self._arrays = SegmentArrays()
        self._intersections: dict[tuple[int, int], Intersection] = {}

    def __len__(self) -> int:
        return len(self._segments)

    def update(self, detections: Detections) -> dict[str, float]:
        """Take in the segments of one scan.

        Parameters
        ----------
        detections : Detections
            World frame.

        Returns
        -------
        dict of str to float
            Microseconds spent on the stages ``fuse`` and ``intersect``.

        Notes
        -----
        Algorithms 1 and 2 of the report.
        """
        start = time.perf_counter()
        changed: set[int] = set()
        for segment in detections.segments:
            changed.add(self._take_in(segment))
        changed = self._merge(changed)
        fused = time.perf_counter()
        self._update_intersections(changed)
        done = time.perf_counter()
        return {"fuse": (fused - start) * 1e6, "intersect": (done - fused) * 1e6}

    def segments(self) -> tuple[Segment, ...]:
        """Segments seen often and long enough, in order of first detection."""
        return tuple(self._segments[i] for i in self._accepted())

    def intersections(self) -> tuple[Intersection, ...]:
        """Intersections between those segments, with their numbers in that order."""
        number = {index: position for position, index in enumerate(self._accepted())}
        return tuple(
            replace(found, segment_1=number[pair[0]], segment_2=number[pair[1]])
            for pair, found in sorted(self._intersections.items())
            if pair[0] in number and pair[1] in number
        )

    def rejections(self) -> Counter[str]:
        """Segments that are left out of the result, by reason."""
        limits = self.config.structure
        counts: Counter[str] = Counter()
        for segment in self._segments:
            if segment.n_scans < limits.min_scans:
                counts["too_few_scans"] += 1
            elif segment.length < limits.min_length:
                counts["too_short"] += 1
        return counts

    def _accepted(self) -> list[int]:
        limits = self.config.structure
        return [
            index
            for index, segment in enumerate(self._segments)
            if segment.n_scans >= limits.min_scans and segment.length >= limits.min_length
        ]

    def _take_in(self, new: Segment) -> int:
        """Fuse a segment with the most similar known one it overlaps, or add it."""
        for index in self._similar(new):
            fused = fuse(self._segments[index], new, self.config.structure)
            if fused is not None:
                self._replace(index, fused)
                return index
        self._segments.append(replace(new, points=np.empty((0, 3))))
        self._arrays.append(new)
        return len(self._segments) - 1

    def _replace(self, index: int, segment: Segment) -> None:
        self._segments[index] = segment
        self._arrays.replace(index, segment)

    def _similar(self, new: Segment) -> list[int]:
        """Known segments similar to a new one, the most similar first."""
        if not self._segments:
            return []
        scores: FloatArray = self._scores(new, self._arrays)
        close = np.flatnonzero(scores <= 1.0)
        return [int(i) for i in close[np.argsort(scores[close], kind="stable")]]

    def _merge(self, changed: set[int]) -> set[int]:
        """Fuse known segments that have grown into the same beam."""
        waiting = sorted(changed)
        while waiting:
            index = waiting.pop(0)
            partner = self._duplicate_of(index)
            if partner is None:
                continue
            keep, drop = sorted((index, partner))
            fused = self._fused_pair(keep, drop)
            assert fused is not None
            self._replace(keep, fused)
            changed = self._drop(drop, changed) | {keep}
            waiting = sorted(changed)
        return changed

    def _duplicate_of(self, index: int) -> int | None:
        segment = self._segments[index]
        for other in self._similar(segment):
            if other != index and self._fused_pair(index, other) is not None:
                return other
        return None

    def _fused_pair(self, first: int, second: int) -> Segment | None:
        """Fuse two known segments, the one with fewer points into the other."""
        pair = sorted((first, second), key=lambda i: (-self._segments[i].n_points, i))
        known, new = (self._segments[i] for i in pair)
        return fuse(known, new, self.config.structure)

    def _drop(self, index: int, changed: set[int]) -> set[int]:
        """Remove a segment; later ones move down by one, here and in `changed`."""
        del self._segments[index]
        self._arrays.delete(index)

        def moved(i: int) -> int:
            return i - (i > index)

        self._intersections = {
            (moved(i), moved(j)): replace(found, segment_1=moved(i), segment_2=moved(j))
            for (i, j), found in self._intersections.items()
            if index not in (i, j)
        }
        return {moved(i) for i in changed if i != index}

    def _update_intersections(self, changed: set[int]) -> None:
        """Find the changed segments' intersections anew; those that ended are gone."""
        if not changed:
            return
        self._intersections = {
            pair: found for pair, found in self._intersections.items() if changed.isdisjoint(pair)
        }
        limits = self.config.structure.intersections
        for index in sorted(changed):
            for found in intersections_of(index, self._segments, self._arrays, limits):
                self._intersections[found.segment_1, found.segment_2] = found
