"""Progress of long work, as who does it tells it to whoever shows it."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""Called as progress(what, done, total) each time something of `what` is finished."""


def no_progress(what: str, done: int, total: int) -> None:
    """Progress that nobody looks at."""
