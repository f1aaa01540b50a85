"""Lost and found limbs of DDMA-PF behind furniture, and what it gives the joints that are visible (CF 7.4, 7.5.2).

    python -m eval.ddma_lost_limbs [--scenes walk_counter] [--masks true,video] [--seeds 3]

Writes eval/results/ddma_lost_limbs.csv. Takes about 5 minutes on one idle core (the scene is synthesised once, about
two minutes). A limb unit is lost in truth when less than 0.3 of its bone lies in the hull, present above 0.7, and not
scored in between. The source shows pictures only; there are no published numbers.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eval.hull_clips import ROOT, HullClip, compare_filters, run_filter

RESULTS = ROOT / "eval" / "results" / "ddma_lost_limbs.csv"
FIELDS = (
    "scene",
    "masks",
    "filter",
    "seed",
    "frames",
    "f1",
    "precision",
    "recall",
    "n_lost",
    "n_said",
    "n_scored",
    "mean_mm",
    "visible_mm",
    "upper_mm",
    "body_evaluations",
)
FILTERS = ("apf", "shbm model2", "ddma published", "ddma own", "shbm-ddma published", "shbm-ddma own")
# Chains of landmarks of the units of the limb model `limbs`, in its order.
UNITS = (
    ("right_shoulder", "right_elbow", "right_wrist"),
    ("left_shoulder", "left_elbow", "left_wrist"),
    ("right_hip", "right_knee"),
    ("right_knee", "right_ankle"),
    ("left_hip", "left_knee"),
    ("left_knee", "left_ankle"),
)
_LOST, _PRESENT = 0.3, 0.7
_LEGS = ("knee", "ankle")


def shares_of(clip: HullClip) -> NDArray[np.float64]:
    """Share of every unit's true bones in the hull, (T, 6)."""
    from mocap.data import LANDMARKS
    from mocap.metrics import share_in_hull

    chains = [[LANDMARKS.index(name) for name in unit] for unit in UNITS]
    return np.array(
        [
            [share_in_hull(truth[chain], voxels, clip.grid) for chain in chains]
            for truth, voxels in zip(clip.truth, clip.voxels, strict=True)
        ]
    )


def said_lost(n_units: tuple[int, ...]) -> list[bool]:
    """What a filter says of the six units, from its numbers of units per limb."""
    from mocap.body import load_limbs

    return [
        unit >= n
        for limb, n in zip(load_limbs("limbs"), n_units, strict=True)
        for unit in range(len(limb.units))
    ]


def filters(clip: HullClip) -> dict[str, tuple[Callable[..., Any], Any]]:
    """Name -> step and settings; 2,200 particle evaluations, scouts on top."""
    from mocap.body import load_hierarchy, load_limbs
    from mocap.filters.apf import ApfSettings, apf_step
    from mocap.filters.ddma import DdmaSettings, ShbmDdmaSettings, ddma_step, shbm_ddma_step
    from mocap.filters.limb_settings import LimbSettings, own_data_limits
    from mocap.filters.shbm import ShbmSettings, shbm_step

    apf = ApfSettings(n_layers=4, n_particles=550, std=clip.std)
    shbm = ShbmSettings(std=clip.std, hierarchy=load_hierarchy("model2"))
    limbs = load_limbs("limbs")
    published = LimbSettings(limbs)
    own = own_data_limits(limbs)
    return {
        "apf": (apf_step, apf),
        "shbm model2": (shbm_step, shbm),
        "ddma published": (ddma_step, DdmaSettings(apf, published)),
        "ddma own": (ddma_step, DdmaSettings(apf, own)),
        "shbm-ddma published": (shbm_ddma_step, ShbmDdmaSettings(shbm, published)),
        "shbm-ddma own": (shbm_ddma_step, ShbmDdmaSettings(shbm, own)),
    }


def measure(clip: HullClip, scene: str, masks: str, name: str, seed: int) -> dict[str, Any]:
    """One filter over one clip with one seed."""
    from mocap.body import landmarks_of
    from mocap.data import LANDMARKS
    from mocap.filters.ddma import DdmaInfo
    from mocap.metrics import limb_scores, point_errors

    step, settings = filters(clip)[name]
    states, infos = run_filter(clip, step, settings, seed=seed)
    errors = point_errors(landmarks_of(clip.body, states), clip.truth)
    shares = shares_of(clip)
    # A landmark beyond a unit that is not present is not visible.
    visible = np.ones_like(errors, dtype=np.bool_)
    for k, unit in enumerate(UNITS):
        for landmark in unit[1:]:
            visible[:, LANDMARKS.index(landmark)] &= shares[:, k] > _PRESENT
    upper = [i for i, landmark in enumerate(LANDMARKS) if not landmark.endswith(_LEGS)]
    row: dict[str, Any] = {
        "scene": scene,
        "masks": masks,
        "filter": name,
        "seed": seed,
        "frames": len(states),
        "mean_mm": round(float(np.nanmean(errors)), 1),
        "visible_mm": round(float(np.nanmean(errors[visible])), 1),
        "upper_mm": round(float(np.nanmean(errors[:, upper])), 1),
        "body_evaluations": round(statistics.fmean(info.n_evaluations for info in infos)),
    }
    units = [info.n_units for info in infos if isinstance(info, DdmaInfo)]
    if units:
        said = np.array([said_lost(n) for n in units])
        scores = limb_scores(shares < _LOST, said, (shares < _LOST) | (shares > _PRESENT))
        for field in ("f1", "precision", "recall"):
            value = getattr(scores, field)
            row[field] = None if value is None else round(value, 3)
        row |= {"n_lost": scores.n_lost, "n_said": scores.n_said, "n_scored": scores.n_scored}
    return row


def _summary(own: Sequence[dict[str, Any]]) -> str:
    f1 = [r["f1"] for r in own if r.get("f1") is not None]
    return (
        f"F1 {statistics.fmean(f1) if f1 else float('nan'):.2f}, visible "
        f"{statistics.fmean(r['visible_mm'] for r in own):.1f} mm, upper body "
        f"{statistics.fmean(r['upper_mm'] for r in own):.1f} mm"
    )


def main() -> None:
    compare_filters(
        __doc__,
        scenes="walk_counter",
        n_frames=150,
        names=FILTERS,
        measure=measure,
        summary=_summary,
        path=RESULTS,
        fields=FIELDS,
    )


if __name__ == "__main__":
    main()
