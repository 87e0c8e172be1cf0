"""A scan -> its segments: filtering, iterative Hough transform, screening."""

from beamseg_batch.detection.detector import Detector
from beamseg_batch.detection.hough import HoughLine, iterative_hough
from beamseg_batch.detection.noise import depth_noise

__all__ = ["Detector", "HoughLine", "depth_noise", "iterative_hough"]
