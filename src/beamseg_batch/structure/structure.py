"""The beams known so far, kept in time order (report, sections 3.2.6 and 3.2.7)."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from beamseg_batch.config import RunConfig
from beamseg_batch.model import Candidate, Detections, Intersection, Segment
from beamseg_batch.structure.arrays import SegmentArrays
from beamseg_batch.structure.axis_kernels import end_to_axis
from beamseg_batch.structure.fates import Refusal, segments_as_candidates
from beamseg_batch.structure.fusion import fuse
from beamseg_batch.structure.intersections import intersections_of
from beamseg_batch.structure.similarity import projection_epsilon, similarity_by

__all__ = ["Structure"]


class Structure:
    """Segments of all scans so far, fused, and where they touch.

    Parameters
    ----------
    config : RunConfig
    """

    def __init__(self, config: RunConfig) -> None:
        self.config = config
        self._similarity = similarity_by(config.structure, config.filtering)
        self._segments: list[Segment] = []
        self._arrays = SegmentArrays()
        # Numbers of the scans in which each segment was seen: pieces of one beam may be
        # seen in the same scan, so their counts do not add up.
        self._seen_in: list[set[int]] = []
        self._scan = 0

    def __len__(self) -> int:
        return len(self._segments)

    def update(self, detections: Detections) -> None:
        """Take in the segments of one scan.

        Parameters
        ----------
        detections : Detections
            World frame.

        Notes
        -----
        Algorithm 1 of the report.
        """
        changed = {self._take_in(segment) for segment in detections.segments}
        self._merge(changed)
        self._scan += 1

    def segments(self) -> tuple[Segment, ...]:
        """Segments seen often and long enough, in order of first detection."""
        return tuple(segment for segment in self._segments if self._refusal(segment) is None)

    def intersections(self) -> tuple[Intersection, ...]:
        """Intersections of those segments as they now are (algorithm 2 of the report)."""
        return intersections_of(self.segments(), self.config.structure.intersections)

    def rejections(self) -> Counter[str]:
        """Segments that are left out of the result, by reason."""
        refusals = map(self._refusal, self._segments)
        return Counter(refusal.reason for refusal in refusals if refusal is not None)

    def candidates(self) -> tuple[Candidate, ...]:
        """All segments, and why some are left out of the result."""
        return segments_as_candidates(self._segments, list(map(self._refusal, self._segments)))

    def _refusal(self, segment: Segment) -> Refusal | None:
        """Why a segment is left out of the result, or None."""
        least, shortest = self.config.structure.min_scans, self.config.structure.min_length
        if segment.n_scans < least:
            return Refusal("too_few_scans", segment.n_scans, least)
        if segment.length < shortest:
            return Refusal("too_short", segment.length, shortest)
        return None

    def _take_in(self, new: Segment) -> int:
        """Fuse a segment with the most similar known one it overlaps, or add it."""
        for index in self._similar(new):
            fused = self._fused(self._segments[index], new)
            if fused is not None:
                self._seen_in[index].add(self._scan)
                self._replace(index, fused)
                return index
        self._segments.append(replace(new, points=np.empty((0, 3))))
        self._arrays.append(new)
        self._seen_in.append({self._scan})
        return len(self._segments) - 1

    def _replace(self, index: int, segment: Segment) -> None:
        self._segments[index] = replace(segment, n_scans=len(self._seen_in[index]))
        self._arrays.replace(index, segment)

    def _similar(self, new: Segment) -> list[int]:
        """Known segments similar to a new one, the most similar first."""
        scores = self._similarity.scores(new, self._arrays)
        close = (scores <= 1.0).nonzero()[0].tolist()
        return sorted(close, key=scores.__getitem__) if len(close) > 1 else close

    def _fused(self, known: Segment, new: Segment) -> Segment | None:
        """Fuse two similar segments, unless the result is no longer the known one.

        The report's direction comes from the new segment's ends alone. A short piece of
        a beam that crosses is near the known axis, and would turn it by any angle.
        """
        fused = fuse(known, new, self.config.structure)
        if fused is None:
            return None
        moved = end_to_axis(known.end_1, known.end_2, fused.anchor, fused.direction)
        diag_voxel = self.config.filtering.diag_voxel(known.radius)
        reach = projection_epsilon(known.radius, self.config.structure.thresholds, diag_voxel)
        return fused if moved <= reach else None

    def _merge(self, changed: set[int]) -> None:
        """Fuse known segments that have grown into the same beam."""
        waiting = sorted(changed)
        while waiting:
            index = waiting.pop(0)
            found = self._duplicate_of(index)
            if found is None:
                continue
            partner, fused = found
            keep, drop = sorted((index, partner))
            self._seen_in[keep] |= self._seen_in[drop]
            self._replace(keep, fused)
            del self._segments[drop], self._seen_in[drop]
            self._arrays.delete(drop)
            waiting = sorted({keep} | {i - (i > drop) for i in waiting if i != drop})

    def _duplicate_of(self, index: int) -> tuple[int, Segment] | None:
        """Find another known segment of the same beam, and what the two make.

        A short segment may be off at the far ends of a long one while both its own ends
        lie on it. So each is held against the other's axis, and the better fit fused.
        """
        segment = self._segments[index]
        scores = self._similarity.scores(segment, self._arrays)
        reverse = self._similarity.reverse_scores(segment, self._arrays)
        best = np.minimum(scores, reverse)
        close = (best <= 1.0).nonzero()[0].tolist()
        for other in sorted(close, key=best.__getitem__):
            if other == index:
                continue
            pair = (self._segments[other], segment)
            fused = self._fused(*(pair if scores[other] <= reverse[other] else pair[::-1]))
            if fused is not None:
                return other, fused
        return None
