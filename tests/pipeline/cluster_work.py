"""What the jobs of the tests do; a module of its own, because workers import it by name."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

from mocap.errors import MocapError


def work(parameters: dict[str, Any]) -> dict[str, Any]:
    """Leaves a trace of every call, then does what `kind` says."""
    if "trace" in parameters:
        with Path(parameters["trace"]).open("a", encoding="utf-8") as stream:
            stream.write(f"{parameters['number']}\n")
    kind = parameters.get("kind", "square")
    if kind == "mistake":
        raise MocapError("the camera is upside down", camera="left", remedy="turn it")
    if kind == "bug":
        raise ZeroDivisionError("by chance")
    if kind == "death":
        os._exit(3)
    if kind == "nan":
        return {"value": float("nan")}
    time.sleep(parameters.get("sleep_s", 0.0))
    return {"value": parameters["number"] ** 2}
