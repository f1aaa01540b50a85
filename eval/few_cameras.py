"""Few cameras: what two, three and four of a session's cameras give, beside what `foresee` expects of where they stand.

    python -m eval.few_cameras [SESSION ...]     # two walks, among the development sessions
    python -m eval.few_cameras --test            # sessions that the foresight's numbers were not chosen on
    python -m eval.few_cameras --seeds 5         # the same, five times
    python -m eval.few_cameras --cameras 3 --name furnished ../shared/dev_sessions/furnished furnished_throw \
        furnished_pick_up furnished_sit          # among furniture
    python -m eval.few_cameras --cameras 3 --name furnished_test furnished_test furnished_few_test furnished_pair_test

Of every session pairs at about 50, 100 and 150 degrees, the most even and the narrowest three and four cameras, and
all of them are run with the default preset from the videos; with --cameras 3 only the sets of three. Columns: errors
raw and after one offset per landmark, mm, MMTA %, and the foreseen deviation, mm, at the places where the persons of
the truth are. Writes eval/results/few_cameras_{development,test}.csv, or the table called --name, whole; what is in
--work already is kept. --fit prints how some numbers of `ForesightSettings` foresee the errors of the development
table. `python -m docs.make_few_cameras` puts the tables into the pages.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator
from itertools import combinations, product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from eval.session_tables import RESULTS, Row, names_of, session_of, session_parser, write_table
from eval.whole import write_text
from mocap.body import load_body_model, scale_body
from mocap.compare import CompareOptions, compare
from mocap.data import CameraRig
from mocap.io.session import open_session
from mocap.io.tables import read_landmarks_csv
from mocap.pipeline.config import load_config
from mocap.pipeline.run import run_session
from mocap.pose.foresight import ForesightSettings, foresee

Array = NDArray[np.float64]

_SHARED = Path("../shared/dev_sessions")
DEVELOPMENT = (str(_SHARED / "walk"), str(_SHARED / "cross"))
TEST = (str(_SHARED / "steps"),)
PAIRS_DEG = (50.0, 100.0, 150.0)
_N_PLACES = 4  # of each person, over the clip


def angles_deg(rig: CameraRig, middle: Array) -> Array:
    """(C,) azimuths of the cameras as seen from a place (2,) m, 0 <= a < 360."""
    to = np.array([camera.center[:2] for camera in rig]) - middle
    return np.asarray(np.degrees(np.arctan2(to[:, 1], to[:, 0])) % 360.0)


def gaps_deg(angles: Array) -> Array:
    """(C,) from each of some azimuths to the next one round the circle."""
    around = np.sort(angles)
    return np.diff(around, append=around[0] + 360.0)


def camera_sets(rig: CameraRig, middle: Array) -> Iterator[tuple[str, tuple[str, ...]]]:
    """What is tried: a word for it and the cameras' names."""
    angles = angles_deg(rig, middle)

    def names(rows: tuple[int, ...]) -> tuple[str, ...]:
        return tuple(rig.names[row] for row in rows)

    def widest_gap(rows: tuple[int, ...]) -> float:
        return float(gaps_deg(angles[list(rows)]).max())

    for wanted in PAIRS_DEG:
        pair = min(combinations(range(len(rig)), 2), key=lambda p: abs(360.0 - widest_gap(p) - wanted))
        yield f"{360.0 - widest_gap(pair):.0f} degrees apart", names(pair)
    for n in range(3, min(5, len(rig))):
        sets = list(combinations(range(len(rig)), n))
        yield "all round", names(min(sets, key=widest_gap))
        yield "side by side", names(max(sets, key=widest_gap))
    yield "all", rig.names


def some_cameras(session: Path, names: tuple[str, ...], work: Path) -> Path:
    """The session with some of its cameras: its own files, and a list of cameras."""
    root = work / "some" / f"{session.name}-{'-'.join(names)}"
    if not root.exists():
        root.mkdir(parents=True)
        for entry in session.iterdir():
            if entry.name != "session.toml":
                (root / entry.name).symlink_to(entry.resolve())
        own = session / "session.toml"
        lines = own.read_text(encoding="utf-8") if own.exists() else ""
        listed = ", ".join(f'"{name}"' for name in names)
        write_text(root / "session.toml", f"cameras = [{listed}]\n{lines}")
    return root


def places_of(session: Path) -> tuple[Array, float]:
    """Places (P, 2) m of the persons of the truth, and the height m of the tallest."""
    people = read_landmarks_csv(session / "truth" / "landmarks.csv")
    spots, heights = [], []
    for person in people:
        rows = np.linspace(0, len(person.landmarks) - 1, _N_PLACES).astype(int)
        spots.append(person.landmarks[rows, person.names.index("pelvis"), :2])
        heights.append(float(person.landmarks[:, person.names.index("head"), 2].max()))
    return np.concatenate(spots), max(heights)


def row_of(session: Path, words: str, names: tuple[str, ...], work: Path, seed: int) -> Row:
    """One run and what was foreseen of it."""
    fewer = some_cameras(session, names, work)
    out = work / "runs" / (fewer.name if seed == 0 else f"{fewer.name}-seed-{seed}")
    run_session(fewer, out, config=load_config("default", ("output.formats=[]",)), seed=seed, resume=True)
    scores = compare(out, session, CompareOptions()).scores
    return {
        "session": session.name,
        "n_cameras": len(names),
        "cameras": " ".join(names),
        "places": words,
        "seed": seed,
        "mean_error_mm": round(scores["mean_error_mm"], 1),
        "after_offset_mm": round(scores["mean_error_after_offset_mm"], 1),
        "mmta_percent": round(scores["mmta_percent"], 1),
        "foreseen_mm": round(foreseen_mm(session, names), 1),
    }


def foreseen_mm(session: Path, names: tuple[str, ...], settings: ForesightSettings | None = None) -> float:
    """What is foreseen of some cameras of a session, mm, in the mean over the places of the persons of the truth."""
    spots, height = places_of(session)
    body = scale_body(load_body_model("girdle"), height)
    rig = open_session(session).rig.subset(names)
    return 1000 * float(foresee(rig, body, spots, settings).mean_m.mean())


def fit(table: Path) -> None:
    """Print how what is foreseen with several numbers goes with the raw errors of a table."""
    with table.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    measured = np.array([float(row["mean_error_mm"]) for row in rows])
    for flesh_std_m, angle_std_rad in product((0.01, 0.02, 0.03, 0.05), (0.2, 0.3, 0.7)):
        settings = ForesightSettings(flesh_std_m=flesh_std_m, angle_std_rad=angle_std_rad)
        foreseen = np.array(
            [foreseen_mm(_SHARED / row["session"], tuple(row["cameras"].split()), settings) for row in rows]
        )
        ratio = measured / foreseen
        alike = np.corrcoef(np.log(measured), np.log(foreseen))[0, 1]
        print(
            f"{flesh_std_m:.2f} m, {angle_std_rad:.1f} rad: errors are {ratio.mean():.2f} of what is foreseen, "
            f"{ratio.min():.2f} to {ratio.max():.2f}; correlation of logarithms {alike:.2f}",
            flush=True,
        )


def main() -> None:
    parser = session_parser(__doc__, "out/few_cameras")
    parser.add_argument("--seeds", type=int, default=1, help="runs of every set of cameras")
    parser.add_argument("--cameras", type=int, help="sets of so many cameras alone")
    parser.add_argument("--fit", action="store_true", help="choose flesh_std_m on the development table")
    options: argparse.Namespace = parser.parse_args()
    if options.fit:
        fit(RESULTS / "few_cameras_development.csv")
        return
    rows: list[Row] = []
    for name in names_of(options, DEVELOPMENT, TEST):
        session = session_of(name, options.work)
        spots, _ = places_of(session)
        sets = camera_sets(open_session(session).rig, spots.mean(axis=0))
        for words, names in [own for own in sets if options.cameras in (None, len(own[1]))]:
            for seed in range(options.seeds):
                rows.append(row_of(session, words, names, options.work, seed))
                print(rows[-1], flush=True)
    write_table("few_cameras", options, rows)


if __name__ == "__main__":
    main()
