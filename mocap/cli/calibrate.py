"""Cameras from a board: `mocap board` prints one, `mocap calibrate` solves for the cameras that filmed it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

from mocap.cli.options import CalibrationOption, check_choice
from mocap.cli.progress import progress_bar
from mocap.errors import MocapError

if TYPE_CHECKING:
    from mocap.calibrate import Board, Lens, LensModel, WorldPoints
    from mocap.pipeline.refine import RefinedSession

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
    out: Annotated[Path, typer.Option("-o", "--out", help="Calibration to write.")],
    clips: Annotated[
        Path | None,
        typer.Argument(
            metavar="BOARD",
            help="Folder with one clip of the board per camera, synchronised.",
            show_default=False,
        ),
    ] = None,
    board: Annotated[
        str | None, typer.Option("--board", help="9x6, charuco:8x6 or aprilgrid:6x4, as in `mocap board`.")
    ] = None,
    square_mm: Annotated[
        float | None,
        typer.Option("--square-mm", min=1.0, max=1000.0, help="Side of a square or tag, measured, mm."),
    ] = None,
    floor_frame: Annotated[
        int | None,
        typer.Option("--floor-frame", min=0, help="Frame in which the board lies flat on the floor."),
    ] = None,
    points: Annotated[
        Path | None,
        typer.Option(
            "--points",
            help="Instead: CSV of known places, camera,u_px,v_px,x_m,y_m,z_m. With --lenses no board is needed.",
        ),
    ] = None,
    lenses: Annotated[
        Path | None,
        typer.Option(
            "--lenses",
            help="Lenses that are kept: a calibration file, or a folder of (other) clips of the board.",
        ),
    ] = None,
    lens: Annotated[
        str, typer.Option("--lens", help="radial (two terms), tangential (and decentring) or fisheye.")
    ] = "radial",
    frames: Annotated[
        int | None,
        typer.Option("--frames", min=6, help="Frames to look at, spread evenly (60; refining: 300)."),
    ] = None,
    refine: Annotated[
        Path | None,
        typer.Option(
            "--refine", metavar="SESSION", help="Without a board: put right by the people in a session."
        ),
    ] = None,
    place: Annotated[
        Path | None,
        typer.Option(
            "--place",
            metavar="SESSION",
            help="From nothing but lenses: placed by one person who walks in a session.",
        ),
    ] = None,
    calibration: CalibrationOption = None,
    height_m: Annotated[
        float | None,
        typer.Option(
            "--height-m", min=0.5, max=2.5, help="Of the (tallest) person; sets the scale. --place needs it."
        ),
    ] = None,
    moved: Annotated[
        str | None,
        typer.Option(
            "--moved", metavar="CAM", help="With --refine: this camera alone, which was pushed in mid-take."
        ),
    ] = None,
    from_frame: Annotated[
        int | None,
        typer.Option(
            "--from-frame", min=1, help="Of the session, from which on --moved CAM stands still again."
        ),
    ] = None,
    register: Annotated[
        Path | None,
        typer.Option(
            "--register",
            metavar="SESSION",
            help="Instead: one depth camera, by the room that other depth cameras of a session measure too.",
        ),
    ] = None,
    camera: Annotated[
        str | None, typer.Option("--camera", metavar="CAM", help="With --register: the depth camera.")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option("--picture", help="With --refine: PNG of what was moved, and what it gained."),
    ] = None,
) -> None:
    """Lenses and places of the cameras from clips of a board that they all film; OUT.html says how good they are.

    --refine SESSION corrects the places of a calibration that is off by some degrees and centimetres, from people who
    walk in the session's clips, and writes a new file. With --moved CAM --from-frame N it finds one camera again that
    was pushed in mid-take, and session.toml says from which frame on the new file holds. --place SESSION finds the
    places from nothing, by one person who walks; lenses must be known. --points FILE --lenses LENSES without a board
    places cameras by points of known place: corners of a court, marks on the floor. --register SESSION --camera CAM
    finds one depth camera by the room that others measure too.
    """
    of_board: dict[str, object] = {"BOARD": clips, "--floor-frame": floor_frame, "--points": points}
    of_lenses: dict[str, object] = {"--board": board, "--square-mm": square_mm, "--lenses": lenses}
    of_session: dict[str, object] = {
        "--calibration": calibration,
        "--height-m": height_m,
        "--picture": picture,
    }
    of_move = {"--moved": moved, "--from-frame": from_frame}
    of_room = {"--register": register, "--camera": camera}
    if register is not None or camera is not None:
        strange = of_board | of_lenses | {"--refine": refine, "--place": place} | of_session
        _check_options(
            {k: v for k, v in strange.items() if k != "--calibration"},
            tuple(of_room),
            "--register",
            "leave it out",
            of_room,
        )
        assert register is not None  # the check above has seen to it
        assert camera is not None
        _register(register, out, camera, calibration)
        return
    if refine is not None and (moved is not None or from_frame is not None):
        strange = (
            of_board | of_lenses | {"--place": place, "--calibration": calibration, "--height-m": height_m}
        )
        _check_options(strange, tuple(of_move), "a camera that was moved", "leave it out", of_move)
        assert moved is not None  # the check above has seen to it
        assert from_frame is not None
        _refine_moved(refine, out, moved, from_frame, frames, picture)
        return
    if refine is not None:
        _check_options(of_board | of_lenses | {"--place": place}, (), "--refine", "leave it out")
        _refine(refine, out, calibration, height_m, frames, picture)
        return
    if place is not None:
        _check_options(
            of_board | of_move | {"--calibration": calibration, "--picture": picture},
            ("--height-m", *_needed_of_lenses(lenses)[1:]),
            "--place",
            "leave it out",
            of_session | of_lenses,
        )
        assert height_m is not None  # the check above has seen to it
        _place(place, out, height_m, lenses, board, square_mm, lens, frames)
        return
    if clips is None and points is not None:
        _check_options(
            of_session | of_move | {"--floor-frame": floor_frame},
            _needed_of_lenses(lenses),
            "points of known place",
            "leave it out",
            of_lenses,
        )
        assert lenses is not None  # the check above has seen to it
        _from_points(points, out, lenses, board, square_mm, lens, frames or 60)
        return
    _check_options(
        of_session | of_move,
        ("BOARD", "--board", "--square-mm"),
        "a board",
        "give --refine SESSION",
        of_board | of_lenses,
    )
    assert clips is not None  # the check above has seen to it
    assert board is not None
    assert square_mm is not None
    _from_board(clips, out, board, square_mm, _world(floor_frame, points), lenses, lens, frames or 60)


def _needed_of_lenses(lenses: Path | None) -> tuple[str, ...]:
    """Options that lenses need which are kept: of clips of a board, what board."""
    return ("--lenses", *(("--board", "--square-mm") if lenses is not None and lenses.is_dir() else ()))


def _check_options(
    strange: Mapping[str, object],
    needed: Sequence[str],
    what: str,
    remedy: str,
    given: Mapping[str, object] | None = None,
) -> None:
    """Raise MocapError for options that are not of this kind of calibration, and for those that it lacks."""
    if odd := [name for name, value in strange.items() if value is not None]:
        raise MocapError(f"{odd[0]} has no meaning for a calibration from {what}", remedy=remedy)
    if missing := [name for name in needed if (given or {}).get(name) is None]:
        raise MocapError(
            f"{', '.join(missing)} must be given",
            remedy="mocap calibrate CLIPS --board charuco:8x6 --square-mm 46 --floor-frame 12, or without a board "
            "mocap calibrate --points FILE --lenses LENSES, --refine SESSION, --place SESSION --height-m 1.8 or "
            "--register SESSION --camera CAM",
        )


def _refine(
    session: Path,
    out: Path,
    calibration: Path | None,
    height_m: float | None,
    n_frames: int | None,
    picture: Path | None,
) -> None:
    """The calibration of a session refined by its people."""
    from mocap.io.calibration import read_calibration
    from mocap.pipeline.refine import N_FRAMES, check_new, refine_session, write_picture, write_refined

    check_new(out)
    with progress_bar() as progress:
        refined = refine_session(
            session,
            calibration=calibration,
            height_m=height_m,
            n_frames=n_frames or N_FRAMES,
            progress=progress,
        )
    found = refined.refinement
    _echo_moves(refined)
    if height_m is not None:
        typer.echo(f"Scaled by {refined.factor:.4f} for somebody of {height_m:.2f} m")
    write_refined(out, refined)
    if picture is not None:
        write_picture(picture, refined, read_calibration(refined.source).rig)
        typer.echo(f"Picture in {picture}")
    typer.echo(
        f"Lines of sight {1000 * found.apart_before_m:.1f} -> {1000 * found.apart_after_m:.1f} mm apart; written to "
        f"{out}. Use it: mocap run {session} --calibration {out}"
    )


def _refine_moved(
    session: Path, out: Path, camera: str, from_frame: int, n_frames: int | None, picture: Path | None
) -> None:
    """A camera that was pushed during a session, found again from a frame on."""
    from mocap.io.calibration import read_calibration
    from mocap.pipeline.refine import N_FRAMES, check_new, refine_moved, write_moved, write_picture

    check_new(out)
    with progress_bar() as progress:
        refined = refine_moved(session, camera, from_frame, n_frames=n_frames or N_FRAMES, progress=progress)
    _echo_moves(refined)
    settings = write_moved(out, refined, session)
    if picture is not None:
        write_picture(picture, refined, read_calibration(refined.source).rig)
        typer.echo(f"Picture in {picture}")
    typer.echo(
        f"Written: {out}, and {settings}: it holds from frame {from_frame} on. Run it: mocap run {session}"
    )


def _register(session: Path, out: Path, camera: str, calibration: Path | None) -> None:
    """A depth camera of a session, found by the room."""
    from mocap.pipeline.measured import register_session, write_registered
    from mocap.pipeline.refine import check_new

    check_new(out)
    with progress_bar() as progress:
        registered = register_session(session, camera, calibration=calibration, progress=progress)
    found = registered.found
    write_registered(out, registered)
    x, y, z = found.camera.center
    typer.echo(
        f"{camera}: at ({x:.2f}, {y:.2f}, {z:.2f}) m, {1000 * found.shift_m:.0f} mm and {found.turn_deg:.1f} degrees "
        f"from where it was said to be"
    )
    typer.echo(
        f"{found.shared_m2:.2f} m2 above the floor are measured by others too; surfaces are "
        f"{1000 * found.residual_m:.1f} mm apart; written to {out}. Use it: mocap run {session} --calibration {out}"
    )


def _echo_moves(refined: RefinedSession) -> None:
    """What became of every camera."""
    from mocap.pipeline.refine import words

    for name, move in refined.refinement.moves.items():
        apart = f"{1000 * move.apart_before_m:.1f} -> {1000 * move.apart_after_m:.1f} mm"
        typer.echo(f"{name}: {words(move)}; lines of sight apart {apart}")


def _place(
    session: Path,
    out: Path,
    height_m: float,
    lenses: Path | None,
    board: str | None,
    square_mm: float | None,
    lens: str,
    n_frames: int | None,
) -> None:
    """Cameras of a session placed by a person who walks; lenses of a calibration, or of clips of a board."""
    from mocap.pipeline.refine import N_FRAMES, check_new, place_session, write_refined

    check_new(out)
    with TemporaryDirectory() as folder, progress_bar() as progress:
        if lenses is not None and lenses.is_dir():
            assert board is not None  # the options were checked
            assert square_mm is not None
            lenses = _without_places(
                lenses, Path(folder) / "lenses.toml", board, square_mm, lens, n_frames or 60
            )
        placed = place_session(
            session, height_m=height_m, lenses=lenses, n_frames=n_frames or N_FRAMES, progress=progress
        )
    found = placed.refinement
    for camera in placed.rig:
        move = found.moves[camera.name]
        x, y, z = camera.center
        typer.echo(
            f"{camera.name}: at ({x:.2f}, {y:.2f}, {z:.2f}) m ± {1000 * move.shift_std_m:.0f} mm, looks there ± "
            f"{move.turn_std_deg:.2f} degrees; lines of sight {1000 * move.apart_after_m:.1f} mm apart"
        )
    write_refined(out, placed)
    typer.echo(
        f"Lines of sight meet to {1000 * found.apart_after_m:.1f} mm; written to {out}. The floor is z = 0, the scale "
        f"is as good as {height_m:.2f} m. Use it: mocap run {session} --calibration {out}"
    )


def _without_places(clips: Path, path: Path, board: str, square_mm: float, lens: str, n_frames: int) -> Path:
    """Lenses of clips of a board, as a calibration file; places in it mean nothing."""
    from mocap.calibrate import board_from_text, find_clips
    from mocap.calibrate.lens import MODELS, rig_of_lenses
    from mocap.io.calibration import write_calibration

    check_choice("--lens", lens, MODELS)
    model: LensModel = lens  # type: ignore[assignment]
    target = board_from_text(board, square_mm)
    found = _lenses(clips, target, list(find_clips(clips, at_least=1)), model, n_frames)
    write_calibration(path, rig_of_lenses(found))
    return path


def _from_board(
    clips: Path,
    out: Path,
    board: str,
    square_mm: float,
    world: int | WorldPoints,
    lenses: Path | None,
    lens: str,
    frames: int,
) -> None:
    """Lenses and places from clips of a board."""
    from mocap.calibrate import WorldPoints, board_from_text, find_board_views, find_clips
    from mocap.calibrate import calibrate as solve
    from mocap.calibrate.lens import MODELS
    from mocap.calibrate.page import write_page
    from mocap.calibrate.uncertainty import uncertainty_map
    from mocap.calibrate.views import board_in_place_of
    from mocap.io.calibration import write_calibration

    check_choice("--lens", lens, MODELS)
    model: LensModel = lens  # type: ignore[assignment]
    target = board_from_text(board, square_mm)
    with progress_bar() as progress:
        found_clips = find_clips(clips)
        known = None if lenses is None else _lenses(lenses, target, list(found_clips), model, frames)
        views = find_board_views(
            found_clips,
            target,
            floor_frame=None if isinstance(world, WorldPoints) else world,
            n_frames=frames,
            progress=progress,
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
            "board": str(views.board),
            "square_mm": square_mm,
            "rms_px": round(found.rms_px, 4),
        },
    )
    page = out.with_suffix(".html")
    room = uncertainty_map(found.adjusted)
    write_page(page, found, views, room)
    typer.echo(f"Board: {views.board}, squares of {square_mm:g} mm")
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


def _from_points(
    points: Path, out: Path, lenses: Path, board: str | None, square_mm: float | None, lens: str, frames: int
) -> None:
    """Cameras of known lenses placed by points of known place."""
    from mocap.calibrate import board_from_text, resect
    from mocap.calibrate.lens import MODELS
    from mocap.calibrate.page import write_page
    from mocap.calibrate.uncertainty import uncertainty_map
    from mocap.io.calibration import write_calibration

    check_choice("--lens", lens, MODELS)
    model: LensModel = lens  # type: ignore[assignment]
    world = _world_points(points)
    target = board_from_text(board, square_mm) if board is not None and square_mm is not None else None
    found = resect(world, _lenses(lenses, target, list(world.sightings), model, frames))
    write_calibration(
        out,
        found.rig,
        metadata={"source": "mocap calibrate", "points": points.name, "rms_px": round(found.rms_px, 4)},
    )
    page = out.with_suffix(".html")
    write_page(page, found, None, uncertainty_map(found.adjusted))
    for camera in found.rig:
        name = camera.name
        typer.echo(
            f"{name}: {len(world.sightings[name].uv)} points, off by {found.rms_px_of[name]:.2f} px, "
            f"{camera.center[2]:.2f} m above the floor, place ± {1000 * found.center_deviation_m[name]:.1f} mm"
        )
    for warning in found.warnings:
        typer.echo(f"  warning: {warning}")
    typer.echo(f"Points are off by {found.rms_px:.2f} px (root mean square); written to {out}")
    typer.echo(f"How certain the room is: {page}")


def _world(floor_frame: int | None, points: Path | None) -> int | WorldPoints:
    """What the world is taken from: exactly one of the two."""
    if points is not None and floor_frame is None:
        return _world_points(points)
    if floor_frame is not None and points is None:
        return floor_frame
    raise MocapError(
        "the world is not given" if points is None else "the world is given twice",
        remedy="give the frame in which the board lies on the floor as --floor-frame, or known places as --points FILE",
    )


def _world_points(path: Path) -> WorldPoints:
    """Points of known place of a CSV."""
    from mocap.calibrate import WorldPoints
    from mocap.calibrate.detect import Sighting
    from mocap.io.tables import read_world_points_csv

    return WorldPoints({name: Sighting(*both) for name, both in read_world_points_csv(path).items()})


def _lenses(
    path: Path, board: Board | None, names: list[str], model: LensModel, n_frames: int
) -> dict[str, Lens]:
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
    assert board is not None  # a folder of clips needs one, which the command has seen to
    return {
        name: lens_of_clip(find_board_views({name: clips[name]}, board, n_frames=n_frames), name, model)
        for name in names
    }
