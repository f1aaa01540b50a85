"""Whether the landmarks' standard deviations are honest, and what smoothing is worth.

    python -m eval.pose_coverage [--only walk,dev:walk] [--preset best] [--seeds 2] [--fit] [--test] [--work out/eval]

Runs the pose stage of a preset on the first 80 frames of development sessions (with --test of held-out scenes and
sessions instead), prints coverage per session and per kind of landmark, and error and jitter before and after
smoothing. Writes eval/results/pose_coverage.csv and a reliability diagram, eval/results/pose_coverage.png. With --fit
it prints the share of deviations that is left where poses are settled on a texture, `DeviationSettings.settled`; with
`realtime`, which settles none, the constants `UNCERTAINTY` of mocap/pose/method.py that hold 90 % of persons they were
not fitted to. Poses are kept in WORK/coverage for the same program; --again makes them anew.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eval.pose_ablation import prepare
from eval.pose_sessions import DEV, ROOT
from eval.whole import save_figure, write_csv
from mocap.pipeline.reach import code_hash

RESULTS = ROOT / "eval" / "results" / "pose_coverage.csv"
PICTURE = ROOT / "eval" / "results" / "pose_coverage.png"
SCENES = ("walk", "box", "gesture", "jog", "throw", "demo", "two_persons")
DEV_SESSIONS = ("walk", "cross", "reach")
TEST = ("walk_test", "gesture_test", "box_test", "sit_test")
DEV_TEST = ("room", "furnished", "steps")  # nothing of the deviations is fitted on them
PRESETS = ("realtime", "default", "best")
FIELDS = (
    "set",
    "preset",
    "session",
    "seed",
    "landmarks",
    "coverage_90_percent",
    "coverage_50_percent",
    "std_factor",
    "calibration_error_percent",
    "sharpness_90_mm",
    "observed_percent",
    "lost_flagged_percent",
    "silent_error_percent",
    "lost_wrist_percent",
    "mean_error_mm",
    "constant_error_mm",
    "changing_error_mm",
    "raw_mean_error_mm",
    "acceleration_error_m_s2",
    "raw_acceleration_error_m_s2",
)
LOST_MM = 150.0
N_FRAMES = 80
LEAST_FLOOR_M, MOST_FLOOR_M = 0.003, 0.05
LEAST_SHARE = 0.5
N_BINS = 4  # of misfit, in which errors are shown

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Claims:
    """Estimates of one run and what they claim, persons one after the other.

    estimate, raw, truth, std : (T, 15, 3) m; raw is not smoothed.  blind : (T,), frames without a volume.
    misfit : (T, 15) nats.  observed, settled : (T, 15).  person, frame : (T,).  fps : ().
    """

    preset: str
    session: str
    seed: int
    estimate: Array
    raw: Array
    truth: Array
    std: Array
    blind: Array
    misfit: Array
    observed: NDArray[np.bool_]
    settled: NDArray[np.bool_]
    person: Array
    frame: Array
    fps: Array


def kept_in(work: Path) -> Path:
    """Where poses are kept: what two versions of the program claim must not meet in a figure."""
    return work / "coverage" / code_hash()


def claims_of(preset: str, name: str, seed: int, work: Path, *, again: bool) -> Claims:
    """The poses of one session and seed, kept or made now."""
    path = kept_in(work) / preset / f"{name.replace(':', '_')}_{seed}.npz"
    if again or not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(path, **_measured(preset, name, seed, work))
    with np.load(path) as found:
        return Claims(preset, name, seed, **{key: found[key] for key in found.files})


def _measured(preset: str, name: str, seed: int, work: Path) -> dict[str, Any]:
    from mocap.body import landmarks_of
    from mocap.compare import associate_persons
    from mocap.data import LANDMARKS, Motion, Tracks
    from mocap.io.session import open_session
    from mocap.io.store import StageStore
    from mocap.io.tables import read_landmarks_csv
    from mocap.pipeline.config import load_config
    from mocap.pipeline.stage import Job
    from mocap.pipeline.stages.pose import estimate_poses
    from mocap.pose.deviation import landmark_misfit, settled_landmarks
    from mocap.pose.method import DeviationSettings
    from mocap.products.tracks import stored_tracks

    folder, out = prepare(name, work, trust_store=True)
    session, store = open_session(folder), StageStore(out / "store.zarr")
    tracks = stored_tracks(store, session.fps)
    early = tracks.frame < session.frames.start + N_FRAMES
    found = estimate_poses(
        Job(session, load_config(preset), store, seed=seed),
        Tracks(tracks.frame[early], tracks.person[early], tracks.time_s[early], tracks.xyz[early]),
    )
    truth = read_landmarks_csv(folder / "truth" / "landmarks.csv")
    motions = [Motion(p.person, p.frames, p.frames / session.fps, p.landmarks) for p in found]
    of_person = {p.person: p for p in found}
    columns: dict[str, list[Any]] = {
        k: [] for k in Claims.__annotations__ if k not in ("preset", "session", "seed", "fps")
    }
    for motion, true in associate_persons(motions, truth):
        poses = None if motion is None else of_person[motion.person]
        if poses is None or poses.series is None:
            continue
        _, a, b = np.intersect1d(poses.frames, true.frames, return_indices=True)
        scored = a, slice(None, len(LANDMARKS))
        columns["estimate"].append(poses.landmarks[scored])
        columns["truth"].append(true.landmarks[b])
        columns["std"].append(np.sqrt(np.diagonal(poses.landmark_covariance, axis1=2, axis2=3))[scored])
        columns["blind"].append(np.isnan(poses.log_likelihood[a]))
        columns["misfit"].append(landmark_misfit(poses.body, poses.series)[scored])
        columns["raw"].append(landmarks_of(poses.body, poses.series.states)[scored])
        columns["person"].append(np.full(len(a), poses.person))
        columns["frame"].append(poses.frames[a])
        columns["observed"].append(poses.observed[scored])
        settled = settled_landmarks(poses.body, poses.series, DeviationSettings())
        columns["settled"].append(settled[scored])
    return {key: np.concatenate(value) for key, value in columns.items()} | {"fps": np.array(session.fps)}


def row_of(claims: Claims, which: str) -> dict[str, Any]:
    """Scores of one run as a flat row."""
    from mocap.metrics import coverage_scores, lost_wrist_percent
    from mocap.metrics.smoothness import smoothness_scores
    from mocap.metrics.uncertainty import reliability, silent_errors

    honest = reliability(claims.estimate, claims.truth, claims.std)
    silent = silent_errors(claims.estimate, claims.truth, claims.std, claims.observed)
    at_90 = coverage_scores(claims.estimate, claims.truth, claims.std)
    at_50 = coverage_scores(claims.estimate, claims.truth, claims.std, 0.5)
    error = 1000.0 * np.linalg.norm(claims.estimate - claims.truth, axis=2)
    is_lost = error > LOST_MM
    row: dict[str, Any] = {
        "set": which,
        "preset": claims.preset,
        "session": claims.session,
        "seed": claims.seed,
        "landmarks": at_90.n,
        "coverage_90_percent": at_90.coverage_percent,
        "coverage_50_percent": at_50.coverage_percent,
        "std_factor": None if honest is None else honest.std_factor,
        "calibration_error_percent": None if honest is None else honest.calibration_error_percent,
        "sharpness_90_mm": at_90.sharpness_mm,
        "observed_percent": 100.0 * float(claims.observed.mean()),
        "lost_flagged_percent": 100.0 * float((~claims.observed[is_lost]).mean()) if is_lost.any() else None,
        "silent_error_percent": silent.percent,
    }
    row["constant_error_mm"], row["changing_error_mm"] = constant_errors(claims)
    row |= {"lost_wrist_percent": lost_wrist_percent(claims.estimate, claims.truth)}
    for prefix, landmarks in (("", claims.estimate), ("raw_", claims.raw)):
        row[f"{prefix}mean_error_mm"] = 1000.0 * float(
            np.nanmean(np.linalg.norm(landmarks - claims.truth, axis=2))
        )
        shaky = []
        for person in np.unique(claims.person):
            own = claims.person == person
            scores = smoothness_scores(
                landmarks[own], claims.truth[own], claims.frame[own], float(claims.fps)
            )
            if scores.acceleration_error_m_s2 is not None:
                shaky.append(scores.acceleration_error_m_s2)
        row[f"{prefix}acceleration_error_m_s2"] = float(np.mean(shaky)) if shaky else None
    return {k: round(v, 3) if isinstance(v, float) else v for k, v in row.items()}


def constant_errors(claims: Claims) -> tuple[float, float]:
    """Root mean square of what errors are on the average of a person, in the directions that it faces, and of the rest,
    mm: no smoothing takes the first away, and who is not this person knows nothing of it."""
    from mocap.data import LANDMARKS

    left, right = LANDMARKS.index("left_hip"), LANDMARKS.index("right_hip")
    aside = (claims.truth[:, left] - claims.truth[:, right]) * (1.0, 1.0, 0.0)
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    up = np.broadcast_to((0.0, 0.0, 1.0), aside.shape)
    facing = np.stack([np.cross(aside, up), aside, up], axis=1)
    error = np.einsum("tij,tmj->tmi", facing, claims.estimate - claims.truth)
    constant = np.zeros_like(error)
    for person in np.unique(claims.person):
        own = claims.person == person
        constant[own] = np.nanmean(error[own], axis=0)
    parts = [1000.0 * float(np.sqrt(np.nanmean((e**2).sum(axis=2)))) for e in (constant, error - constant)]
    return parts[0], parts[1]


Constants = Mapping[str, tuple[float, float]]


def restated(claims: Claims, constants: Constants) -> Claims:
    """The same poses with deviations by other constants; what the fit of each frame knows stays."""
    from mocap.data import LANDMARKS
    from mocap.pose.deviation import landmark_kind
    from mocap.pose.method import UNCERTAINTY

    def own(of: Constants) -> Array:
        floor, per_nat = np.array([of[landmark_kind(name)] for name in LANDMARKS]).T
        return np.asarray(floor**2 + (per_nat * claims.misfit) ** 2)[..., None]

    squared = claims.std**2 - own(UNCERTAINTY) + own({**UNCERTAINTY, **constants})
    return replace(claims, std=np.sqrt(np.maximum(squared, 0.0)))


def settled_by(claims: Claims, share: float) -> Claims:
    """The same poses with another share of deviations left where they are settled on a texture."""
    from mocap.pose.method import DeviationSettings

    times = np.where(claims.settled, share / DeviationSettings.settled, 1.0)
    return replace(claims, std=claims.std * times[..., None])


def fit_share(found: list[Claims]) -> float:
    """The smallest share of deviations at which the regions of settled kinds of landmarks hold 90 %, kinds and sessions
    alike."""
    from mocap.pose.method import DeviationSettings

    for share in np.arange(LEAST_SHARE, 1.0, 0.01):
        tried = [settled_by(c, share) for c in found]
        if np.mean([held_of_kind(tried, kind).mean() for kind in DeviationSettings.settled_kinds]) >= 90.0:
            return round(float(share), 2)
    return 1.0


def fit_for_strangers(found: list[Claims]) -> dict[str, tuple[float, float]]:
    """Constants fitted to all sessions, floors widened until they hold 90 % of a session that they were not fitted to.

    Most of an error is the same in every frame of a person, and a handful of persons tells little of strangers:
    constants fitted without a session hold too little of it. The factor that mends this in the mean is taken.
    """
    without = {c.session: fit_floors([o for o in found if o.session != c.session]) for c in found}
    for factor in np.arange(1.0, 2.0, 0.02):
        held = [row_of(restated(c, _wider(without[c.session], factor)), "") for c in found]
        if np.mean([row["coverage_90_percent"] for row in held]) >= 90.0:
            break
    return _wider(fit_floors(found), factor)


def _wider(constants: Constants, factor: float) -> dict[str, tuple[float, float]]:
    return {kind: (round(factor * floor, 4), growth) for kind, (floor, growth) in constants.items()}


def fit_floors(found: list[Claims]) -> dict[str, tuple[float, float]]:
    """Constants with the smallest floor at which the regions of every kind of landmark hold 90 %, sessions alike.

    Growth per nat stays as it is: there are few lost limbs in development sessions to fit it to.
    """
    from mocap.data import LANDMARKS
    from mocap.pose.deviation import landmark_kind
    from mocap.pose.method import UNCERTAINTY

    out = {}
    for kind in dict.fromkeys(map(landmark_kind, LANDMARKS)):
        per_nat = UNCERTAINTY[kind][1]
        for floor in np.arange(LEAST_FLOOR_M, MOST_FLOOR_M, 0.0005):
            tried = [restated(c, {kind: (float(floor), per_nat)}) for c in found]
            if held_of_kind(tried, kind).mean() >= 90.0:
                break
        out[kind] = (float(floor), per_nat)
    return out


def held_of_kind(found: list[Claims], kind: str) -> Array:
    """How much the 90 % regions of one kind of landmark hold, percent, of every session."""
    from mocap.data import LANDMARKS
    from mocap.metrics import coverage_scores
    from mocap.pose.deviation import landmark_kind

    own = [m for m, name in enumerate(LANDMARKS) if landmark_kind(name) == kind]
    scores = [coverage_scores(c.estimate[:, own], c.truth[:, own], c.std[:, own]) for c in found]
    return np.array([s.coverage_percent for s in scores if s.coverage_percent is not None])


def by_kind(found: list[Claims]) -> list[str]:
    """Coverage of 90 % regions per kind of landmark, sessions weighing the same, as lines of text."""
    from mocap.data import LANDMARKS
    from mocap.pose.deviation import landmark_kind

    lines = []
    for kind in dict.fromkeys(map(landmark_kind, LANDMARKS)):
        held = held_of_kind(found, kind)
        lines.append(f"{kind:9s} {held.mean():5.1f} % (sessions {held.min():.0f} to {held.max():.0f})")
    return lines


def by_misfit(found: list[Claims]) -> list[str]:
    """Median error of the arms' and legs' ends in quarters of misfit, from good to bad fits, as lines of text."""
    from mocap.data import LANDMARKS
    from mocap.pose.deviation import landmark_kind

    lines = []
    for kind in ("wrist", "ankle"):
        own = [m for m, name in enumerate(LANDMARKS) if landmark_kind(name) == kind]
        error = np.concatenate([np.linalg.norm(c.raw - c.truth, axis=2)[:, own].ravel() for c in found])
        misfit = np.concatenate([c.misfit[:, own].ravel() for c in found])
        group = np.clip(np.searchsorted(np.quantile(misfit, [0.25, 0.5, 0.75]), misfit), 0, N_BINS - 1)
        medians = [1000.0 * float(np.nanmedian(error[group == k])) for k in range(N_BINS)]
        lines.append(f"{kind}, by misfit: median error {', '.join(f'{m:.0f}' for m in medians)} mm")
    return lines


def means(found: list[Claims]) -> str:
    """Means over the sessions in one line."""
    rows = [row_of(c, "") for c in found]
    words = []
    for key in FIELDS[FIELDS.index("coverage_90_percent") :]:
        values = [float(r[key]) for r in rows if r[key] is not None]
        words.append(f"{key} {np.mean(values):.2f}" if values else f"{key} -")
    return "mean over sessions: " + ", ".join(words)


def draw(groups: dict[str, list[Claims]]) -> None:
    """Reliability diagram and error against claim, one line per preset and set of sessions."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    from mocap.metrics.uncertainty import reliability

    figure, (left, right) = plt.subplots(1, 2, figsize=(8.4, 4.0), layout="constrained")
    left.plot([0, 100], [0, 100], color="0.7", lw=1)
    top = 1.0
    for (name, found), colour in zip(
        groups.items(), ("#0072b2", "#d55e00", "#56b4e9", "#e69f00", "#009e73", "#cc79a7"), strict=False
    ):
        honest = reliability(
            *(np.concatenate([getattr(c, k) for c in found]) for k in ("estimate", "truth", "std"))
        )
        if honest is None:
            continue
        left.plot(honest.level_percent, honest.coverage_percent, "o-", ms=3, color=colour, label=name)
        right.plot(honest.claimed_mm, honest.found_mm, "o-", ms=3, color=colour, label=name)
        top = max(top, honest.claimed_mm.max(), honest.found_mm.max())
    right.plot([0, top], [0, top], color="0.7", lw=1)
    left.set(xlabel="region should hold, %", ylabel="truth inside, %", title="Coverage")
    right.set(xlabel="claimed deviation per axis, mm", ylabel="found, mm", title="Error against claim")
    left.legend()
    save_figure(figure, PICTURE, dpi=90)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", help="sessions, separated by commas")
    parser.add_argument("--preset", choices=PRESETS, default="default")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--fit", action="store_true", help="print constants fitted to these sessions")
    parser.add_argument("--test", action="store_true", help="held-out scenes instead of development sessions")
    parser.add_argument("--again", action="store_true", help="make the poses anew")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "eval")
    arguments = parser.parse_args()
    if arguments.test and arguments.fit:
        parser.error("nothing is fitted on held-out scenes")
    scenes, realistic = (TEST, DEV_TEST) if arguments.test else (SCENES, DEV_SESSIONS)
    names = [*scenes, *(f"dev:{n}" for n in realistic if (DEV / n).is_dir())]
    if arguments.only:
        names = arguments.only.split(",")
    which = "test" if arguments.test else "development"
    found = []
    for name in names:
        for seed in range(arguments.seeds):
            claims = claims_of(arguments.preset, name, seed, arguments.work, again=arguments.again)
            found.append(claims)
            row = row_of(claims, which)
            sys.stdout.write(" ".join(f"{k}={row[k]}" for k in FIELDS[1:]) + "\n")
            sys.stdout.flush()
    sys.stdout.write("\n".join([*by_kind(found), *by_misfit(found)]) + "\n" + means(found) + "\n")
    is_settled = any(c.settled.any() for c in found)
    if is_settled:
        without = [settled_by(c, 1.0) for c in found]
        sys.stdout.write(f"with deviations of poses that are not settled, {means(without)}\n")
    if arguments.fit and is_settled:
        share = fit_share(found)
        strangers = [settled_by(c, fit_share([o for o in found if o is not c])) for c in found]
        held = np.mean([row_of(c, "")["coverage_90_percent"] for c in strangers])
        sys.stdout.write(f"settled = {share}; shares of the others hold {held:.1f} % of each session\n")
        sys.stdout.write(means([settled_by(c, share) for c in found]) + "\n")
    elif arguments.fit:
        fitted = fit_for_strangers(found)
        for kind, (floor, per_nat) in fitted.items():
            sys.stdout.write(f'    "{kind}": ({floor:.4f}, {per_nat:.4f}),\n')
        sys.stdout.write(means([restated(c, fitted) for c in found]) + "\n")
    kept = []
    if RESULTS.exists():
        with RESULTS.open(encoding="utf-8", newline="") as stream:
            new = which, arguments.preset
            kept = [r for r in csv.DictReader(stream) if (r["set"], r["preset"]) != new]
    write_csv(RESULTS, FIELDS, [*kept, *(row_of(c, which) for c in found)])
    groups: dict[str, list[Claims]] = {}
    for path in sorted(kept_in(arguments.work).glob("*/*.npz")):
        stem, _, seed_text = path.stem.rpartition("_")
        name = stem.replace("dev_", "dev:", 1)
        held_out = name in TEST or name.removeprefix("dev:") in DEV_TEST
        preset, group = path.parent.name, "held-out sessions" if held_out else "development sessions"
        groups.setdefault(f"{preset}, {group}", []).append(
            claims_of(preset, name, int(seed_text), arguments.work, again=False)
        )
    draw(groups)


if __name__ == "__main__":
    main()
