"""The lock of an output folder: one command at a time works in it."""

from __future__ import annotations

import json
import os
import platform
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import IO, Any

from mocap.errors import MocapError
from mocap.io._files import writing
from mocap.portable import is_running, lock_file

LOCK_NAME = ".lock"


@contextmanager
def sole_use(folder: Path, command: str) -> Iterator[None]:
    """Keep a folder, which must be there, for this command.

    The lock goes with the process, however it ends; a file that such a process has left is taken over. On a file system
    without locks it is the process named in the file that counts.
    Raises MocapError that says who works in the folder.
    """
    path = folder / LOCK_NAME
    with writing(path):
        stream = _locked(path)
    with stream:
        with writing(path):
            stream.truncate(0)
            stream.write(json.dumps(_about_this_process(command)).encode())
        try:
            yield
        finally:
            # Removed before it is unlocked, so that nobody else's file is removed; Windows keeps open files.
            with suppress(OSError):
                path.unlink()


def _locked(path: Path) -> IO[bytes]:
    """The open lock file of this process."""
    while True:
        stream = path.open("a+b", buffering=0)
        is_locked = lock_file(stream)
        holder = _read(stream)
        if is_locked is False or (is_locked is None and _is_at_work(holder)):
            stream.close()
            raise _in_use(path, holder)
        # The one who held it may have removed the file between our opening and our locking it.
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(stream.fileno()), path.stat()):
                return stream
        stream.close()


def _about_this_process(command: str) -> dict[str, Any]:
    return {
        "pid": os.getpid(),
        "host": platform.node(),
        "since": datetime.now().isoformat(sep=" ", timespec="seconds"),
        "command": command or Path(sys.argv[0]).name,
    }


def _read(stream: IO[bytes]) -> dict[str, Any]:
    """What is written in a lock file; empty when it is new or nobody can read it."""
    try:
        stream.seek(0)
        about = json.load(stream)
    except (OSError, ValueError):
        return {}
    return about if isinstance(about, dict) else {}


def _is_at_work(holder: dict[str, Any]) -> bool:
    """Whether the process that wrote the file may still be there; of another machine nobody knows."""
    pid = holder.get("pid")
    if not isinstance(pid, int):
        return False
    return holder.get("host") != platform.node() or is_running(pid)


def _in_use(path: Path, holder: dict[str, Any]) -> MocapError:
    who = ""
    if holder:
        command, pid, host, since = (holder.get(key, "?") for key in ("command", "pid", "host", "since"))
        who = f": `{command}`, process {pid} on {host}, since {since}"
    return MocapError(
        f"another command is working in this folder{who}",
        path=path.parent,
        remedy="wait for it, or choose another folder with -o; if that process is gone for certain, remove "
        f"{path.name} there",
    )
