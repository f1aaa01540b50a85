"""How well are cameras placed from nothing by a person who walks? Draws of cameras and stretches, against the truth.

    python -m eval.place_rig                    # development scenes
    python -m eval.place_rig --test             # the scenes kept for the final judgement
    python -m eval.place_rig SESSION [...]      # sessions with an exact calibration and truth/truth.json

Of every session all cameras and the whole clip, and --draws of 3 to 7 cameras of it over two thirds of the clip. The
lenses and the height of the tallest person in shoes are given, where cameras stand is not. Angles between pairs of
cameras; places after the best fit of the whole rig; `scale` what the rig is too small by; `up_deg` the tilt of the
world and `floor_mm` where its floor is; `told` the share of places within 2.5 of the stated deviations; `walks_at` the
share of the stated height that the tallest moments have as the exact cameras see them. A refusal of `mocap calibrate
--place` is a row with its reason. Writes eval/results/place_rig_{development,test}.csv (--name: another name).
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from eval.refine_rig import WITHIN, Seen, errors, place_errors
from eval.session_tables import Row, names_of, session_of, session_parser, write_table
from mocap.data import CameraRig
from mocap.errors import MocapError
from mocap.io.session import Session, open_session
from mocap.pipeline.refine import look_at, placed_from
from mocap.volume.rig_refinement import meetings, walking_height_m

DEVELOPMENT = ("walk",)
TEST = ("walk_final", "jog_test", "walk_test")
_STRETCH = 2 / 3


def stated_height_m(root: Path) -> float:
    """Of the tallest person, in shoes and hair."""
    persons = json.loads((root / "truth" / "truth.json").read_text("utf-8"))["persons"]
    return max(float(p.get("clothed_height_m", p["height_m"])) for p in persons)


def drawn(session: Session, seen: Seen, draw: int) -> tuple[Session, Seen]:
    """Some cameras and some frames of a session; draw 0 has all."""
    hulls, stride = seen
    if draw == 0:
        return session, seen
    rng = np.random.default_rng([draw, *session.root.name.encode()])
    n = len(session.rig)
    kept = sorted(rng.choice(n, size=rng.integers(min(3, n), n + 1), replace=False))
    length = round(_STRETCH * len(hulls[0]))
    begin = int(rng.integers(0, len(hulls[0]) - length + 1))
    rig = session.rig.subset([session.rig.names[k] for k in kept])
    return replace(session, rig=rig), ([hulls[k][begin : begin + length] for k in kept], stride)


def evaluate(session: Session, seen: Seen, draw: int) -> Row:
    """One draw of one session."""
    truth: CameraRig = session.rig
    height = stated_height_m(session.root)
    row: Row = {"session": session.root.name, "draw": draw, "cameras": len(truth), "frames": len(seen[0][0])}
    exact = meetings(truth, seen[0])
    row["walks_at"] = round(walking_height_m(exact.points, exact.frames) / height, 4)
    try:
        placed = placed_from(session, *seen, height)
    except MocapError as error:
        empty = dict.fromkeys([*errors(truth, truth, "placed"), "up_deg", "floor_mm", "stated_mm", "told"])
        return row | empty | {"refused": error.message}
    ups = [
        np.degrees(np.arccos(np.clip(a.R[:, 2] @ b.R[:, 2], -1, 1)))
        for a, b in zip(placed.rig, truth, strict=True)
    ]
    raised = [a.center[2] - b.center[2] for a, b in zip(placed.rig, truth, strict=True)]
    stated = np.sqrt(3) * np.array([m.shift_std_m for m in placed.refinement.moves.values()])
    return (
        row
        | errors(placed.rig, truth, "placed")
        | {
            "up_deg": round(float(np.mean(ups)), 2),
            "floor_mm": round(1000 * float(np.mean(raised)), 1),
            "stated_mm": round(1000 * float(stated.mean()), 1),
            "told": round(float((place_errors(placed.rig, truth)[0] < WITHIN * stated).mean()), 2),
            "refused": None,
        }
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the table."""
    parser = session_parser(__doc__, "out/refine_rig")
    parser.add_argument("--draws", type=int, default=20, help="beside the whole of each session")
    options = parser.parse_args(arguments)
    rows = []
    for name in names_of(options, DEVELOPMENT, TEST):
        session = open_session(session_of(name, options.work))
        seen = look_at(session, n_threads=1)
        for draw in range(options.draws + 1):
            rows.append(evaluate(*drawn(session, seen, draw), draw))
            print(rows[-1], flush=True)
    write_table("place_rig", options, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
