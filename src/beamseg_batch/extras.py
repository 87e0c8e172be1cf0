"""Libraries that not every installation has, loaded where they are needed."""

from __future__ import annotations

import importlib
from typing import Any

from beamseg_batch.errors import BeamsegError, MissingExtraError

__all__ = ["Open3DMissingError", "load_extra", "load_open3d"]


class Open3DMissingError(BeamsegError, ImportError):
    """Open3D, or a system library that it needs, cannot be loaded."""

    exit_code = 2


def load_extra(module: str, purpose: str, extra: str = "export") -> Any:
    """Load a library of an optional extra.

    Parameters
    ----------
    module : str
        Its name, as it is imported.
    purpose : str
        What needs it, for the error: ``a .dxf file``.
    extra : str

    Returns
    -------
    module

    Raises
    ------
    MissingExtraError
        If it cannot be loaded; the message says what to install.
    """
    try:
        return importlib.import_module(module)
    except (ImportError, OSError) as error:  # OSError: a system library is missing
        library = module.partition(".")[0]
        raise MissingExtraError(
            f"{purpose} needs the library {library}, which cannot be loaded "
            f"({' '.join(str(error).split())}); pip install 'beamseg-batch[{extra}]'"
        ) from error


def load_open3d(purpose: str) -> Any:
    """Load Open3D.

    Parameters
    ----------
    purpose : str
        What needs it, for the error: ``a world with meshes``.

    Returns
    -------
    module

    Raises
    ------
    Open3DMissingError
        If it cannot be loaded; the message says what to install.
    """
    try:
        return importlib.import_module("open3d")
    except (ImportError, OSError) as error:  # OSError: a system library is missing
        raise Open3DMissingError(
            f"{purpose} needs Open3D, which cannot be loaded ({' '.join(str(error).split())}); on "
            "Debian and Ubuntu: apt-get install libegl1 libgl1 libgomp1 libusb-1.0-0 libx11-6; "
            "elsewhere: pip install open3d"
        ) from error
