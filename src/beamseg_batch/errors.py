"""The exceptions that `beamseg_batch` raises on purpose.

Every one of them derives from `BeamsegError` and carries the exit code that the
command line ends with: 2 for usage and configuration, 1 for data that cannot be
processed. Messages say what, where, the value, the limit and the way out.
"""

from __future__ import annotations

__all__ = [
    "AmbiguousTopicError",
    "BeamsegError",
    "ConfigError",
    "DuplicateRecordingError",
    "MissingExtraError",
    "NoScansError",
    "OutputError",
    "PoseFileError",
    "RecordingError",
    "RecordingNotFoundError",
    "RunError",
    "ShapeError",
    "TopicError",
    "TruthError",
    "WorkerError",
    "WorldError",
]


class BeamsegError(Exception):
    """Root of the errors a user can cause and cure."""

    exit_code = 1

    @property
    def problems(self) -> tuple[str, ...]:
        """What is wrong: a sentence for each problem."""
        return (str(self),)


class ShapeError(BeamsegError, ValueError):
    """An array has not the shape that the function documents."""


class ConfigError(BeamsegError, ValueError):
    """A configuration value, key or file is not valid."""

    exit_code = 2


class MissingExtraError(BeamsegError, ImportError):
    """A library is needed that is not installed by default."""

    exit_code = 2


class RecordingError(BeamsegError, OSError):
    """A recording cannot be read."""


class DuplicateRecordingError(RecordingError):
    """A recording was named more than once."""

    exit_code = 2


class RecordingNotFoundError(RecordingError):
    """The path of a recording does not exist."""

    exit_code = 2


class TopicError(RecordingError):
    """A recording holds no topic of the kind that is needed."""


class AmbiguousTopicError(TopicError):
    """Several topics would fit and none was named."""

    exit_code = 2


class PoseFileError(RecordingError):
    """A file of poses beside a recording cannot be read."""

    exit_code = 2


class NoScansError(RecordingError):
    """A recording was read, but no scan of it could be used."""


class OutputError(BeamsegError, OSError):
    """The output folder cannot be used or written."""

    exit_code = 2


class RunError(BeamsegError, ValueError):
    """A finished run cannot be read back from its folder."""


class WorkerError(BeamsegError, RuntimeError):
    """A worker process ended, or could not be started."""


class WorldError(BeamsegError, ValueError):
    """A description of a world, of a flight in it or of a sensor is not valid.

    Parameters
    ----------
    *problems : str
        ``FILE:LINE: KEY: what it must be, not VALUE``; all that were found.
    """

    exit_code = 2

    def __init__(self, *problems: str) -> None:
        super().__init__(*problems)

    def __str__(self) -> str:
        return "\n".join(self.problems)

    @property
    def problems(self) -> tuple[str, ...]:
        """What is wrong: a sentence for each problem."""
        return self.args


class TruthError(BeamsegError, ValueError):
    """A truth cannot be read, or is none."""
