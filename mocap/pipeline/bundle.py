"""A bundle: what somebody who looks for a mistake needs of a run, in one file, without pictures and without paths.

Names of persons are not in results; what is left out are masks, volumes and pictures (store.zarr, report.html,
scene.rrd) and, in every text, the folders of the user.
"""

from __future__ import annotations

import io
import json
import os
import re
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path

from mocap.errors import MocapError
from mocap.io._files import writing
from mocap.pipeline.doctor import examine
from mocap.pipeline.outside import check_outside
from mocap.pipeline.publish import RUN_FILE

_TABLES = (
    "landmarks.csv",
    "angles.csv",
    "contacts.csv",
    "steps.csv",
    "cycles.csv",
    "moves.csv",
    "tracks.csv",
    "scores.json",
    "pose.npz",
)
_BODIES = "body*.toml"
# Of the store only what says how it was made: keys, settings, sizes.
_DESCRIPTIONS = ("zarr.json", "files.json")
# An absolute path of Unix or Windows, at the beginning of a word: all of it but its last name goes.
_ABSOLUTE = re.compile(
    r"""(?<![\w$.:/\\-])(?:[A-Za-z]:[\\/]+|/)(?:[^\s"'<>|:;,/\\][^"'<>|:;,/\\\n]*[\\/]+)+([^\s"'<>|:;,/\\]*)"""
)
_README = """What this file holds, for whoever looks for a mistake in a run of `mocap`:

run.json      settings, versions, timings, warnings, scores
doctor.txt    what `mocap doctor` said of the machine when this file was made
*.csv, *.npz  tracks and poses: numbers, no pictures
body*.toml    the sizes of the persons
store/        keys and sizes of the products of the stages, without their content
session/      calibration and session.toml

Pictures, masks and volumes are not in it. Folders of the user are written as $HOME, $SESSION, $OUT and $TMP.
"""


def write_bundle(out: Path, path: Path, session: Path | None = None) -> list[str]:
    """Write the bundle of a run's output folder; gives the names in it.

    session : its calibration and session.toml come along. Raises MocapError when `out` holds no run, and
    for a file in a session.
    """
    check_outside(path, *(() if session is None else (session,)))
    if not (out / RUN_FILE).is_file():
        raise MocapError(
            "there is no run in this folder", path=out, remedy="give the output folder of `mocap run`"
        )
    places = _places(out, session)
    found = {"README.txt": _README.encode(), "doctor.txt": _doctor()}
    for file in [out / RUN_FILE, *(out / name for name in _TABLES), *sorted(out.glob(_BODIES))]:
        if file.is_file():
            found[file.name] = file.read_bytes()
    store = out / "store.zarr"
    for name in _DESCRIPTIONS:
        for file in sorted(store.glob(f"*/{name}")):
            found[f"store/{file.parent.name}/{name}"] = file.read_bytes()
    if session is not None:
        for file in sorted(session.glob("*.toml")):
            found[f"session/{file.name}"] = file.read_bytes()
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in found.items():
            archive.writestr(name, content if name.endswith(".npz") else without_places(content, places))
    with writing(path):
        path.write_bytes(buffer.getvalue())
    return list(found)


def _doctor() -> bytes:
    return "".join(f"{f.verdict:>8}  {f.what}: {f.text}\n" for f in examine()).encode()


def _places(out: Path, session: Path | None) -> dict[str, str]:
    """Folders of the user -> what stands in their place; longer ones first."""
    places = {str(Path(tempfile.gettempdir()).resolve()): "$TMP", str(Path.home().resolve()): "$HOME"}
    places[str(out.resolve())] = "$OUT"
    if session is not None:
        places[str(session.resolve())] = "$SESSION"
    places |= {os.path.abspath(place): word for place, word in list(places.items())}
    known = {place: word for place, word in places.items() if len(place) > 1}
    return dict(sorted(known.items(), key=lambda item: -len(item[0])))


def without_places(content: bytes, places: Mapping[str, str]) -> bytes:
    """A text without the folders of the user: known ones by their word, of other absolute paths only the last name."""
    text = content.decode("utf-8", "replace")
    for place, word in places.items():
        # In JSON a backslash is written twice.
        for written in (place, json.dumps(place)[1:-1]):
            text = text.replace(written, word)
    return _ABSOLUTE.sub(lambda found: f"$ELSEWHERE/{found.group(1)}", text).encode()
