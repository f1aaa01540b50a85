"""Open3D, which is an extra: what only it does says so when it is missing."""

from __future__ import annotations

from typing import Any

from mocap.errors import MissingExtra


def require_open3d(what: str) -> Any:
    """The package.  what : cannot be done without it.

    Raises MissingExtra when it is not installed, or when the system lacks a library that it loads.
    """
    try:
        import open3d
    except ImportError as error:
        is_there = not isinstance(error, ModuleNotFoundError)
        why = f"cannot be loaded ({error})" if is_there else "is not installed"
        libraries = "install the system's libusb-1.0-0, libgl1 and libx11-6" if is_there else ""
        raise MissingExtra(f"{what} needs Open3D, which {why}", "open3d", otherwise=libraries) from error
    return open3d
