"""Units of length and up axes that files are written in."""

from __future__ import annotations

METRES_PER_UNIT: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}
UNITS = tuple(METRES_PER_UNIT)
# Axis of a file that points up.
AXES = ("x", "-x", "y", "-y", "z", "-z")


def unit_from_word(word: str) -> str | None:
    """ "m", "cm" or "mm" of a word like "metres"; None when it is no length unit we know."""
    w = word.strip().lower()
    if w in METRES_PER_UNIT:
        return w
    stem = w.removesuffix("s").replace("metre", "meter")
    return {"meter": "m", "centimeter": "cm", "millimeter": "mm"}.get(stem)
