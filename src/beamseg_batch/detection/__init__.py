"""A scan -> its segments: filtering, iterative Hough transform, screening."""

from beamseg_batch.detection.detector import Detector, Refusals
from beamseg_batch.detection.hough import HoughLine, iterative_hough
from beamseg_batch.detection.outliers import check_outlier_filter
from beamseg_batch.noise import DEFAULT_NOISE, depth_noise

__all__ = [
    "DEFAULT_NOISE",
    "Detector",
    "HoughLine",
    "Refusals",
    "check_outlier_filter",
    "depth_noise",
    "iterative_hough",
]
