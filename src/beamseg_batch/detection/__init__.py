"""A scan -> its segments: filtering, iterative Hough transform, screening."""

from beamseg_batch.detection.detector import Detector
from beamseg_batch.detection.hough import HoughLine, iterative_hough

__all__ = ["Detector", "HoughLine", "iterative_hough"]
