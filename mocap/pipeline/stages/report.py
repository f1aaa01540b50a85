"""What every stage shares: its report and its progress."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class StageReport:
    """What a stage has to say: warnings for the user and numbers for run.json."""

    warnings: tuple[str, ...] = ()
    numbers: dict[str, Any] | None = None
