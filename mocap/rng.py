"""Random generators by address, so that frame 17 of person 3 draws the same numbers alone, resumed or in parallel."""

from __future__ import annotations

import zlib

import numpy as np


def rng_for(seed: int, stage: str, person: int = 0, frame: int = 0) -> np.random.Generator:
    """The generator of one stage, person and frame.  seed, person, frame >= 0."""
    key = (zlib.crc32(stage.encode()), person, frame)
    return np.random.default_rng(np.random.SeedSequence(entropy=seed, spawn_key=key))
