"""What separates the marker filter's accuracy from the published one (CF Table 6.3): one condition at a time, then
those together that help.

The printed cost, 3 layers of 700 particles, on the five actions of eval.markers_table_6_3. The source differs from that
table in what its text says (markers in the joints: they are the projected ground truth; a known body) and in what it
leaves open (rho, the size of the person in the pictures, hence how dense false detections lie, how much the body hides,
how far persons move from frame to frame). Conditions change one of these against `table` or against `source`, which has
the joints and the known body; the last ones change two or three together.

    python -m eval.markers_conditions [--frames 45] [--seeds 1] [--only walk,jog] [--conditions NAME ...]

Writes eval/results/markers_conditions.csv. About 20 minutes on one core. Lines of actions and conditions that were not
asked for stay as an earlier call wrote them.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eval.decomposition.tables import read_csv
from eval.markers_table_6_3 import (
    PUBLISHED,
    PUBLISHED_AVERAGE,
    ROOT,
    TABLE_DETECTOR,
    TABLE_FILTER,
    Clip,
    Detector,
    Filter,
    make_clip,
    prepare,
    run_cell,
)
from eval.whole import write_csv
from mocap.body import Body
from mocap.body.markers import Markers
from mocap.data import LANDMARKS, CameraRig
from mocap.likelihood.markers import marker_views
from mocap.pose.marker_person import Prepared

RESULTS = ROOT / "eval" / "results" / "markers_conditions.csv"
PERFECT = Detector(1.0, 0, 0)
_JOINT_SLACK_M = 0.01  # as of a marker of a set that says nothing


@dataclass(frozen=True)
class Condition:
    """One world.

    in_joints : markers are the landmarks.  knows_body : lengths, offsets and first pose come from detections without
    noise, misses and false ones.  gate_px : rho.  magnification : of the pictures, with all that is in them but the
    detector's noise in px.  noise_scale : of the filter's own noise ("half the maximum expected movement").
    hides : the body hides markers.  times_fps : frames in the same seconds, against the 30 frames/s of the scenes: how
    far the person moves, and how far the filter expects it to, from frame to frame.
    """

    in_joints: bool = False
    knows_body: bool = False
    gate_px: float = 20.0
    detector: Detector = TABLE_DETECTOR
    magnification: float = 1.0
    noise_scale: float = 1.0
    hides: bool = True
    times_fps: int = 1
    filter: Filter = TABLE_FILTER


SOURCE = Condition(in_joints=True, knows_body=True)
_OPEN, _FINE = replace(SOURCE, hides=False), replace(SOURCE, times_fps=2)
_EXACT, _FOUND = replace(TABLE_DETECTOR, variance=0), replace(TABLE_DETECTOR, rate=1.0)
_MANY, _BOTH = replace(TABLE_FILTER, n_particles=3000), replace(TABLE_FILTER, cost="both")
CONDITIONS = {
    "table": Condition(),
    "table, markers in the joints": Condition(in_joints=True),
    "table, known body": Condition(knows_body=True),
    "source": SOURCE,
    **{f"source, rho {rho} px": replace(SOURCE, gate_px=float(rho)) for rho in (5, 10, 40)},
    "source, no false detections": replace(SOURCE, detector=replace(TABLE_DETECTOR, false_positives=0)),
    "source, 5 false detections": replace(SOURCE, detector=replace(TABLE_DETECTOR, false_positives=5)),
    "source, no noise": replace(SOURCE, detector=_EXACT),
    "source, every marker found": replace(SOURCE, detector=_FOUND),
    "source, perfect detector": replace(SOURCE, detector=PERFECT),
    "source, perfect detector, rho 10 px": replace(SOURCE, detector=PERFECT, gate_px=10.0),
    "source, pictures x 2": replace(SOURCE, magnification=2.0),
    "source, pictures x 3": replace(SOURCE, magnification=3.0),
    **{f"source, filter's noise x {k}": replace(SOURCE, noise_scale=float(k)) for k in (0.25, 0.5, 2, 3)},
    "source, reprojection term": replace(SOURCE, filter=replace(TABLE_FILTER, cost="reprojection")),
    "source, both terms": replace(SOURCE, filter=_BOTH),
    "source, nothing hidden": _OPEN,
    "source, 60 frames/s": _FINE,
    "source, nothing hidden, every marker found": replace(_OPEN, detector=_FOUND),
    "source, 60 frames/s, rho 40 px": replace(_FINE, gate_px=40.0),
    "source, 60 frames/s, no noise": replace(_FINE, detector=_EXACT),
    "source, 60 frames/s, every marker found": replace(_FINE, detector=_FOUND),
    "source, 60 frames/s, nothing hidden": replace(_FINE, hides=False),
    "source, 60 frames/s, nothing hidden, rho 40 px": replace(_FINE, hides=False, gate_px=40.0),
    "source, 60 frames/s, nothing hidden, every marker found": replace(_FINE, hides=False, detector=_FOUND),
    "source, 60 frames/s, nothing hidden, rho 10 px": replace(_FINE, hides=False, gate_px=10.0),
    "source, 60 frames/s, nothing hidden, pictures x 2": replace(_FINE, hides=False, magnification=2.0),
    "source, 60 frames/s, nothing hidden, filter's noise x 1.5": replace(_FINE, hides=False, noise_scale=1.5),
    "source, 60 frames/s, nothing hidden, 3 x 3000 particles": replace(_FINE, hides=False, filter=_MANY),
    "source, 60 frames/s, nothing hidden, both terms": replace(_FINE, hides=False, filter=_BOTH),
    "source, 60 frames/s, nothing hidden, both terms, every marker found": replace(
        _FINE, hides=False, filter=_BOTH, detector=_FOUND
    ),
    "source, 120 frames/s, nothing hidden": replace(SOURCE, hides=False, times_fps=4),
}


def joint_markers(body: Body) -> Markers:
    """Markers in the landmarks of a body."""
    return Markers(
        names=LANDMARKS,
        joint=body.landmark_joint,
        part=body.landmark_parts,
        offset=body.landmark_offset,
        slack_m=np.full(len(LANDMARKS), _JOINT_SLACK_M),
    )


def magnified(clip: Clip, factor: float) -> Clip:
    """A clip through cameras with `factor` times as many pixels along each side of the same view."""
    scale = np.diag([factor, factor, 1.0])
    rig = CameraRig(
        tuple(
            replace(c, K=scale @ c.K, size=(round(factor * c.size[0]), round(factor * c.size[1])))
            for c in clip.views.rig
        )
    )
    return replace(
        clip,
        views=marker_views(rig),
        uv=tuple(factor * uv for uv in clip.uv),
        box=tuple(factor * box for box in clip.box),
    )


def person_of(clip: Clip, one: Condition, seed: int) -> Prepared | None:
    """The person of a clip as found at the detector of the table, or as known."""
    where = joint_markers if one.in_joints else None
    detector = PERFECT if one.knows_body else TABLE_DETECTOR
    return prepare(clip, seed, detector=detector, markers_of=where)


def run(clip: Clip, person: Prepared, name: str, seed: int) -> dict[str, Any]:
    """One condition on one clip."""
    one = CONDITIONS[name]
    seen = clip if one.magnification == 1.0 else magnified(clip, one.magnification)
    settings = (f"markers.gate_px={one.gate_px}", f"pose.noise_scale={one.noise_scale}")
    return {"condition": name, **run_cell(seen, person, one.detector, one.filter, seed, settings)}


def rows_of(action: str, n_frames: int, seeds: int, chosen: Sequence[str]) -> list[dict[str, Any]]:
    """The chosen conditions on one action; what shares a film and a person is run together."""
    films: dict[tuple[bool, bool, int, bool], list[str]] = {}
    for name in chosen:
        c = CONDITIONS[name]
        films.setdefault((c.in_joints, c.hides, c.times_fps, c.knows_body), []).append(name)
    rows = []
    for (in_joints, hides, times_fps, _), names in films.items():
        clip = make_clip(action, n_frames, in_joints=in_joints, hides=hides, times_fps=times_fps)
        for seed in range(seeds):
            person = person_of(clip, CONDITIONS[names[0]], seed)
            if person is not None:
                rows += [run(clip, person, name, seed) for name in names]
    return rows


def with_kept(rows: Sequence[dict[str, Any]], before: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """New rows and those of earlier calls that they do not replace, ordered by action and condition."""

    def key(row: dict[str, Any]) -> tuple[int, int, int]:
        return (
            list(PUBLISHED).index(row["action"]),
            list(CONDITIONS).index(row["condition"]),
            int(row["seed"]),
        )

    found = {key(row): row for row in (*before, *rows) if row["condition"] in CONDITIONS}
    return [found[k] for k in sorted(found)]


def say(rows: Sequence[dict[str, Any]]) -> None:
    """Means over actions and seeds, one line per condition."""
    print(f"{'condition':60}{'mean mm':>9}{'MMTP':>8}{'MMTA %':>8}   " + " ".join(PUBLISHED))
    mean, _, mmtp, mmta = PUBLISHED_AVERAGE
    by_action = " ".join(f"{v[3]:.0f}" for v in PUBLISHED.values())
    print(f"{'published':60}{mean:9.1f}{mmtp:8.1f}{mmta:8.1f}   {by_action}")
    for name in CONDITIONS:
        own = [r for r in rows if r["condition"] == name]
        if not own:
            continue
        values = [
            float(np.mean([float(r[f]) for r in own if r[f] not in (None, "")]))
            for f in ("mean_error_mm", "mmtp_mm", "mmta_percent")
        ]
        shares = []
        for action in PUBLISHED:
            found = [float(r["mmta_percent"]) for r in own if r["action"] == action]
            shares.append(f"{np.mean(found):.0f}" if found else "-")
        print(f"{name:60}{values[0]:9.1f}{values[1]:8.1f}{values[2]:8.1f}   {' '.join(shares)}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the conditions, write the CSV, print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=45, help="frames per clip (default 45)")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--only", default=",".join(PUBLISHED), help="comma-separated actions")
    parser.add_argument("--conditions", nargs="+", default=list(CONDITIONS), choices=list(CONDITIONS))
    options = parser.parse_args(argv)
    rows: list[dict[str, Any]] = []
    for action in options.only.split(","):
        rows += rows_of(action, options.frames, options.seeds, options.conditions)
        print(f"{action}: done", file=sys.stderr, flush=True)
    fields = list(rows[0])
    rows = with_kept(rows, read_csv(RESULTS))
    write_csv(RESULTS, fields, rows)
    say(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
