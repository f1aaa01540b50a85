"""`mocap eval`: an estimate against a truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from mocap.cli.options import check_choice, command_line
from mocap.cli.scores import echo_comparison


def evaluate(
    estimate: Annotated[
        Path,
        typer.Argument(
            metavar="ESTIMATE", help="Output folder of a run, or a file: TRC, C3D, BVH, CSV, Panoptic JSON."
        ),
    ],
    truth: Annotated[
        Path,
        typer.Argument(metavar="TRUTH", help="Session folder with truth, or a file as for the estimate."),
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
    html: Annotated[Path | None, typer.Option("--html", help="Write a page with pictures.")] = None,
    epsilon_mm: Annotated[float, typer.Option("--epsilon", min=1.0, help="Matching threshold, mm.")] = 100.0,
    map_path: Annotated[
        Path | None, typer.Option("--map", help="TOML: which points are our landmarks, units, axes.")
    ] = None,
    estimate_unit: Annotated[
        str | None, typer.Option("--estimate-unit", help="m, cm or mm, whatever the file says.")
    ] = None,
    truth_unit: Annotated[str | None, typer.Option("--truth-unit", help="The same of the truth.")] = None,
    estimate_up: Annotated[
        str | None, typer.Option("--estimate-up", help="Axis of the file that is up: x, -x, y, -y, z, -z.")
    ] = None,
    truth_up: Annotated[str | None, typer.Option("--truth-up", help="The same of the truth.")] = None,
    estimate_fps: Annotated[
        float | None, typer.Option("--estimate-fps", min=0.001, help="Frames per second of the estimate.")
    ] = None,
    truth_fps: Annotated[
        float | None, typer.Option("--truth-fps", min=0.001, help="Frames per second of the truth.")
    ] = None,
    frame_offset: Annotated[
        int, typer.Option("--frame-offset", help="Added to the frame numbers of the estimate.")
    ] = 0,
    time_offset: Annotated[
        float, typer.Option("--time-offset", help="Added to the times of the estimate, s.")
    ] = 0.0,
    actions: Annotated[
        Path | None, typer.Option("--actions", help="CSV first_frame,last_frame,action: scores of each.")
    ] = None,
    cameras: Annotated[
        Path | None, typer.Option("--cameras", help="Calibration: errors in pixels of these cameras too.")
    ] = None,
    epsilon_px: Annotated[float, typer.Option("--epsilon-px", min=0.1, help="Threshold in pixels.")] = 10.0,
    learn_share: Annotated[
        float,
        typer.Option("--learn-share", min=0.01, max=0.9, help="Share of frames that offsets are learnt on."),
    ] = 0.2,
) -> None:
    """Score a run, or poses of another tool, against a truth."""
    from mocap.compare import CompareOptions, compare, write_page
    from mocap.io.poses import SideMap
    from mocap.io.units import AXES, UNITS

    for option, value, known in (
        ("--estimate-unit", estimate_unit, UNITS),
        ("--truth-unit", truth_unit, UNITS),
        ("--estimate-up", estimate_up, AXES),
        ("--truth-up", truth_up, AXES),
    ):
        check_choice(option, value, known)
    options = CompareOptions(
        epsilon_mm=epsilon_mm,
        epsilon_px=epsilon_px,
        estimate=SideMap(unit=estimate_unit, up=estimate_up, fps=estimate_fps),
        truth=SideMap(unit=truth_unit, up=truth_up, fps=truth_fps),
        map_path=map_path,
        frame_offset=frame_offset,
        time_offset_s=time_offset,
        actions_path=actions,
        cameras_path=cameras,
        learn_share=learn_share,
    )
    comparison = compare(estimate, truth, options)
    if html is not None:
        write_page(html, comparison, command=command_line())
    if as_json:
        typer.echo(json.dumps(comparison.scores, allow_nan=False))
        return
    echo_comparison(comparison.scores)
    if html is not None:
        typer.echo(f"Look at {html}")
