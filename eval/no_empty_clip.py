"""What a clip of the empty scene is worth: masks and poses with it, and with the background of the recording itself.

    python -m eval.no_empty_clip                       # development scenes
    python -m eval.no_empty_clip --test                # the scenes kept for the final judgement
    python -m eval.no_empty_clip SESSION [SESSION ...] # sessions with truth/ and background/

Each session is run with segmentation.background = clip, median and recording; IoU is of all pixels of all cameras with
the true silhouettes. Writes eval/results/no_empty_clip_{development,test}.csv; --name gives the table another name.
--masks ends the runs after the masks. Synthesises what is not in --work yet (a minute a scene).
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from eval.occlusion import prepared
from eval.segmentation import true_silhouettes
from eval.whole import write_csv
from mocap.io.session import Session, open_session
from mocap.io.store import StageStore
from mocap.pipeline.config import load_config
from mocap.pipeline.run import run_session
from mocap.products.masks import read_masks

RESULTS = Path(__file__).with_name("results")
DEVELOPMENT = ("gesture", "gesture_noisy", "box", "stand", "in_place", "in_place_alike", "walk")
TEST = (
    "gesture_test",
    "gesture_noisy_test",
    "box_final",
    "in_place_test",
    "in_place_alike_test",
    "walk_test",
)
SOURCES = ("clip", "median", "recording")
FIELDS = ("mean_error_mm", "mean_error_after_offset_mm", "mmta_percent")
Row = dict[str, str | float | int | None]


def evaluate(root: Path, work: Path, source: str, seed: int, until: str) -> Row:
    """One run of a session, judged.  source : of segmentation.background.  until : stage after which it ends."""
    out = work / "runs" / f"{root.name}_{source}_{seed}"
    config = load_config("default", ("output.formats=[]", f"segmentation.background={source}"))
    session = open_session(root)
    run_session(root, out, config=config, seed=seed, until=until)
    ious = mask_ious(session, out)
    scores = json.loads((out / "run.json").read_text(encoding="utf-8")).get("scores") or {}
    return {
        "session": root.name,
        "background": source,
        "seed": seed,
        "mask_iou": round(float(ious[-1]), 4),
        "worst_camera_iou": round(float(ious[:-1].min()), 4),
        **{name: None if scores.get(name) is None else round(scores[name], 1) for name in FIELDS},
    }


def mask_ious(session: Session, out: Path) -> NDArray[np.float64]:
    """IoU of the stored masks with the true silhouettes: of each camera, then of all together."""
    counts = np.zeros((len(session.rig), 2))
    truth = true_silhouettes(session)
    for (_, masks), (_, true) in zip(read_masks(StageStore(out / "store.zarr"), session), truth, strict=True):
        for row, mask, own in zip(counts, masks, true, strict=True):
            row += np.count_nonzero(mask & own), np.count_nonzero(mask | own)
    hit, all_of = np.vstack([counts, counts.sum(axis=0)]).T
    return np.asarray(hit / np.maximum(all_of, 1))


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m eval.no_empty_clip", description=__doc__)
    parser.add_argument("sessions", nargs="*", type=Path, help="session folders; the scenes when absent")
    parser.add_argument("--work", type=Path, default=Path("out/no_empty_clip"), help="for sessions and runs")
    parser.add_argument("--test", action="store_true", help="the scenes kept for the final judgement")
    parser.add_argument("--masks", action="store_true", help="masks alone, no poses")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--name", help="of the table; development or test when absent")
    options = parser.parse_args(argv)
    scenes = TEST if options.test else DEVELOPMENT
    sessions = options.sessions or [prepared(name, options.work, with_furniture=True) for name in scenes]
    until = "segment" if options.masks else "report"
    rows: list[Row] = []
    for root in sessions:
        for source in SOURCES:
            for seed in range(options.seeds):
                rows.append(evaluate(root, options.work, source, seed, until))
                print(", ".join(f"{k} {v}" for k, v in rows[-1].items()), flush=True)
    path = RESULTS / f"no_empty_clip_{options.name or ('test' if options.test else 'development')}.csv"
    write_csv(path, list(rows[0]), rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
