"""Measures by name. A new one is a decorated function in any eval/bench/measures_*.py:

@measure("carve_ms", unit="ms", better="lower")
def carve_ms() -> float: ...

It returns its value, or a Skip with the reason why there is none on this machine.
"""

from __future__ import annotations

import importlib
import pkgutil
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase


@dataclass(frozen=True)
class Skip:
    """Why a measure has no value here, for example because a competitor is not installed."""

    reason: str


@dataclass(frozen=True)
class Measure:
    """name, unit, better ('higher' or 'lower'), the function that takes the measurement, and how much it may worsen.

    tolerance : a value that is worse than the baseline's by more than this share fails the gate.
    """

    name: str
    unit: str
    better: str
    run: Callable[[], float | Skip]
    tolerance: float

    def worsening(self, value: float, baseline: float) -> float:
        """By what factor a value is worse than the baseline's; below 1 it is better."""
        if value <= 0 or baseline <= 0:
            return float("inf")
        return baseline / value if self.better == "higher" else value / baseline

    def passes(self, value: float, baseline: float) -> bool:
        """Whether a value is within the tolerance of the baseline's."""
        return self.worsening(value, baseline) <= 1.0 + self.tolerance


# Ratios to a competitor in the same run, shares and memory hardly depend on the machine; times and rates do.
_STEADY_UNITS = ("x", "share", "MB")
_STEADY_TOLERANCE, _TIME_TOLERANCE = 0.4, 1.0


_MEASURES: dict[str, Measure] = {}


def measure(
    name: str, *, unit: str, better: str, tolerance: float | None = None
) -> Callable[[Callable[[], float | Skip]], Callable[[], float | Skip]]:
    """Register the decorated function; ValueError for a doubled name or an unknown direction.

    tolerance : None = 0.4 for ratios, shares and memory, 1 for times and rates, which depend on the machine.
    """
    if better not in ("higher", "lower"):
        raise ValueError(f"better: expected 'higher' or 'lower', got {better!r}")

    def register(function: Callable[[], float | Skip]) -> Callable[[], float | Skip]:
        if name in _MEASURES:
            raise ValueError(f"measure {name!r} is registered twice")
        usual = _STEADY_TOLERANCE if unit in _STEADY_UNITS else _TIME_TOLERANCE
        _MEASURES[name] = Measure(name, unit, better, function, usual if tolerance is None else tolerance)
        return function

    return register


def load_measures() -> tuple[Measure, ...]:
    """All measures of the modules eval.bench.measures_*, by name."""
    import eval.bench

    for module in sorted(m.name for m in pkgutil.iter_modules(eval.bench.__path__)):
        if module.startswith("measures_"):
            importlib.import_module(f"eval.bench.{module}")
    return tuple(_MEASURES[name] for name in sorted(_MEASURES))


def select(measures: Sequence[Measure], pattern: str | None) -> tuple[Measure, ...]:
    """Measures whose name contains the pattern or matches it as a shell wildcard; all for None."""
    if pattern is None:
        return tuple(measures)
    return tuple(m for m in measures if pattern in m.name or fnmatchcase(m.name, pattern))


def interleaved_medians(functions: Sequence[Callable[[], object]], n_rounds: int) -> list[float]:
    """Median wall time (s) of each function, called in turn so that a busy machine hits all alike.

    Each function is called once before, unmeasured, so that nothing is compiled or paged in while measured.
    """
    for function in functions:
        function()
    times: list[list[float]] = [[] for _ in functions]
    for _ in range(n_rounds):
        for function, own in zip(functions, times, strict=True):
            start = time.perf_counter()
            function()
            own.append(time.perf_counter() - start)
    return [statistics.median(own) for own in times]
