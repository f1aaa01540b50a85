"""Stopped commands: whoever presses Ctrl-C reads what was kept and how to go on."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn

from mocap.portable import Stopped


@contextmanager
def how_to_go_on(words: Callable[[], str]) -> Iterator[None]:
    """A signal inside leaves with these words, which are made when they are needed."""
    try:
        yield
    except Stopped as stopped:
        leave(stopped, words())


def leave(stopped: Stopped, words: str) -> NoReturn:
    """End the program as a shell expects it of a signal, with a message."""
    sys.stderr.write(f"\nmocap: stopped by {stopped}. {words}\n")
    sys.exit(128 + stopped.number)
