"""Tables over whole sessions, scenes or given ones: what the commands that judge cameras and clocks have in common."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from eval.whole import write_csv
from mocap.synth import synthesise
from mocap.synth.scene import load_scene

RESULTS = Path(__file__).with_name("results")
N_FRAMES = 150
Row = dict[str, str | float | int | None]


def session_parser(doc: str | None, work: str) -> argparse.ArgumentParser:
    """Which sessions, where they are made, and what the table is called.  doc : of the command.  work : folder."""
    parser = argparse.ArgumentParser(description=(doc or "").partition("\n")[0])
    parser.add_argument("sessions", nargs="*", help="scenes, or folders of sessions; default: all")
    parser.add_argument("--test", action="store_true", help="the scenes kept for the final judgement")
    parser.add_argument("--work", type=Path, default=Path(work), help="sessions and runs go there")
    parser.add_argument("--name", help="of the table")
    return parser


def names_of(options: argparse.Namespace, development: Sequence[str], test: Sequence[str]) -> Sequence[str]:
    """The sessions that are asked for."""
    return options.sessions or (test if options.test else development)


def session_of(name: str, work: Path) -> Path:
    """A scene, filmed once, or the session itself."""
    if Path(name).is_dir():
        return Path(name)
    root = work / "sessions" / name
    if not (root / "calibration.toml").exists():
        synthesise(load_scene(name).model_copy(update={"n_frames": N_FRAMES}), root)
    return root


def write_table(command: str, options: argparse.Namespace, rows: Sequence[Row]) -> None:
    """eval/results/COMMAND_NAME.csv with the columns of all rows; what a row has not stays empty."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    name = options.name or ("test" if options.test else "development")
    write_csv(RESULTS / f"{command}_{name}.csv", columns, [dict.fromkeys(columns) | row for row in rows])
