"""Would a body of this person's girths and lengths be nearer? Fitted to hull and outlines of spread frames of a clip.

    python -m eval.person_surface [--seeds 5] [--only dev:walk,dev:cross] [--work out/eval]

Pose stage of the default preset on masks, volumes and tracks that are made once per session. After it, girths of all
kinds of parts (trunk, head, upper arm ...) and lengths of all kinds of segments are walked downhill one after the other
on the misfit of hull surface and outlines, in frames spread over the clip, poses refined at every value tried, with
priors (8 % on a girth, 4 % on a length, as people differ from the mean of their height). Then all poses are refined
with that body. A row per person, start, body and seed; mm, 15 landmarks:

    start        `found`: from the poses of the run; `truth`: fitted at and refined from the true poses, which is what
                 a perfect search would give
    body         `found`: as the run has it; `girths`; `lengths`: girths and then lengths
    raw, best_offset   as they are, and after the best constant offset in the torso's frame
    misfit       nats of hull and outlines, mean over frames
    changed_percent    mean change of what was fitted last

Poses are single frames, not smoothed. Writes eval/results/person_surface.csv, whole, when all sessions are run.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eval.error_budget import fitted_to, followed_with_truth
from eval.pose_ablation import SESSIONS
from eval.pose_sessions import ROOT
from eval.second_pass import evidence_of_rows
from eval.whole import kept_rows, write_csv
from mocap.arrays import Array
from mocap.body import Body, landmarks_of
from mocap.body.stretch import resize_body, segment_kinds, stretch_body
from mocap.data import LANDMARKS
from mocap.metrics.points import offset_corrected, point_errors
from mocap.pose.result import FollowedPerson
from mocap.pose.volume import VolumeEvidence

RESULTS = ROOT / "eval" / "results" / "person_surface.csv"
FIELDS = (
    *("session", "person", "start", "body", "seed"),
    *("raw", "best_offset", "misfit", "changed_percent"),
)
N = len(LANDMARKS)
N_FRAMES = 8
GIRTH_STD, LENGTH_STD = 0.08, 0.04
# Misfits of all frames together count as so many frames' worth, as in the size of a person (decision 24).
FRAMES_WORTH = 2.0
_NO_LENGTH_M = 1e-6


def girth_groups(body: Body) -> NDArray[np.int64]:
    """Group of every cone's girth, (K,): cones of joints whose names differ by left_ and right_ only share one."""
    return segment_kinds(body)[body.cones.joint]


def length_groups(body: Body) -> list[int]:
    """Groups of segments that carry flesh, or a joint at some distance."""
    groups = segment_kinds(body)
    carries = (body.parent >= 0) & (np.linalg.norm(body.offset, axis=1) > _NO_LENGTH_M)
    return sorted({*groups[body.parent[carries]].tolist(), *girth_groups(body).tolist()})


def with_girths(body: Body, logs: Array) -> Body:
    """The body with the radii of each group multiplied.  logs : (G,) of the factors."""
    return resize_body(body, 1.0, np.exp(logs))


def with_lengths(body: Body, logs: Array) -> Body:
    """The body with each group of segments stretched, its girths as they are.  logs : (G,) of the factors."""
    stretch = np.repeat(np.exp(logs[segment_kinds(body)])[:, None], 3, axis=1)
    longer = stretch_body(body, stretch)
    return replace(longer, height_m=body.height_m, cones=replace(longer.cones, radii=body.cones.radii))


def fitted_body(
    body: Body,
    frames: Sequence[VolumeEvidence],
    states: Sequence[Array],
    change: Callable[[Body, Array], Body],
    groups: Sequence[int],
    std: float,
) -> tuple[Body, Array]:
    """The body with each group changed to where hull and outlines of some frames fit best; and the changes, (G,).

    change : of a body by the logarithms of factors.  groups : that have something to fit.  std : of the prior.
    """
    logs = np.zeros(int(segment_kinds(body).max()) + 1)

    def cost(tried: Array) -> float:
        tools = frames[0].tools.with_body(change(body, tried))
        misfits = []
        for frame, state in zip(frames, states, strict=True):
            other = frame.with_tools(tools)
            misfits.append(float(other.misfit([other.refined(state, 2)])[0]))
        return FRAMES_WORTH * float(np.mean(misfits)) + 0.5 * float(((tried / std) ** 2).sum())

    for group in groups:
        step = np.zeros_like(logs)
        step[group] = std
        low, middle, high = (cost(logs + k * step) for k in (-1.0, 0.0, 1.0))
        bend = low - 2.0 * middle + high
        if bend > 1e-9:
            logs = logs + np.clip(0.5 * (low - high) / bend, -1.5, 1.5) * step
        elif min(low, high) < middle:
            logs = logs + (1.0 if high < low else -1.0) * step
    return change(body, logs), logs


def rows_of_person(
    one: FollowedPerson, evidence: Sequence[VolumeEvidence | None], true: Array
) -> list[dict[str, Any]]:
    """Rows of one person.  true : (T, 15, 3) m, NaN in frames without."""
    known = [row for row, seen in enumerate(evidence) if seen is not None and np.isfinite(true[row]).all()]
    seen_in = [seen for row in known if (seen := evidence[row]) is not None]
    places = true[known]
    own = one.series.states[known]
    spread = np.unique(np.linspace(0, len(known) - 1, N_FRAMES).astype(int))
    groups = sorted(set(girth_groups(one.body).tolist()))
    rows = []
    for start, states in (("found", own), ("truth", fitted_to(one.body, own, places)[0])):
        frames, poses = [seen_in[k] for k in spread], [states[k] for k in spread]
        thick, girths = fitted_body(one.body, frames, poses, with_girths, groups, GIRTH_STD)
        segments = length_groups(one.body)
        long, lengths = fitted_body(thick, frames, poses, with_lengths, segments, LENGTH_STD)
        bodies = {
            "found": (one.body, np.zeros(1)),
            "girths": (thick, girths[groups]),
            "lengths": (long, lengths[segments]),
        }
        for word, (body, changes) in bodies.items():
            tools = seen_in[0].tools.with_body(body)
            refined, misfits = [], []
            for seen, state in zip(seen_in, states, strict=True):
                other = seen.with_tools(tools)
                refined.append(other.refined(state))
                misfits.append(float(other.misfit([refined[-1]])[0]))
            found = landmarks_of(body, np.stack(refined))[:, :N]
            rows.append(
                {
                    "start": start,
                    "body": word,
                    "raw": float(point_errors(found, places).mean()),
                    "best_offset": float(
                        point_errors(offset_corrected(found, places, len(places)), places).mean()
                    ),
                    "misfit": float(np.mean(misfits)),
                    "changed_percent": 100.0 * float(np.abs(changes).mean()),
                }
            )
    return rows


def rows_of(name: str, seed: int, work_folder: Path, *, trust_store: bool) -> list[dict[str, Any]]:
    """Rows of a session."""
    rows = []
    for work, one, true, _ in followed_with_truth(
        name, "default", seed, work_folder, trust_store=trust_store
    ):
        for row in rows_of_person(one, evidence_of_rows(work, one), true):
            about = {"session": name, "person": one.person, "seed": seed}
            rows.append(about | {k: f"{v:.1f}" if isinstance(v, float) else v for k, v in row.items()})
    return rows


def summary(rows: Sequence[dict[str, str]]) -> str:
    """Means over persons and seeds of each start and body."""
    lines = []
    for start, body in dict.fromkeys((row["start"], row["body"]) for row in rows):
        own = [row for row in rows if (row["start"], row["body"]) == (start, body)]
        words = [f"{f} {np.mean([float(row[f]) for row in own]):.1f}" for f in FIELDS[5:]]
        lines.append(f"{start:6s} {body:8s} n={len(own):2d} {', '.join(words)}")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", help="sessions, separated by commas; then nothing is written")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "eval")
    parser.add_argument("--trust-store", action="store_true", help="take masks and volumes as they are")
    parser.add_argument("--again", action="store_true", help="make rows anew")
    options = parser.parse_args()
    names = options.only.split(",") if options.only else SESSIONS
    rows: list[dict[str, str]] = []
    for name, seed in product(names, range(options.seeds)):
        kept = options.work / "person_surface" / f"{name.replace(':', '_')}_{seed}.csv"
        make = partial(rows_of, name, seed, options.work, trust_store=options.trust_store)
        rows += kept_rows(kept, FIELDS, make, again=options.again)
    sys.stdout.write(summary(rows) + "\n")
    if not options.only:
        write_csv(RESULTS, FIELDS, rows)


if __name__ == "__main__":
    main()
