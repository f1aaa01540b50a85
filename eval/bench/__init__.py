"""Speed measures with a committed baseline: `python -m eval.bench`."""

from eval.bench.registry import Measure, measure

__all__ = ["Measure", "measure"]
