"""Errors that a user can mend: what went wrong, where, and what to do about it."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path

DISTRIBUTION = "mocap-volumes"
"""Name of the project on a package index; `mocap` is another project there. The import name is mocap."""


class MocapError(Exception):
    """A user's mistake or a bad file: one clear message with file, camera, frame and remedy.

    The command line prints `str(error)` and exits with code 2; library users may read the parts.
    """

    def __init__(
        self,
        message: str,
        *,
        remedy: str = "",
        path: Path | str | None = None,
        camera: str | None = None,
        frame: int | None = None,
    ) -> None:
        self.message = message
        self.remedy = remedy
        self.path = None if path is None else Path(path)
        self.camera = camera
        self.frame = frame
        super().__init__(str(self))

    def __str__(self) -> str:
        where = []
        if self.path is not None:
            where.append(f"file {self.path}")
        if self.camera is not None:
            where.append(f"camera {self.camera}")
        if self.frame is not None:
            where.append(f"frame {self.frame}")
        text = self.message.rstrip(".")
        if where:
            text += f" ({', '.join(where)})"
        text += "" if text.endswith("?") else "."
        if self.remedy:
            text += f" Remedy: {self.remedy.rstrip('.')}."
        return text


def install_command(extra: str = "") -> str:
    """What installs an extra, or everything that the package cannot do without in its newest version."""
    return f'pip install "{DISTRIBUTION}[{extra}]"' if extra else f"pip install --upgrade {DISTRIBUTION}"


class MissingExtra(MocapError):
    """An optional package is not installed.

    message : what cannot be done.  extra : key of `[project.optional-dependencies]` that brings the package.
    otherwise : what can be done without it, after "or".
    """

    def __init__(
        self, message: str, extra: str, *, otherwise: str = "", path: Path | str | None = None
    ) -> None:
        remedy = install_command(extra)
        super().__init__(message, remedy=f"{remedy}, or {otherwise}" if otherwise else remedy, path=path)


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """`; did you mean 'fps'?` with the known word nearest to an unknown one; empty when none is near."""
    nearest = get_close_matches(word, list(known), n=1)
    return f"; did you mean {nearest[0]!r}?" if nearest else ""
