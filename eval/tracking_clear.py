"""MOTP and MOTA of the trackers on the meeting scenes: CF Figures 4.11 and 4.14, Tables 4.3 and 4.4.

    python -m eval.tracking_clear                     # development scenes
    python -m eval.tracking_clear --test              # the scenes kept for the final judgement
    python -m eval.tracking_clear --seeds 5 --only summary

Needs the hulls of `python -m eval.tracking_scenes`. Finished lines are kept in out/tracking/runs.csv and made anew when
the trackers change. Writes eval/results/tracking_{table,summary,creation}_{development,test}.csv; the page and the
pictures are made by `python -m eval.tracking_page`.

- table: the trackers as published, over voxel size, number of samples and colour (CF Table 4.3, Figure 4.11).
- summary: the trackers as `mocap` runs them, scene by scene and all together (CF Table 4.4).
- creation: other person classifiers in the creation and deletion of tracks (CF 4.4.2: they drive MOTA).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from eval.tracking import hulls as H
from eval.tracking.methods import TREES, Method, observations, run_method
from eval.tracking.pictures import floor_plan
from eval.tracking.runs import Row, pooled, run_all
from eval.whole import write_csv

RESULTS = Path(__file__).with_name("results")
N_SPARSE = (50, 200, 800)
N_PARTICLES = (10, 50, 100)
ON_CM = (0, 5)
PARTS = ("summary", "table", "creation")
SCORES = (
    "mota_percent", "motp_mm", "head_mm", "misses_percent", "false_positives_percent", "mismatches_percent",
    "mismatches", "hota_percent", "deta_percent", "assa_percent", "idf1_percent", "step_ms", "n_objects", "n_rows",
)  # fmt: skip
Cells = dict[tuple[str, ...], list[tuple[str, int, Method]]]


def table_cells(scenes: Sequence[str], seeds: Sequence[int]) -> Cells:
    """CF Table 4.3: voxel size, method, number of samples; the published settings."""
    out: Cells = {}
    for cm in H.VOXEL_CM:
        methods = [Method("naive", settings="published")]
        for tracker, counts in (("sparse", N_SPARSE), ("particle", N_PARTICLES)):
            methods += [
                Method(tracker, n, colour, seed, "published")
                for n in counts
                for colour in (False, True)
                for seed in seeds
            ]
        for method in methods:
            cell = (str(cm), method.label if method.tracker != "naive" else "Naive", str(method.n_samples))
            out.setdefault(cell, []).extend((scene, cm, method) for scene in scenes)
    return out


def summary_cells(scenes: Sequence[str], seeds: Sequence[int]) -> Cells:
    """CF Table 4.4: the product's settings, every scene; hulls of 2 cm, tracked on these and on coarser voxels."""
    out: Cells = {}
    for scene in scenes:
        for on_cm in ON_CM:
            for tracker in ("naive", "particle", "sparse"):
                for colour in (False, True):
                    for seed in seeds if tracker != "naive" else (0,):
                        method = Method(tracker, 0, colour, seed, on_cm=on_cm)
                        out.setdefault((scene, str(on_cm or 2), method.label), []).append((scene, 2, method))
    return out


def creation_cells(scenes: Sequence[str], seeds: Sequence[int]) -> Cells:
    """Other classifiers in the same trackers, tracked on 5 cm."""
    return {
        (Method(tracker, 0, True).label, tree): [
            (scene, 2, Method(tracker, 0, True, seed, on_cm=5, tree=tree))
            for scene in scenes
            for seed in (seeds if tracker != "naive" else (0,))
        ]
        for tracker in ("naive", "particle", "sparse")
        for tree in TREES
    }


def run_cells(cells: Cells) -> dict[tuple[str, ...], list[Row]]:
    """The lines of every cell; whatever shares a clip is run together."""
    wanted = sorted({one for own in cells.values() for one in own}, key=lambda one: (one[0], one[1]))
    rows = dict(zip(wanted, run_all(wanted), strict=True))
    return {cell: [rows[one] for one in own] for cell, own in cells.items()}


def draw_paths(scenes: Sequence[str], which: str) -> None:
    """eval/results/tracking_paths_WHICH.png: tracks of sparse sampling with colour over the truth."""
    panels = []
    for scene in scenes:
        clip = H.load_hulls(scene, 2)
        method = Method("sparse", colour=True, on_cm=5)
        found = run_method(method, observations(clip, 5)[0], clip)
        panels.append((scene, found.tracks, clip.truth, H.furniture_of(scene)))
    if panels:
        floor_plan(panels, RESULTS / f"tracking_paths_{which}.png")


def write(path: Path, names: Sequence[str], found: dict[tuple[str, ...], list[Row]]) -> None:
    """A line per cell, scores pooled over scenes and seeds."""
    lines = []
    for cell, rows in found.items():
        scores = pooled(rows)
        said = {k: f"{scores[k]:.4g}" if k != "n_objects" else f"{scores[k]:.0f}" for k in SCORES}
        lines.append(dict(zip(names, cell, strict=True)) | said)
    write_csv(path, [*names, *SCORES], lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is missing and write the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--test", action="store_true", help="the test scenes instead of the development scenes"
    )
    parser.add_argument("--seeds", type=int, default=2, help="runs of the random trackers")
    parser.add_argument("--only", choices=PARTS, nargs="*", default=PARTS)
    parser.add_argument("--scenes", nargs="*", help="of the chosen set only these scenes")
    chosen = parser.parse_args(arguments)
    which = "test" if chosen.test else "development"
    short: Sequence[str] = H.TEST if chosen.test else H.DEVELOPMENT
    long: Sequence[str] = H.LONG_TEST if chosen.test else H.LONG_DEVELOPMENT
    extra: Sequence[str] = (*H.SMALL_TEST, *H.LOW_TEST)
    if not chosen.test:
        extra = (*H.SMALL_DEVELOPMENT, *H.LOW_DEVELOPMENT, *H.OTHERS)
    seeds = tuple(range(chosen.seeds))
    if chosen.scenes:
        short, long, extra = ([s for s in own if s in chosen.scenes] for own in (short, long, extra))
    scenes = [s for s in short if H.is_made(s)]
    others = [s for s in (*long, *extra) if H.is_made(s, (2,))]
    three = H.THREE_TEST if chosen.test else H.THREE_DEVELOPMENT
    three = tuple(s for s in three if H.is_made(s, (2,)) and not chosen.scenes)
    for scene in (*short, *long, *extra):
        if scene not in scenes and scene not in others:
            print(f"{scene} has not been made and is left out", flush=True)
    RESULTS.mkdir(exist_ok=True)
    tables: dict[str, tuple[Sequence[str], Callable[[], Cells]]] = {
        "summary": (
            ("scene", "voxel_cm", "method"),
            lambda: summary_cells([*scenes, *others, *three], seeds),
        ),
        "table": (("voxel_cm", "method", "n"), lambda: table_cells(scenes, seeds)),
        "creation": (("method", "tree"), lambda: creation_cells(scenes, seeds)),
    }
    for name in chosen.only:
        fields, cells = tables[name]
        found = run_cells(cells())
        if name == "summary":
            together: dict[tuple[str, ...], list[Row]] = {}
            for (scene, cm, label), rows in found.items():
                if scene in (*scenes, *three):
                    all_of = "all" if scene in scenes else "three"
                    together.setdefault((all_of, cm, label), []).extend(rows)
            found = together | {cell: rows for cell, rows in found.items() if cell[0] not in three}
            draw_paths([s for s in scenes if "_03" in s or "crossing" in s], which)
        write(RESULTS / f"tracking_{name}_{which}.csv", fields, found)
    return 0


if __name__ == "__main__":
    sys.exit(main())
