"""Same bytes: hashes of what five short runs write, to prove that a change of the code's shape changed nothing else.

    python -m eval.same_bytes --record out/same_bytes/before.json     before the change
    python -m eval.same_bytes --against out/same_bytes/before.json    after it; exit code 1 where bytes differ

The hashes depend on the processor and on the versions of numpy, OpenCV and numba: compare them on one machine only.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from dataclasses import dataclass
from pathlib import Path

FILES = ("landmarks.csv", "tracks.csv", "pose.npz")
DEFAULT_FOLDER = Path("out/same_bytes")


@dataclass(frozen=True)
class Case:
    """One run.  scene : a scene of mocap.synth, cut to n_frames.  settings : `section.key=value`."""

    name: str
    scene: str
    n_frames: int
    preset: str = "default"
    settings: tuple[str, ...] = ()


CASES = (
    Case("demo", "demo", 24),
    Case("two-persons", "two_persons", 20),
    Case("markers", "walk_markers", 24),
    # The filters alone, as published: another path through the same rooms.
    Case("demo-reference", "demo", 24, "reference", ("pose.n_particles=100",)),
    Case("markers-reference", "walk_markers", 24, "reference_markers", ("pose.n_particles=100",)),
)


def digests(case: Case, folder: Path) -> dict[str, str]:
    """File -> SHA-256 of what a case writes.  folder : keeps the sessions from one call to the next."""
    from mocap import load_config, run_session
    from mocap.synth import synthesise
    from mocap.synth.scene import load_scene

    session = folder / "sessions" / case.scene
    if not (session / "calibration.toml").exists():
        synthesise(load_scene(case.scene).model_copy(update={"n_frames": case.n_frames}), session)
    out = folder / "runs" / case.name
    config = load_config(case.preset, ("output.formats=[]", *case.settings))
    run_session(session, out, config=config)
    return {name: hashlib.sha256((out / name).read_bytes()).hexdigest() for name in FILES}


def main(arguments: list[str] | None = None) -> int:
    """Record the hashes, or compare with recorded ones."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--record", type=Path, help="write the hashes to this file")
    what.add_argument("--against", type=Path, help="compare with the hashes in this file")
    parser.add_argument("--folder", type=Path, default=DEFAULT_FOLDER, help="sessions and runs go there")
    parser.add_argument("--only", help="cases, separated by commas: " + ", ".join(c.name for c in CASES))
    options = parser.parse_args(arguments)
    wanted = options.only.split(",") if options.only else [c.name for c in CASES]
    if unknown := set(wanted) - {c.name for c in CASES}:
        parser.error(f"no case is named {', '.join(sorted(unknown))}")
    found = {case.name: digests(case, options.folder) for case in CASES if case.name in wanted}
    if options.record:
        options.record.parent.mkdir(parents=True, exist_ok=True)
        options.record.write_text(json.dumps(found, indent=1) + "\n", "utf-8")
        return 0
    before = json.loads(options.against.read_text("utf-8"))
    other = [
        f"{name}: {file}"
        for name, files in found.items()
        for file in files
        if files[file] != before.get(name, {}).get(file)
    ]
    print("\n".join([f"differs: {o}" for o in other] or [f"same bytes in {len(found)} runs"]))
    return int(bool(other))


if __name__ == "__main__":
    sys.exit(main())
