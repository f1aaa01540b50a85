"""Options and arguments that several commands share, and how their text is read."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mocap.cli import complete
from mocap.errors import MocapError, did_you_mean

if TYPE_CHECKING:
    from mocap.pipeline.config import Config

SessionPath = Annotated[
    Path,
    typer.Argument(
        metavar="SESSION", help="Session folder: calibration, videos/ or images/, background/ ..."
    ),
]
RunPath = Annotated[Path, typer.Argument(metavar="OUT", help="Output folder of a run.")]
OutPath = Annotated[Path, typer.Option("-o", "--out", help="Folder for the results.")]
PresetOption = Annotated[
    str,
    typer.Option(
        "--preset",
        help="default, best, realtime, live, reference, reference_markers, reference_shbm, thesis_body or a TOML file.",
        autocompletion=complete.presets,
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="Change one setting: section.key=value; lists as a,b (repeatable).",
        autocompletion=complete.settings,
    ),
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Same seed, same bytes.")]
FramesOption = Annotated[
    str | None, typer.Option("--frames", help="a:b, frames a to b - 1; either may be left out.")
]
CalibrationOption = Annotated[
    Path | None, typer.Option("--calibration", help="Calibration file instead of the session's own.")
]
ThreadsOption = Annotated[
    int | None, typer.Option("--threads", min=1, help="Threads; results do not depend on it.")
]
ResumeOption = Annotated[
    bool, typer.Option("--resume", help="Reuse stage products in OUT that nothing has changed for.")
]
RehashOption = Annotated[
    bool,
    typer.Option("--rehash", help="Read every input file again, also those that seem not to have changed."),
]
ExpectedOption = Annotated[
    int | None,
    typer.Option("--expected-persons", min=1, help="Most persons there can be: who is lost is waited for."),
]
FilterOption = Annotated[
    str | None,
    typer.Option("--filter", help="Pose filter; see --list-filters.", autocompletion=complete.filters),
]
ObservationOption = Annotated[
    str | None,
    typer.Option(
        "--observation",
        help="voxels, markers, keypoints, fused or auto (by what the session has).",
        autocompletion=complete.observations,
    ),
]
DeviceOption = Annotated[
    str | None,
    typer.Option(
        "--device",
        help="What scores particles: cpu, cuda (extra gpu) or auto (cpu).",
        autocompletion=complete.devices,
    ),
]


def parse_frames(text: str | None, option: str = "--frames") -> tuple[int | None, int | None] | None:
    """(first, stop) of an option a:b, None = the end of the clip. Raises MocapError for anything else."""
    if text is None:
        return None
    first, colon, last = text.partition(":")
    try:
        a = int(first) if first.strip() else None
        b = int(last) if last.strip() else None
    except ValueError:
        a, b, colon = None, None, ""
    if not colon or (a is not None and a < 0) or (b is not None and b < 0):
        raise MocapError(
            f"{option} is {text!r}, no range of frames", remedy=f"write {option} a:b, for example 0:100"
        )
    return a, b


def check_choice(option: str, value: str | None, known: Iterable[str]) -> None:
    """Raise MocapError, which names the option, for a value that is none of the known ones; None = not given."""
    known = list(known)
    if value is not None and value not in known:
        raise MocapError(
            f"{option} is {value!r}{did_you_mean(value, known)}", remedy=f"give one of {', '.join(known)}"
        )


def read_config(
    preset: str,
    settings: list[str] | None,
    *,
    filter_name: str | None = None,
    observation: str | None = None,
    expected_persons: int | None = None,
    device: str | None = None,
) -> Config:
    """The preset with --set and the options that stand for a setting."""
    from mocap.pipeline.config import OBSERVATIONS, load_config, setting_words

    check_choice("--observation", observation, OBSERVATIONS)
    check_choice("--device", device, setting_words("likelihood.device"))
    if filter_name is not None:
        from mocap.filters import FILTERS

        check_choice("--filter", filter_name, FILTERS)
    extra = [f"pose.filter={filter_name}"] if filter_name else []
    extra += [f"observation={observation}"] if observation else []
    extra += [f"tracking.expected_persons={expected_persons}"] if expected_persons else []
    extra += [f"likelihood.device={device}"] if device else []
    return load_config(preset, (*(settings or []), *extra))


def command_line() -> str:
    """The command as it was typed, for whoever wants to repeat it."""
    return shlex.join(["mocap", *sys.argv[1:]])
