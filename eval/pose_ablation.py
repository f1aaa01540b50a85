"""Ablation of the default pose mode: variants of its settings over sessions and seeds.

    python -m eval.pose_ablation [--only dev:walk,walk] [--variants default,no_outlines] [--seeds 3] [--work out/eval]

Masks, volumes and tracks are made once per session; only the pose stage runs again. Writes one line per run to
eval/results/pose_ablation.csv (existing lines are kept and not run again) and the table of docs/results-notes.md, which
`python -m eval.pose_sessions --page-only` takes into docs/results.md, and prints the means. Development sessions only:
nothing is chosen on the held-out scenes of `eval.pose_sessions`.
"""

from __future__ import annotations

import argparse
import csv
import statistics
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eval.pose_sessions import DEV, ROOT
from eval.whole import with_table, write_csv, write_text

if TYPE_CHECKING:
    from mocap.io.session import Session
    from mocap.pipeline.config import Config
    from mocap.pose.result import PersonPoses

RESULTS = ROOT / "eval" / "results" / "pose_ablation.csv"
PAGE = ROOT / "docs" / "results-notes.md"
SESSIONS = ("dev:walk", "dev:cross", "dev:furnished", "dev:reach", "dev:room", "dev:steps")
# With texture, and without it: what a part is worth to the poses that texture is learnt from.
WITHOUT_TEXTURE = ("pose.texture_weight=0",)
VARIANTS: dict[str, tuple[str, ...]] = {
    "default": (),
    "texture_in_every_frame": ("pose.texture_every_frames=1",),
    "no_texture": WITHOUT_TEXTURE,
} | {
    f"no_texture_{name}": (*WITHOUT_TEXTURE, *settings)
    for name, settings in {
        "no_refinement": ("pose.refine=false", "pose.look_again=false"),
        "no_scouts_no_rescue": ("pose.look_again=false",),
        "no_outlines": ("pose.outline_weight=0",),
        "outlines_only": ("pose.surface_weight=0",),
        "no_colours": ("pose.colour_weight=0",),
        "no_repair": ("pose.repair=false",),
        "no_smoothing": ("pose.smooth_lag_frames=0",),
        "size_from_head": ("body.sizing=head",),
        "no_feedback": ("pose.feedback_share=0",),
        "no_usual_postures": ("pose.posture_nats=0",),
        "no_feet_and_hands": ("body.model=girdle",),
        "search_every_frame": ("pose.search_every_frames=1",),
        "search_every_3": ("pose.search_every_frames=3",),
        "search_every_5": ("pose.search_every_frames=5",),
    }.items()
}
SCORES = (
    "mean_error_mm",
    "mean_error_after_offset_mm",
    "mmta_percent",
    "lost_wrist_percent",
    "coverage_90_percent",
)
FIELDS = ("session", "variant", "seed", *SCORES, "seconds")


def session_folder(name: str, work: Path) -> Path:
    """The folder of a development session, dev:NAME, or of a scene, which is made when it is not there."""
    if name.startswith("dev:"):
        return DEV / name.removeprefix("dev:")
    from mocap.synth import synthesise

    folder = work / "sessions" / name
    return folder if folder.exists() else synthesise(name, folder)


def prepare(name: str, work: Path, *, trust_store: bool) -> tuple[Path, Path]:
    """Session folder and run folder with masks, volumes and tracks in its store."""
    folder = session_folder(name, work)
    out = work / "ablation" / name.replace(":", "_")
    if not (trust_store and (out / "store.zarr").exists()):
        run_until_tracks(folder, out)
    return folder, out


def run_until_tracks(folder: Path, out: Path) -> None:
    """Masks, volumes and tracks of a session into a run folder, as far as they are not there."""
    from mocap.pipeline.config import load_config
    from mocap.pipeline.run import run_session

    config = load_config("default", ("output.formats=[]",))
    run_session(folder, out, config=config, seed=0, resume=True, until="track")


def poses_of(folder: Path, out: Path, config: Config, seed: int) -> tuple[Session, list[PersonPoses]]:
    """The pose stage alone, on what `prepare` has put into the run folder."""
    from mocap.io.session import open_session
    from mocap.io.store import StageStore
    from mocap.pipeline.stage import Job
    from mocap.pipeline.stages.pose import estimate_poses
    from mocap.products.tracks import stored_tracks

    session, store = open_session(folder), StageStore(out / "store.zarr")
    return session, estimate_poses(Job(session, config, store, seed=seed), stored_tracks(store, session.fps))


def measure(folder: Path, out: Path, settings: tuple[str, ...], seed: int) -> dict[str, Any]:
    """Scores of one variant and seed."""
    from mocap.compare import evaluate
    from mocap.io.tables import read_landmarks_csv
    from mocap.pipeline.config import load_config
    from mocap.pose.result import motion_of

    started = time.perf_counter()
    session, poses = poses_of(folder, out, load_config("default", settings), seed)
    seconds = time.perf_counter() - started
    truth = read_landmarks_csv(folder / "truth" / "landmarks.csv")
    scores = evaluate(
        [motion_of(p, session.fps) for p in poses], truth, None, None, frames=list(session.frames)
    )
    return {k: round(float(scores[k]), 3) for k in SCORES if scores[k] is not None} | {
        "seconds": round(seconds, 1)
    }


def read_rows() -> list[dict[str, str]]:
    """Lines of earlier runs."""
    if not RESULTS.exists():
        return []
    with RESULTS.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def whole_seeds(rows: list[dict[str, str]]) -> list[str]:
    """Seeds that every variant has been run with in every development session."""
    done = {(r["session"], r["variant"], r["seed"]) for r in rows}
    seeds = sorted({r["seed"] for r in rows})
    return [s for s in seeds if all((name, v, s) in done for name in SESSIONS for v in VARIANTS)]


def table(rows: list[dict[str, str]]) -> str:
    """Means of every variant over all sessions and the whole seeds, of which there is one at least."""
    done, whole = {(r["session"], r["variant"], r["seed"]): r for r in rows}, whole_seeds(rows)
    lines = [
        f"| {len(SESSIONS)} sessions, {len(whole)} seeds | raw, mm | after offset, mm | MMTA, % | lost wrist, % "
        "| 90 % regions hold, % | raw of `dev:reach`, mm |",
        "|---|---|---|---|---|---|---|",
    ]
    for variant in VARIANTS:
        own = [done[name, variant, s] for name in SESSIONS for s in whole]
        means = [statistics.fmean(float(r[score]) for r in own) for score in SCORES]
        reach = [float(done["dev:reach", variant, s]["mean_error_mm"]) for s in whole]
        numbers = " | ".join(f"{v:.1f}" for v in (*means, statistics.fmean(reach)))
        lines.append(f"| {_words(variant)} | {numbers} |")
    return "\n".join(lines)


def _words(variant: str) -> str:
    """What a variant is called in the table."""
    return variant.replace("no_texture_", "no texture, ").replace("_", " ")


def summary(rows: list[dict[str, str]]) -> str:
    """Mean over sessions and seeds of every variant, and of every session, as text."""
    lines = []
    for session in [*sorted({r["session"] for r in rows}), "all"]:
        for variant in dict.fromkeys(r["variant"] for r in rows):
            own = [r for r in rows if r["variant"] == variant and session in (r["session"], "all")]
            if own:
                words = []
                for field in (*SCORES, "seconds"):
                    values = [float(r[field]) for r in own if r[field]]
                    if values:
                        spread = statistics.stdev(values) if len(values) > 1 and session != "all" else 0.0
                        words.append(f"{statistics.fmean(values):7.1f} ± {spread:4.1f}")
                lines.append(f"{session:12s} {variant:22s} n={len(own):2d} " + " | ".join(words))
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--only", help="sessions, separated by commas")
    parser.add_argument("--variants", help="variants, separated by commas")
    parser.add_argument(
        "--set", action="append", default=[], help="NAME:key=value[,key=value]: a variant of your own"
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "eval")
    parser.add_argument(
        "--trust-store",
        action="store_true",
        help="take masks, volumes and tracks as they are, whatever code made them",
    )
    arguments = parser.parse_args()
    names = arguments.only.split(",") if arguments.only else SESSIONS
    variants = dict(VARIANTS)
    if arguments.variants:
        variants = {k: v for k, v in VARIANTS.items() if k in arguments.variants.split(",")}
    for own in arguments.set:
        name, _, settings = own.partition(":")
        variants[name] = tuple(settings.split(","))
    rows = read_rows()
    for name in names:
        folder, out = prepare(name, arguments.work, trust_store=arguments.trust_store)
        for seed in range(arguments.first_seed, arguments.first_seed + arguments.seeds):
            for variant, settings in variants.items():
                if any((r["session"], r["variant"], r["seed"]) == (name, variant, str(seed)) for r in rows):
                    continue
                row = {"session": name, "variant": variant, "seed": seed} | measure(
                    folder, out, settings, seed
                )
                rows.append({k: str(row.get(k, "")) for k in FIELDS})
                print(" ".join(f"{row.get(k, '')}" for k in FIELDS), flush=True)
    write_csv(RESULTS, FIELDS, rows)
    if whole_seeds(rows):
        write_text(PAGE, with_table(PAGE.read_text(encoding="utf-8"), "parts", table(rows)))
    wanted = [r for r in rows if r["variant"] in variants and r["session"] in names]
    print(summary(wanted))


if __name__ == "__main__":
    main()
