"""Every wrong pixel of a mask is counted once, as the kind that it is."""

from __future__ import annotations

import numpy as np

from eval.segmentation import KINDS, kinds


def test_each_kind_is_found() -> None:
    background = np.full((120, 160, 3), 100, dtype=np.float32)
    picture = np.full((120, 160, 3), 100, dtype=np.uint8)
    truth = np.zeros((120, 160), dtype=bool)
    truth[20:100, 60:90] = True
    mask = truth.copy()
    mask[30:40, 90:92] = True  # halo: two columns beside the person
    mask[30:40, 60] = False  # rim: his first column
    mask[50:60, 70:80] = False  # hole
    mask[95:105, 95:100] = True  # contact: dark, beside the feet
    picture[95:105, 95:100] = 60
    mask[30:36, 130:140] = True  # soft: dark, far off
    picture[30:36, 130:140] = 60
    mask[5:10, 5:10] = True  # stray: as bright as the background
    counts = dict(zip(("hit", *KINDS), kinds(mask, truth, picture, background).astype(int), strict=True))
    assert counts == {
        "hit": truth.sum() - 110,
        "halo": 20,
        "contact": 50,
        "soft": 60,
        "stray": 25,
        "rim": 10,
        "hole": 100,
    }
