"""Whether memory grows with the length of a recording: the same motion to and fro, once short and once long.

    python -m eval.long_recording [--frames 1200,3600] [--work out/long]     # ten minutes

Runs a session (pictures of a scene of 40 frames, linked again and again) from pictures to outputs in a
process of its own, for every length and with all exports, and gives the peak of its memory, the size of what it wrote,
and what an hour at 30 frames/s would take at that growth. Writes eval/results/long_recording.csv.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from eval.whole import write_csv
from mocap.io.session import open_session
from mocap.synth import synthesise
from mocap.synth.scene import load_scene, scene_from_dict

RESULTS = Path(__file__).with_name("results") / "long_recording.csv"
N_SCENE, SIZE, HOUR_FRAMES = 40, (160, 120), 108_000


def looped(scene: Path, folder: Path, n: int) -> Path:
    """A session of n frames that shows the scene's forwards and backwards by turns."""
    if (folder / "session.toml").exists():
        return folder
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name in ("session.toml", "background"):
        (folder / name).symlink_to(scene / name)
    for path in scene.glob("calibration.*"):
        (folder / path.name).symlink_to(path)
    for camera in sorted((scene / "images").iterdir()):
        pictures = sorted(camera.iterdir())
        there_and_back = [*pictures, *pictures[-2:0:-1]]
        (folder / "images" / camera.name).mkdir(parents=True)
        for i in range(n):
            link = folder / "images" / camera.name / f"{i:06d}.jpg"
            link.symlink_to(there_and_back[i % len(there_and_back)])
    return folder


def measure(session: Path, out: Path, n: int) -> dict[str, Any]:
    """One run in a process of its own."""
    command = [sys.executable, "-m", "mocap", "run", str(session), "-o", str(out), "--preset", "realtime"]
    settings = ["volume.voxel_size_m=0.03", "output.keep=nothing"]
    more = [word for setting in settings for word in ("--set", setting)]
    subprocess.run([*command, *more], check=True, stdout=subprocess.DEVNULL)
    run = json.loads((out / "run.json").read_text(encoding="utf-8"))
    size = {path.name: path.stat().st_size for path in out.iterdir() if path.is_file()}
    return {
        "frames": n,
        "peak_memory_mb": round(float(run["peak_memory_mb"])),
        "report_mb": round(size.get("report.html", 0) / 1e6, 2),
        "files_mb": round(sum(size.values()) / 1e6, 2),
    }


def with_growth(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows, and a last one for an hour, on the line through the first and the last."""
    first, last = rows[0], rows[-1]
    hour: dict[str, Any] = {"frames": HOUR_FRAMES}
    for name in list(first)[1:]:
        slope = (last[name] - first[name]) / (last["frames"] - first["frames"])
        hour[name] = round(last[name] + slope * (HOUR_FRAMES - last["frames"]))
    return [{"what": "measured", **row} for row in rows] + [{"what": "an hour, on that line", **hour}]


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", default="1200,3600", help="lengths, ascending")
    parser.add_argument("--work", type=Path, default=Path("out/long"), help="folder for sessions and runs")
    options = parser.parse_args(argv)
    source = options.work.resolve() / "scene"
    if not (source / "session.toml").exists():
        scene = load_scene("walk").model_dump(mode="json")
        rig = {**scene["rig"], "size_px": list(SIZE)}
        picture = {**scene["picture"], "container": "jpg"}
        synthesise(scene_from_dict({**scene, "n_frames": N_SCENE, "rig": rig, "picture": picture}), source)
    rows = []
    for n in (int(word) for word in options.frames.split(",")):
        session = looped(source, options.work.resolve() / f"session_{n}", n)
        assert len(open_session(session).frames) == n
        rows.append(measure(session, options.work / f"out_{n}", n))
        print(rows[-1], flush=True)
    rows = with_growth(rows)
    write_csv(RESULTS, list(rows[0]), rows)
    print(rows[-1], f"written: {RESULTS}", sep="\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
