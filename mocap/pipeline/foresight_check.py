"""What can be expected of where the cameras of a session stand, for `mocap check`."""

from __future__ import annotations

import numpy as np

from mocap.arrays import Array
from mocap.body import load_body_model, scale_body
from mocap.data import CameraRig
from mocap.io.session import Session
from mocap.io.session.record import Finding
from mocap.pose.deviation import landmark_kind
from mocap.pose.foresight import Foresight, foresee, next_camera, sees_whole
from mocap.volume import look_at_point

# Somebody of average height, where nobody is known.
_HEIGHT_M = 1.75
_CELL_M, _N_PLACES = 0.25, 5
# More cameras than this are not said to need another one.
_MANY = 5


def check_foresight(session: Session) -> list[Finding]:
    """How far off landmarks will be by where the cameras stand, and with few cameras where one more tells most."""
    rig = session.rig
    height_m = session.person_height_m or _HEIGHT_M
    places = whole_places(rig, height_m)
    if not len(places):
        return []  # that nothing is seen in common is said elsewhere
    body = scale_body(load_body_model("girdle"), height_m)
    middle = places[np.linalg.norm(places - places.mean(axis=0), axis=1).argmin()]
    found = foresee(rig, body, np.vstack([middle, _apart(places, middle)]))
    out = [Finding("ok", _words(found))]
    if len(rig) <= _MANY:
        camera, deviation_m = next_camera(rig, body, middle)
        x, y = np.round(camera.center[:2], 1) + 0.0  # no minus before a zero
        out.append(
            Finding(
                "ok",
                f"one more camera would tell most at x {x:.1f}, y {y:.1f} m: {1000 * found.mean_m[0]:.0f} mm in the "
                f"middle would become {1000 * deviation_m:.0f}",
            )
        )
    return out


def whole_places(rig: CameraRig, height_m: float) -> Array:
    """Places (P, 2) m of the floor where somebody is seen from head to foot by most cameras, two at least."""
    centers = np.array([camera.center[:2] for camera in rig])
    # Cameras at one side enclose nothing: people are also at the other side of what they look at.
    around = np.concatenate([centers, 2.0 * look_at_point(rig)[:2] - centers])
    low, high = around.min(axis=0), around.max(axis=0)
    axes = [
        np.linspace(a, b, max(2, min(60, round((b - a) / _CELL_M)))) for a, b in zip(low, high, strict=True)
    ]
    cells = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    n_seeing = np.sum([sees_whole(camera, cells, height_m) for camera in rig], axis=0)
    most = int(n_seeing.max())
    return np.asarray(cells[n_seeing == most]) if most >= 2 else np.zeros((0, 2))


def _apart(places: Array, middle: Array) -> Array:
    """Some of the places, each as far as can be from those before it."""
    chosen = [middle]
    for _ in range(min(_N_PLACES, len(places)) - 1):
        away = np.min([np.linalg.norm(places - one, axis=1) for one in chosen], axis=0)
        chosen.append(places[away.argmax()])
    return np.array(chosen[1:]).reshape(-1, 2)


def _words(found: Foresight) -> str:
    by_kind = {
        f"{kind}s" if len(rows) > 1 else kind: 1000 * float(np.sqrt((found.deviation_m[0, rows] ** 2).mean()))
        for kind, rows in _rows_of_kinds(found.names).items()
    }
    told = ", ".join(f"{kind} {mm:.0f}" for kind, mm in sorted(by_kind.items(), key=lambda one: one[1]))
    low, high = 1000 * found.mean_m.min(), 1000 * found.mean_m.max()
    spread = f", {low:.0f} to {high:.0f} from place to place" if high - low > 1 else ""
    return (
        f"by where the cameras stand, landmarks can be expected {1000 * found.mean_m[0]:.0f} mm off in the middle"
        f" ({told}){spread}"
    )


def _rows_of_kinds(names: tuple[str, ...]) -> dict[str, list[int]]:
    """Rows of the landmarks of each kind: both knees are of one."""
    rows: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        rows.setdefault(landmark_kind(name), []).append(i)
    return rows
