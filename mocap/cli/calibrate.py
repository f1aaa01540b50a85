"""Cameras from a board: `mocap board` prints one, `mocap calibrate` solves for the cameras that filmed it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mocap.cli.options import check_choice
from mocap.cli.progress import progress_bar
from mocap.errors import MocapError

if TYPE_CHECKING:
    from mocap.calibrate import Board, Lens, LensModel, WorldPoints

BoardOption = Annotated[
    str,
    typer.Option(
        "--board",
        help="9x6: a checkerboard by its inner corners, columns x rows; charuco:8x6 (squares); aprilgrid:6x4 (tags).",
    ),
]


def board(
    out: Annotated[Path, typer.Option("-o", "--out", help="PDF to write.")],
    board: BoardOption = "charuco:8x6",
    square_mm: Annotated[
        float | None,
        typer.Option(
            "--square-mm", min=1.0, max=1000.0, help="Side of a square or tag, mm; else as large as fits."
        ),
    ] = None,
    paper: Annotated[str, typer.Option("--paper", help="a4, a3, a2, a1, a0, letter or tabloid.")] = "a4",
) -> None:
    """Print a calibration board, with a ruler that shows whether the printer scaled it."""
    from mocap.calibrate.board import board_from_text
    from mocap.calibrate.printed import PAPERS, largest_side_mm, write_board

    check_choice("--paper", paper, PAPERS)
    largest = largest_side_mm(board_from_text(board, 1.0), paper)
    if largest < 1:
        raise MocapError(
            f"the board {board} does not fit on {paper}", remedy="choose fewer squares or a larger --paper"
        )
    printed = board_from_text(board, square_mm or largest)
    write_board(out, printed, paper)
    side = "tags" if printed.kind == "aprilgrid" else "squares"
    typer.echo(
        f"{out}: {printed}, {side} of {1000 * printed.side_m:g} mm. Print at 100 % and measure the ruler."
    )
    typer.echo(
        f"Then: mocap calibrate CLIPS -o calibration.toml --board {board} --square-mm {1000 * printed.side_m:g} "
        "--floor-frame N"
    )


def calibrate(
    clips: Annotated[
        Path,
        typer.Argument(metavar="BOARD", help="Folder with one clip of the board per camera, synchronised."),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="calibration.toml to write.")],
    board: BoardOption,
    square_mm: Annotated[
        float, typer.Option("--square-mm", min=1.0, max=1000.0, help="Side of a square or tag, measured, mm.")
    ],
    floor_frame: Annotated[
        int | None,
        typer.Option("--floor-frame", min=0, help="Frame in which the board lies flat on the floor."),
    ] = None,
    points: Annotated[
        Path | None,
        typer.Option("--points", help="Instead: CSV of known places, camera,u_px,v_px,x_m,y_m,z_m."),
    ] = None,
    lenses: Annotated[
        Path | None,
        typer.Option(
            "--lenses",
            help="Lenses that are kept: a calibration file, or a folder of other clips of the board.",
        ),
    ] = None,
    lens: Annotated[
        str, typer.Option("--lens", help="radial (two terms), tangential (and decentring) or fisheye.")
    ] = "radial",
    frames: Annotated[int, typer.Option("--frames", min=6, help="Frames to look at, spread evenly.")] = 60,
) -> None:
    """Lenses and places of the cameras from clips of a board that they all film; OUT.html says how good they are."""
    from mocap.calibrate import board_from_text, find_board_views, find_clips
    from mocap.calibrate import calibrate as solve
    from mocap.calibrate.lens import MODELS
    from mocap.calibrate.page import write_page
    from mocap.calibrate.uncertainty import uncertainty_map
    from mocap.calibrate.views import board_in_place_of
    from mocap.io.calibration import write_calibration

    check_choice("--lens", lens, MODELS)
    model: LensModel = lens  # type: ignore[assignment]
    target = board_from_text(board, square_mm)
    world = _world(floor_frame, points)
    with progress_bar() as progress:
        found_clips = find_clips(clips)
        known = None if lenses is None else _lenses(lenses, target, list(found_clips), model, frames)
        views = find_board_views(
            found_clips, target, floor_frame=floor_frame, n_frames=frames, progress=progress
        )
        if other := board_in_place_of(views, found_clips):
            raise MocapError(
                f"no camera saw the board ({target}), but the clips show a checkerboard of {other[0]} x {other[1]}",
                path=clips,
                remedy=f"write --board {other[0]}x{other[1]}",
            )
    found = solve(views, world=world, lenses=known, model=model)
    write_calibration(
        out,
        found.rig,
        metadata={
            "source": "mocap calibrate",
            "board": str(target),
            "square_mm": square_mm,
            "rms_px": round(found.rms_px, 4),
        },
    )
    page = out.with_suffix(".html")
    room = uncertainty_map(found.adjusted)
    write_page(page, found, views, room)
    for camera in found.rig:
        name = camera.name
        certain = f"± {100 * found.focal_deviation[name]:.2f} %" if known is None else "as given"
        typer.echo(
            f"{name}: {found.n_views_of[name]} views, off by {found.rms_px_of[name]:.2f} px, focal length "
            f"{camera.K[0, 0]:.0f} px {certain}, {camera.center[2]:.2f} m above the floor, "
            f"place ± {1000 * found.center_deviation_m[name]:.1f} mm"
        )
        if why := views.why_missed(name):
            typer.echo(f"  no board in {sum(views.missed[name].values())} frames: {why}")
    for warning in found.warnings:
        typer.echo(f"  warning: {warning}")
    typer.echo(f"Corners are off by {found.rms_px:.2f} px (root mean square); written to {out}")
    typer.echo(f"How certain the room is: {page}")


def _world(floor_frame: int | None, points: Path | None) -> int | WorldPoints:
    """What the world is taken from: exactly one of the two."""
    from mocap.calibrate import WorldPoints
    from mocap.calibrate.detect import Sighting
    from mocap.io.tables import read_world_points_csv

    if points is not None and floor_frame is None:
        return WorldPoints({name: Sighting(*both) for name, both in read_world_points_csv(points).items()})
    if floor_frame is not None and points is None:
        return floor_frame
    raise MocapError(
        "the world is not given" if points is None else "the world is given twice",
        remedy="give the frame in which the board lies on the floor as --floor-frame, or known places as --points FILE",
    )


def _lenses(path: Path, board: Board, names: list[str], model: LensModel, n_frames: int) -> dict[str, Lens]:
    """Camera -> lens, out of a calibration or from clips of the board that need not be synchronised."""
    from mocap.calibrate import Lens, find_board_views, find_clips
    from mocap.calibrate.solve import lens_of_clip
    from mocap.io.calibration import read_calibration

    if path.is_dir():
        clips = find_clips(path, at_least=1)
        have = set(clips)
    else:
        rig = read_calibration(path).rig
        have = set(rig.names)
    if missing := [name for name in names if name not in have]:
        raise MocapError(
            f"there is no lens for camera {', '.join(missing)}",
            path=path,
            remedy="name cameras, or clips, as in the folder of the board",
        )
    if not path.is_dir():
        return {name: Lens.of(rig[name]) for name in names}
    return {
        name: lens_of_clip(find_board_views({name: clips[name]}, board, n_frames=n_frames), name, model)
        for name in names
    }
