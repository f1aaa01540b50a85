"""A second pass over a clip that was followed, beside the pass itself: what it gains, and what it could.

    python -m eval.second_pass [--only walk,steps] [--work out/eval] [--trust-store]

Realistic development sessions, pose stage alone on the same masks, volumes and tracks. Every person is followed with
three seeds. Then, for the first of them, every frame gets more poses: refined from the smoothed poses of the frames
around it (`neighbours`), and from those that the other two seeds have there (`seeds`). One is taken per frame: that
with most evidence; the best path of all (Viterbi: evidence less a cost of motion); limb by limb, as long as the
evidence gains; the mean weighted by evidence; or the one nearest to the truth (`oracle`), which no method can beat.
`all frames at once` solves for the poses of a clip together: residuals of hull and outlines of every frame, with the
variance that the fit of each has, and accelerations (Gauss-Newton, block-banded). All are smoothed as usual but where
it says so. Writes eval/results/second_pass.csv, but for some of the sessions alone; seven minutes of one core.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from eval.pose_ablation import prepare
from eval.pose_sessions import ROOT
from eval.whole import write_csv
from mocap.body import Body, landmarks_of
from mocap.body.average import mean_state
from mocap.compare import evaluate
from mocap.data import LANDMARKS, Motion
from mocap.geometry.rigid import wrap_angle
from mocap.io.session import Session, open_session
from mocap.io.store import StageStore
from mocap.io.tables import read_landmarks_csv
from mocap.metrics.smoothness import smoothness_scores
from mocap.pipeline.config import load_config
from mocap.pipeline.stage import Job
from mocap.pipeline.stages.pose import PoseWork
from mocap.pose.limbs import legs_of, limbs_with_landmarks
from mocap.pose.result import FollowedPerson
from mocap.pose.smooth import smooth_motion
from mocap.pose.volume import VolumeEvidence, VolumeObservation
from mocap.products.tracks import stored_tracks

Array = NDArray[np.float64]
Choice = Callable[[int], Array]

RESULT = Path(__file__).with_name("results") / "second_pass.csv"
SESSIONS = ("walk", "cross", "reach", "steps", "furnished", "room")
SEEDS = (0, 1, 2)
FIELDS = (
    "session",
    "variant",
    "raw_mm",
    "after_offset_mm",
    "mmta_percent",
    "lost_wrist_percent",
    "jitter_m_s3",
)
AROUND = (-4, -1, 1, 4)  # frames whose smoothed poses a frame is refined from, besides its own
MOTION_NATS_PER_M2 = 2000.0  # of the mean square distance of landmarks from one frame to the next
TEMPERATURE_NATS = 1.0
# Of the batch: half of the largest expected acceleration of a person's place, and of his joints.
ACCELERATION_M_S2, ACCELERATION_RAD_S2 = 25.0, 50.0
N_STEPS, LARGEST_STEP, DAMPING = 4, 0.2, 1e-3


@dataclass(frozen=True, eq=False)
class Clip:
    """A person who was followed.  evidence : by row, None where too little is seen.  smooth : (T, D), as the run has
    it.  poses : by row, (K, D), the first as it was followed, then `n_near` from around, then those of other seeds.
    nats : (K,) of each.  true : (T, 15, 3) m, NaN = unknown.
    """

    one: FollowedPerson
    fps: float
    evidence: list[VolumeEvidence | None]
    smooth: Array
    poses: list[Array]
    n_near: list[int]
    nats: list[Array]
    true: Array

    @property
    def body(self) -> Body:
        return self.one.body

    def smoothed(self, states: Array) -> Array:
        """Landmarks (T, M, 3) of states (T, D), smoothed as those of a run."""
        settings = self.one.tools.settings
        series = replace(self.one.series, states=states)
        return landmarks_of(
            self.body,
            smooth_motion(self.body, series, self.fps, settings.smooth_lag_frames, settings.method),
        )

    def chosen(self, choice: Choice) -> Array:
        """States (T, D), one for each row."""
        return np.stack([choice(row) for row in range(len(self.poses))])


def evidence_of_rows(work: PoseWork, one: FollowedPerson) -> list[VolumeEvidence | None]:
    """What poses of each row are judged by, with the colours that the whole clip has taught."""
    tools = work.tools(one.height.height_m, 1).with_body(one.body)
    weight = one.tools.settings.outline_weight
    tools = replace(tools, settings=replace(tools.settings, outline_weight=weight))
    observation = VolumeObservation(tools, work.hull_of(one.person)).learning()
    prepared = [observation.prepare(int(frame)) for frame in one.frames]
    for row, hull in enumerate(prepared):
        if hull is not None:
            observation.learn(observation.evidence(hull), one.series.states[row])
    return [None if hull is None else observation.evidence(hull) for hull in prepared]


def nearest(one: FollowedPerson, frames: NDArray[np.int64], pelvis: Array) -> float:
    """Mean distance of a person's pelvis from another path (T, 3), over the frames of both, m."""
    _, own, other = np.intersect1d(one.frames, frames, return_indices=True)
    places = landmarks_of(one.body, one.series.states[own])[:, 0]
    return float(np.linalg.norm(places - pelvis[other], axis=1).mean()) if len(own) else np.inf


def clip_of(
    work: PoseWork,
    one: FollowedPerson,
    others: Sequence[Sequence[FollowedPerson]],
    truth: Sequence[Motion],
    fps: float,
) -> Clip:
    """A person with all poses that a second pass may choose from."""
    evidence = evidence_of_rows(work, one)
    settings, states = one.tools.settings, one.series.states
    smooth = smooth_motion(one.body, one.series, fps, settings.smooth_lag_frames, settings.method)
    pelvis = landmarks_of(one.body, states)[:, 0]
    same = [min(run, key=lambda other: nearest(other, one.frames, pelvis)) for run in others]
    poses, n_near, nats = [], [], []
    for row, seen in enumerate(evidence):
        near = [smooth[row], *(smooth[row + d] for d in AROUND if 0 <= row + d < len(smooth))]
        there = [p.series.states[p.frames == one.frames[row]] for p in same]
        starts = [*near, *(own for rows in there for own in rows)]
        found = [] if seen is None else seen.all_refined(starts)
        poses.append(np.stack([states[row], *found]))
        n_near.append(min(len(near), len(found)))
        nats.append(np.zeros(1) if seen is None else seen.evidence(poses[-1]))
    person = min(truth, key=lambda motion: nearest(one, motion.frames, motion.landmarks[:, 0]))
    true = np.full((len(states), len(LANDMARKS), 3), np.nan)
    _, own, of_truth = np.intersect1d(one.frames, person.frames, return_indices=True)
    true[own] = person.landmarks[of_truth][:, : len(LANDMARKS)]
    return Clip(one, fps, evidence, smooth, poses, n_near, nats, true)


# --- choices --------------------------------------------------------------------------------------------------


def most_evidence(clip: Clip, kind: str) -> Choice:
    """The pose with most evidence among those from around, of other seeds, or all; the followed one is among each."""

    def choice(row: int) -> Array:
        n = 1 + clip.n_near[row]
        rows = np.arange(len(clip.poses[row]))
        keep = (rows == 0) | (
            (rows < n) if kind == "neighbours" else (rows >= n) if kind == "seeds" else True
        )
        return np.asarray(clip.poses[row][keep][np.argmax(clip.nats[row][keep])])

    return choice


def best_path(clip: Clip) -> Choice:
    """Viterbi: the poses whose evidence, less a cost of the motion between them, is largest over the clip."""
    places = [landmarks_of(clip.body, poses) for poses in clip.poses]
    value, back = clip.nats[0], []
    for row in range(1, len(places)):
        moved = ((places[row][:, None] - places[row - 1][None]) ** 2).sum(axis=3).mean(axis=2)
        total = value[None] - MOTION_NATS_PER_M2 * moved
        back.append(total.argmax(axis=1))
        value = total.max(axis=1) + clip.nats[row]
    path = [int(value.argmax())]
    for step in reversed(back):
        path.append(int(step[path[-1]]))
    path.reverse()
    return lambda row: np.asarray(clip.poses[row][path[row]])


def by_limbs(clip: Clip) -> Choice:
    """The pose with most evidence, with limbs of the others in place of its own as long as the evidence gains."""
    legs = legs_of(clip.body)
    groups = [*([limb] for limb in limbs_with_landmarks(clip.body)), *([list(legs)] if legs else [])]
    columns = [np.concatenate([limb.columns for limb in group]) for group in groups]

    def choice(row: int) -> Array:
        seen, poses = clip.evidence[row], clip.poses[row]
        best = int(clip.nats[row].argmax())
        state, nats = poses[best], float(clip.nats[row][best])
        if seen is None:
            return np.asarray(state)
        for own in columns:
            mixed = np.repeat(state[None], len(poses), axis=0)
            mixed[:, own] = poses[:, own]
            values = seen.evidence(mixed)
            if values.max() > nats:
                state, nats = mixed[values.argmax()], float(values.max())
        refined = seen.all_refined([state])[0]
        return refined if seen.evidence([refined])[0] > nats else np.asarray(state)

    return choice


def weighted_mean(clip: Clip) -> Choice:
    """The mean pose, weighted by evidence."""

    def choice(row: int) -> Array:
        weights = np.exp((clip.nats[row] - clip.nats[row].max()) / TEMPERATURE_NATS)
        best = clip.poses[row][clip.nats[row].argmax()]
        return mean_state(clip.body, clip.poses[row], weights / weights.sum(), best)

    return choice


def nearest_to_truth(clip: Clip) -> Choice:
    """The pose whose landmarks lie nearest to the truth."""

    def choice(row: int) -> Array:
        places = landmarks_of(clip.body, clip.poses[row])[:, : len(LANDMARKS)]
        distance = np.linalg.norm(places - clip.true[row], axis=2)
        known = np.isfinite(distance[0])
        return np.asarray(clip.poses[row][distance[:, known].sum(axis=1).argmin()])

    return choice


# --- all frames at once ---------------------------------------------------------------------------------------


def all_at_once(clip: Clip) -> Array:
    """States (T, D) that minimise the residuals of all frames and their accelerations together."""
    body, correlated = clip.body, clip.one.tools.settings.method.deviation.correlated
    lower, upper, is_circular = body.layout.lower, body.layout.upper, np.asarray(body.layout.is_circular)
    x = clip.smooth.copy()
    x[:, is_circular] = np.unwrap(x[:, is_circular], axis=0)
    push = np.where(body.is_position, ACCELERATION_M_S2, ACCELERATION_RAD_S2) / clip.fps**2
    variance: Array | None = None
    for _ in range(N_STEPS):
        at = x.copy()
        at[:, is_circular] = wrap_angle(at[:, is_circular])
        cost, H, g = _equations(clip.evidence, at)
        if variance is None:
            n = [1 if seen is None else max(seen.surface.n_points, 1) for seen in clip.evidence]
            variance = correlated * 2.0 * cost / np.array(n)
            variance[variance <= 0] = np.inf
        step = joint_step(x, H / variance[:, None, None], g / variance[:, None], 1.0 / push**2)
        x = x + np.clip(step, -LARGEST_STEP, LARGEST_STEP)
        x[:, ~is_circular] = np.clip(x[:, ~is_circular], lower[~is_circular], upper[~is_circular])
    x[:, is_circular] = wrap_angle(x[:, is_circular])
    return x


def _equations(evidence: Sequence[VolumeEvidence | None], x: Array) -> tuple[Array, Array, Array]:
    """Costs (T,), matrices (T, D, D) and gradients (T, D) of the residuals of all frames."""
    T, D = x.shape
    cost, H, g = np.zeros(T), np.zeros((T, D, D)), np.zeros((T, D))
    for row, seen in enumerate(evidence):
        if seen is not None:
            cost[row], H[row], g[row] = seen.residuals.normal_equations(x[row])
    return cost, H, g


def joint_step(x: Array, H: Array, g: Array, weight: Array) -> Array:
    """The step (T, D) to the minimum of the quadratic terms of all frames and weight / 2 of the squared accelerations.

    x : (T, D), where it starts.  H : (T, D, D).  g : (T, D).  weight : (D,). Frames follow each other without a gap.
    """
    T, D = x.shape
    # Columns of which a frame says nothing follow its neighbours.
    damped = H + (DAMPING * np.trace(H, axis1=1, axis2=2)[:, None, None] / D + 1e-9) * np.eye(D)
    accelerations = np.zeros((T, 3))  # of the penalty's matrix: the diagonal, and two below it
    gradient = g.copy()
    change = x[:-2] - 2 * x[1:-1] + x[2:]
    stencil = (1, -2, 1)
    for a in range(3):
        gradient[a : T - 2 + a] += weight * stencil[a] * change
        for apart in range(3 - a):
            accelerations[a : T - 2 + a, apart] += stencil[a] * stencil[a + apart]
    band = np.zeros((3 * D, T * D))
    for i in range(D):
        for j in range(i, D):
            band[j - i, i::D] = damped[:, j, i]
    for apart in range(3):
        band[apart * D] += (accelerations[:, apart, None] * weight).ravel()
    return np.asarray(solveh_banded(band, -gradient.ravel(), lower=True).reshape(T, D))


# --- the table ------------------------------------------------------------------------------------------------


def variants(clip: Clip) -> dict[str, Array]:
    """Landmarks (T, M, 3) by variant."""
    choices = {
        "neighbours": most_evidence(clip, "neighbours"),
        "seeds": most_evidence(clip, "seeds"),
        "both": most_evidence(clip, "both"),
        "both, best path": best_path(clip),
        "both, by limbs": by_limbs(clip),
        "both, weighted mean": weighted_mean(clip),
        "both, oracle": nearest_to_truth(clip),
    }
    found = {name: clip.smoothed(clip.chosen(choice)) for name, choice in choices.items()}
    together = all_at_once(clip)
    found["all frames at once, not smoothed"] = landmarks_of(clip.body, together)
    found["all frames at once"] = clip.smoothed(together)
    return found


def row_of(
    session: Session,
    name: str,
    variant: str,
    people: Sequence[tuple[FollowedPerson, Array]],
    truth: Sequence[Motion],
) -> dict[str, Any]:
    """Scores of the landmarks (T, M, 3) of all persons."""
    motions = [
        Motion(one.person, one.frames, one.frames / session.fps, places[:, : len(LANDMARKS)])
        for one, places in people
    ]
    scores = evaluate(motions, truth, None, None, frames=list(session.frames))
    jitter = [
        smoothness_scores(m.landmarks, m.landmarks, m.frames, session.fps).jitter_estimate_m_s3
        for m in motions
    ]
    keys = ("mean_error_mm", "mean_error_after_offset_mm", "mmta_percent", "lost_wrist_percent")
    values = [*(float(scores[key] or 0.0) for key in keys), float(np.mean([j or 0.0 for j in jitter]))]
    return dict(zip(FIELDS, (name, variant, *(round(value, 2) for value in values)), strict=True))


def rows_of(name: str, work_folder: Path, *, trust_store: bool) -> list[dict[str, Any]]:
    """All rows of a session."""
    folder, out = prepare(f"dev:{name}", work_folder, trust_store=trust_store)
    session, store = open_session(folder), StageStore(out / "store.zarr")
    truth = read_landmarks_csv(folder / "truth" / "landmarks.csv")
    config, tracks = load_config("default", ()), stored_tracks(store, session.fps)
    runs = [PoseWork(Job(session, config, store, seed=seed)).follow(tracks) for seed in SEEDS]
    work = PoseWork(Job(session, config, store, seed=SEEDS[0]))
    rows = []
    for seed, run in zip(SEEDS, runs, strict=True):
        people = [(one, work.finished(one).landmarks) for one in run]
        rows.append(row_of(session, name, f"seed {seed}", people, truth))
    clips = [clip_of(work, one, runs[1:], truth, session.fps) for one in runs[0]]
    found = [variants(clip) for clip in clips]
    for variant in found[0]:
        people = [(clip.one, own[variant]) for clip, own in zip(clips, found, strict=True)]
        rows.append(row_of(session, name, variant, people, truth))
    return rows


def means(rows: Sequence[dict[str, Any]]) -> str:
    """The mean over sessions of every variant, as text."""
    lines = []
    for variant in dict.fromkeys(row["variant"] for row in rows):
        own = [row for row in rows if row["variant"] == variant]
        values = [float(np.mean([row[field] for row in own])) for field in FIELDS[2:]]
        lines.append(f"{variant:36s}" + "".join(f"{value:9.2f}" for value in values))
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--only", help="sessions, separated by commas; then the table is not written")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "eval")
    parser.add_argument(
        "--trust-store",
        action="store_true",
        help="take masks, volumes and tracks as they are, whatever code made them",
    )
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for name in arguments.only.split(",") if arguments.only else SESSIONS:
        rows += rows_of(name, arguments.work, trust_store=arguments.trust_store)
        sys.stdout.write(f"{name}\n{means([row for row in rows if row['session'] == name])}\n")
        sys.stdout.flush()
    if not arguments.only:
        write_csv(RESULT, FIELDS, rows)
    sys.stdout.write(f"all\n{means(rows)}\n")


if __name__ == "__main__":
    main()
