"""What occluders are worth in furnished rooms: the same walks with and without furniture, occluders learnt and ignored.

    python -m eval.occlusion                       # development scenes
    python -m eval.occlusion --test --seeds 5      # the scenes kept for the final judgement
    python -m eval.occlusion SESSION [SESSION ...] # sessions with truth/

Every scene is synthesised twice, as it is and without its furniture (two minutes each; what is in --work already is
kept, and so is what is left of an interrupted call). Occluders are learnt in both, and ignored once, with the first
seed, in the furnished one. Writes eval/results/occlusion_{development,test}.csv and prints means over the seeds.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from eval.whole import write_csv
from mocap.compare.match import matched_pairs
from mocap.data import LANDMARKS
from mocap.io.session import open_session
from mocap.io.store import StageStore
from mocap.io.tables import read_landmarks_csv
from mocap.metrics import coverage_scores
from mocap.pipeline.config import load_config
from mocap.pipeline.run import run_session
from mocap.products.hulls import read_hulls
from mocap.products.occluders import stored_occluders
from mocap.synth.markers import Sight

RESULTS = Path(__file__).with_name("results")
DEVELOPMENT = (
    "furnished", "furnished_low", "furnished_pair",
    "furnished_four", "furnished_close", "furnished_place", "furnished_hidden",
    "furnished_few", "furnished_few_other",
    "furnished_sit", "furnished_throw", "furnished_pick_up",
)  # fmt: skip
TEST = ("furnished_test", "furnished_pair_test", "furnished_few_test")
LEGS = ("left_knee", "right_knee", "left_ankle", "right_ankle")
SEEN = (Sight.VISIBLE, Sight.OWN_BODY)
FIELDS = ("mean_error_mm", "mean_error_after_offset_mm", "mmta_percent", "coverage_90_percent")
Row = dict[str, str | float | int | None]


def evaluate(session: Path, work: Path, how: str, seed: int, furniture: str = "") -> Row:
    """One run of a session, judged.  how : `learn` or `ignore`, as of volume.occluders.  furniture : yes, no, or not
    known.
    """
    first, out = (work / "runs" / f"{session.name}_{how}_{n}" for n in (0, seed))
    if not out.exists() and first.exists():
        shutil.copytree(first, out)  # what does not depend on the seed
    config = load_config("default", ("output.formats=[]", f"volume.occluders={how}"))
    run_session(session, out, config=config, seed=seed, resume=True)
    record = json.loads((out / "run.json").read_text(encoding="utf-8"))
    scores = record["scores"]
    share = record["numbers"].get("occluders", {}).get("picture_share", {})
    n_hidden, n_claimed, held = hidden_landmarks(session, out)
    known, wrong = map_scores(session, out)
    return {
        "session": session.name,
        "furniture": furniture,
        "occluders": how,
        "seed": seed,
        "largest_picture_share": max(share.values(), default=0.0),
        "hidden_known_percent": known,
        "seen_called_hidden_percent": wrong,
        "legs_in_hull_percent": round(100.0 * legs_in_hull(session, out), 1),
        "hull_iou": None if scores["volume_iou"] is None else round(scores["volume_iou"], 3),
        **{name: round(scores[name], 1) for name in FIELDS},
        "silent_errors": scores["silent_errors"],
        "hidden_everywhere": n_hidden,
        "hidden_but_observed": n_claimed,
        "coverage_90_seen_by_less_than_two_percent": held,
        "camera_faults": record["numbers"]["carve"]["camera_faults"],
    }


def hidden_landmarks(session: Path, out: Path) -> tuple[int | None, int | None, float | None]:
    """How many true landmarks furniture, others or the picture's border hide from all cameras, how many of them the run
    calls observed, and how many in a hundred of those that fewer than two cameras see lie in their own 90 % region,
    None where there are none; all None where the truth does not say who sees what.
    """
    files = sorted((session / "truth" / "views").glob("*.npz"))
    if not files:
        return None, None, None
    n_seeing = np.sum([np.isin(np.load(file)["landmark_state"], SEEN) for file in files], axis=0)
    persons = np.load(files[0])["persons"].tolist()
    found = read_landmarks_csv(out / "landmarks.csv")
    n_hidden, n_claimed = 0, 0
    regions: list[tuple[NDArray[np.float64], ...]] = []
    for pair in matched_pairs(found, read_landmarks_csv(session / "truth" / "landmarks.csv")):
        own = n_seeing[pair.frames, persons.index(pair.person)]
        n_hidden += int((own == 0).sum())
        n_claimed += int(((own == 0) & pair.observed & np.isfinite(pair.estimate[..., 0])).sum())
        regions.append(tuple(a[own < 2][:, None] for a in (pair.estimate, pair.truth, pair.std)))
    estimate, truth, std = (np.concatenate(column) for column in zip(*regions, strict=True))
    held = coverage_scores(estimate, truth, std)
    return n_hidden, n_claimed, None if held.coverage_percent is None else round(held.coverage_percent, 1)


def map_scores(session: Path, out: Path) -> tuple[float | None, float | None]:
    """How well the maps tell who is hidden, percent over cameras and frames: how many of the true landmarks that
    furniture hides from a camera lie behind its map, and how many of those that it sees, or that the own body covers.
    None where there are none, or where the truth does not say who sees what.
    """
    rig = open_session(session).rig
    files = [f for f in sorted((session / "truth" / "views").glob("*.npz")) if f.stem in rig.names]
    maps = stored_occluders(StageStore(out / "store.zarr"), rig)
    true = read_landmarks_csv(session / "truth" / "landmarks.csv")
    n = np.zeros((2, 2))
    for file in files:
        view = np.load(file)
        for person in true:
            state = view["landmark_state"][person.frames, view["persons"].tolist().index(person.person)]
            behind = maps.hides(rig[file.stem], person.landmarks.reshape(-1, 3)).reshape(state.shape)
            for row, of in zip(n, (state == Sight.FURNITURE, np.isin(state, SEEN)), strict=True):
                row += (behind & of).sum(), of.sum()
    known, wrong = (None if total == 0 else round(float(100.0 * hit / total), 1) for hit, total in n)
    return known, wrong


def legs_in_hull(session: Path, out: Path) -> float:
    """Share of the true knees and ankles that lie in an occupied voxel, over persons and frames."""
    columns = [LANDMARKS.index(name) for name in LEGS]
    true = read_landmarks_csv(session / "truth" / "landmarks.csv")
    inside = []
    for frame, hull in read_hulls(StageStore(out / "store.zarr")):
        for person in true:
            row = np.flatnonzero(person.frames == frame)
            if len(row):
                at = hull.grid.voxels_of(person.landmarks[row[0], columns])
                inside.append(np.isin(at, hull.voxels))
    return float(np.mean(inside)) if inside else float("nan")


def prepared(name: str, work: Path, *, with_furniture: bool) -> Path:
    """The session of a scene, synthesised when it is not there yet."""
    root = work / (name if with_furniture else f"{name}_bare")
    if not (root / "truth" / "truth.json").exists():
        from mocap.synth import load_scene, synthesise

        scene = load_scene(name)
        room = scene.room if with_furniture else scene.room.model_copy(update={"furniture": ()})
        synthesise(scene.model_copy(update={"room": room}), root)
    return root


def means(rows: Sequence[Row]) -> list[str]:
    """One line for each session and way, with means over seeds."""
    groups: dict[tuple[object, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["session"], row["occluders"]), []).append(row)
    names = [*FIELDS, "silent_errors"]
    return [
        f"{session} {how}: "
        + ", ".join(f"{n} {np.mean([float(row[n] or 0.0) for row in own]):.1f}" for n in names)
        for (session, how), own in groups.items()
    ]


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m eval.occlusion",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("sessions", nargs="*", type=Path, help="session folders; the scenes when absent")
    parser.add_argument(
        "--work", type=Path, default=Path("out/occlusion"), help="folder for sessions and runs"
    )
    parser.add_argument("--test", action="store_true", help="the scenes kept for the final judgement")
    parser.add_argument("--scenes", help="some of them, separated by commas")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--name", help="of the table; development or test when absent")
    options = parser.parse_args(argv)
    rooms = [(session, "") for session in options.sessions]
    scenes = options.scenes.split(",") if options.scenes else TEST if options.test else DEVELOPMENT
    for name in () if rooms else scenes:
        rooms += [
            (prepared(name, options.work, with_furniture=yes), "yes" if yes else "no")
            for yes in (True, False)
        ]
    rows: list[Row] = []
    for session, furniture in rooms:
        runs = [("ignore", 0)] * (furniture != "no") + [("learn", seed) for seed in range(options.seeds)]
        for how, seed in runs:
            rows.append(evaluate(session, options.work, how, seed, furniture))
            print(", ".join(f"{k} {v}" for k, v in rows[-1].items()), flush=True)
    path = RESULTS / f"occlusion_{options.name or ('test' if options.test else 'development')}.csv"
    write_csv(path, list(rows[0]), rows)
    print("\n".join(means(rows)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
