"""One line per scene, voxel size and method, kept in a CSV file that survives a stop."""

from __future__ import annotations

import ast
import csv
import dataclasses
import hashlib
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from eval.tracking import hulls as H
from eval.tracking.methods import Method, Outcome, observations, run_method
from mocap.metrics import identity_scores, tracking_scores

STORE = H.WORK / "runs.csv"
KEY = ("code", "scene", "voxel_cm", *(f.name for f in dataclasses.fields(Method)))
COUNTS = ("n_objects", "n_matches", "misses", "false_positives", "mismatches")
VALUES = (
    *COUNTS,
    "frames",
    "distance_m",
    "head_distance_m",
    "hota_percent",
    "deta_percent",
    "assa_percent",
    "idf1_percent",
    "step_s",
)
N_RUNS = 2  # for the clock, of the trackers as mocap runs them
Row = dict[str, str]


@cache
def tracking_code() -> str:
    """Hash of what mocap.tracking does: comments, docstrings and layout do not count."""
    digest = hashlib.sha256()
    folder = H.ROOT / "mocap" / "tracking"
    for path in sorted([*folder.glob("*.py"), *folder.glob("*.toml")]):
        text = path.read_text("utf-8")
        if path.suffix == ".py":
            tree = ast.parse(text)
            for node in ast.walk(tree):
                body = getattr(node, "body", None)
                if isinstance(body, list):
                    # A text that stands alone is a docstring.
                    kept = [
                        b for b in body if not (isinstance(b, ast.Expr) and isinstance(b.value, ast.Constant))
                    ]
                    node.body = kept  # type: ignore[attr-defined]
            text = ast.dump(tree)
        digest.update(f"{path.name} {text}".encode())
    return digest.hexdigest()[:10]


def key_of(scene: str, voxel_cm: int, method: Method) -> tuple[str, ...]:
    """What tells a line from all others."""
    return (tracking_code(), scene, str(voxel_cm), *(str(v) for v in dataclasses.astuple(method)))


def scored(outcome: Outcome, clip: H.HullClip) -> Row:
    """The values of a line: sums over the frames, so that scenes can be added up."""
    frames = clip.frames
    clear = tracking_scores(outcome.tracks, clip.truth, frames=frames)
    who = identity_scores(outcome.tracks, clip.truth, frames=frames)
    row = {name: str(getattr(clear, name)) for name in COUNTS}
    heads = tracking_scores(outcome.tracks, clip.heads, frames=frames) if clip.heads is not None else None
    row |= {
        "frames": str(len(frames)),
        "distance_m": f"{(clear.motp_mm or 0.0) / 1000 * clear.n_matches:.6f}",
        "head_distance_m": ""
        if heads is None or heads.motp_mm is None
        else f"{heads.motp_mm / 1000 * clear.n_matches:.6f}",
        "step_s": f"{outcome.step_s:.6f}",
    }
    for name in ("hota_percent", "deta_percent", "assa_percent", "idf1_percent"):
        value = getattr(who, name)
        row[name] = "" if value is None else f"{value:.3f}"
    return row


def run_all(
    wanted: Sequence[tuple[str, int, Method]], *, work: Path = H.WORK, store: Path = STORE, show: bool = True
) -> list[Row]:
    """The lines of all wanted (scene, voxel size, method), computed where the file does not have them yet."""
    done = {tuple(row[k] for k in KEY): row for row in read_rows(store)}
    clips: dict[tuple[str, int, int], list[Method]] = {}
    for scene, cm, method in dict.fromkeys(wanted):
        if key_of(scene, cm, method) not in done:
            clips.setdefault((scene, cm, method.on_cm), []).append(method)
    for (scene, cm, on_cm), methods in clips.items():
        clip = H.load_hulls(scene, cm, work)
        seen, _ = observations(clip, on_cm)
        for method in methods:
            n_runs = N_RUNS if method.settings == "product" else 1
            outcome = run_method(method, seen, clip, n_runs=n_runs)
            row = dict(zip(KEY, key_of(scene, cm, method), strict=True)) | scored(outcome, clip)
            append_row(row, store)
            done[tuple(row[k] for k in KEY)] = row
            if show:
                total = pooled([row])
                where = f"{scene} {cm} cm, tracked on {on_cm or cm} cm"
                what = (
                    f"{method.label} {method.settings} {method.tree} N={method.n_samples} seed {method.seed}"
                )
                print(
                    f"{where}: {what}: MOTA {total['mota_percent']:.2f} MOTP {total['motp_mm']:.1f} "
                    f"mismatches {row['mismatches']} {total['step_ms']:.2f} ms",
                    flush=True,
                )
    return [done[key_of(*one)] for one in wanted]


def pooled(rows: Iterable[Row]) -> dict[str, float]:
    """Scores of several lines together, weighted as one long sequence would be; NaN where undefined.

    HOTA, its parts and IDF1 are means of the lines weighted by persons times frames.  step_ms : per person and frame.
    Source: CF Eq. 4.22-4.23, 4.26.
    """
    rows = list(rows)

    def total(name: str) -> float:
        return float(sum(float(r[name] or 0) for r in rows))

    def mean(name: str) -> float:
        known = [(float(r[name]), float(r["n_objects"])) for r in rows if r[name]]
        if not known:
            return np.nan
        values, weights = zip(*known, strict=True)
        return float(np.average(values, weights=weights))

    n, matches = total("n_objects") or np.nan, total("n_matches") or np.nan
    heads_known = all(r["head_distance_m"] for r in rows)
    wrong = total("misses") + total("false_positives") + total("mismatches")
    per_cent = {k: 100 * total(k) / n for k in ("misses", "false_positives", "mismatches")}
    return {
        "mota_percent": 100 * (1 - wrong / n),
        "motp_mm": 1000 * total("distance_m") / matches,
        "head_mm": 1000 * total("head_distance_m") / matches if heads_known else np.nan,
        "misses_percent": per_cent["misses"],
        "false_positives_percent": per_cent["false_positives"],
        "mismatches_percent": per_cent["mismatches"],
        "mismatches": total("mismatches"),
        "hota_percent": mean("hota_percent"),
        "deta_percent": mean("deta_percent"),
        "assa_percent": mean("assa_percent"),
        "idf1_percent": mean("idf1_percent"),
        "step_ms": 1000 * total("step_s") / n,
        "n_objects": n,
        "n_rows": float(len(rows)),
    }


def read_rows(path: Path = STORE) -> list[Row]:
    """All lines of the file; a last line that was cut off is left out."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return [row for row in csv.DictReader(file) if row.get("step_s")]


def append_row(row: Row, path: Path = STORE) -> None:
    """Add a line."""
    is_new = not path.exists()
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", newline="", encoding="utf-8") as file:
        out = csv.DictWriter(file, (*KEY, *VALUES), lineterminator="\n")
        if is_new:
            out.writeheader()
        out.writerow(row)
