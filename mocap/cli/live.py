"""`mocap live`: poses from cameras while they film."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mocap.cli.options import (
    PresetOption,
    SeedOption,
    SetOption,
    ThreadsOption,
    check_choice,
    read_config,
)
from mocap.compiling import compilation_shown
from mocap.errors import MocapError

if TYPE_CHECKING:
    from mocap.io.session import Session
    from mocap.pipeline.live.outputs import Sink
    from mocap.pipeline.live.run import LiveStatus


def live(
    calibration: Annotated[
        Path | None, typer.Argument(metavar="CALIBRATION", help="Calibration file of the cameras.")
    ] = None,
    out: Annotated[
        Path, typer.Option("-o", "--out", help="Folder for the background and the recording, a session.")
    ] = Path("out/live"),
    camera: Annotated[
        list[str] | None,
        typer.Option("--camera", help="CAMERA=SOURCE: number of a device, URL (RTSP, HTTP), or file."),
    ] = None,
    replay: Annotated[
        Path | None, typer.Option("--replay", help="Play a session at its own pace instead.")
    ] = None,
    rate: Annotated[float, typer.Option("--rate", min=0.01, help="Of files: 0.5 = half their pace.")] = 1.0,
    fps: Annotated[float, typer.Option("--fps", min=1.0, help="Frames per second of the cameras.")] = 30.0,
    background_s: Annotated[
        float, typer.Option("--background-s", min=0.0, help="Seconds that the empty room is filmed first.")
    ] = 3.0,
    background: Annotated[
        Path | None,
        typer.Option("--background", help="A session, or its background/: that of an earlier recording."),
    ] = None,
    tolerance_ms: Annotated[
        float | None,
        typer.Option("--tolerance-ms", help="Pictures of one set lie within so much; default 0.6 frames."),
    ] = None,
    json_to: Annotated[
        Path | None,
        typer.Option("--json", help="A line of JSON per result into this file; - = standard output."),
    ] = None,
    udp: Annotated[
        str | None, typer.Option("--udp", help="The same as datagrams: PORT of this machine, or HOST:PORT.")
    ] = None,
    osc: Annotated[
        str | None, typer.Option("--osc", help="Landmarks as OSC: PORT of this machine, or HOST:PORT.")
    ] = None,
    vmc: Annotated[
        str | None,
        typer.Option("--vmc", help="One person for avatars (VMC): PORT of this machine, or HOST:PORT."),
    ] = None,
    lsl: Annotated[
        str | None, typer.Option("--lsl", help="Landmarks as streams NAME-PERSON of the Lab Streaming Layer.")
    ] = None,
    view: Annotated[
        str | None,
        typer.Option("--view", help="The 3D scene in the Rerun viewer: window, or web for a browser."),
    ] = None,
    record: Annotated[
        bool, typer.Option("--record", help="Record videos, for `mocap run OUT` later.")
    ] = False,
    seconds: Annotated[float | None, typer.Option("--seconds", min=0.1, help="Stop after so long.")] = None,
    preset: PresetOption = "live",
    settings: SetOption = None,
    seed: SeedOption = 0,
    threads: ThreadsOption = None,
) -> None:
    """Follow who is before the cameras while they film; Ctrl-C ends it."""
    from mocap.pipeline.live.run import LIVE_DEFAULTS, LIVE_SETTINGS, LiveOrder, run_live

    if record and replay is not None:
        raise MocapError("a session that is played is a recording already", remedy="leave --record out")
    config = read_config(preset, [*LIVE_DEFAULTS, *(settings or []), *LIVE_SETTINGS])
    session, sources = _room(calibration, camera, replay, out, fps, background)
    order = LiveOrder(
        session,
        sources,
        config,
        rate=rate,
        background_s=0.0 if replay or background else background_s,
        tolerance_s=0.6 / session.fps if tolerance_ms is None else tolerance_ms / 1000.0,
        seconds=seconds,
        is_recorded=record,
        seed=seed,
        n_threads=threads or 2,
    )
    if order.background_s > 0:
        _say(f"Filming the empty room for {order.background_s:g} s; nobody may be in it")
    with ExitStack() as stack:
        sinks = []
        for sink in _sinks(json_to, udp, osc, vmc, lsl, view, session):
            stack.callback(sink.close)
            sinks.append(sink)
        stack.enter_context(compilation_shown(_compiling))
        status = run_live(order, sinks, show=_show, count_down=_count_down)
    _say(f"{_words(status)}; {status.n_results} results")
    if order.is_recorded:
        _say(f"Recorded: mocap run {out} -o {out}-result")


def _room(
    calibration: Path | None,
    cameras: list[str] | None,
    replay: Path | None,
    out: Path,
    fps: float,
    background: Path | None,
) -> tuple[Session, dict[str, str]]:
    """The session that is followed, and the source of every camera."""
    from dataclasses import replace

    from mocap.io.calibration import read_calibration
    from mocap.io.session import open_session
    from mocap.pipeline.live.room import backgrounds_in, live_session, sources_by_camera

    if replay is not None:
        session = open_session(replay)
        if not session.image_sources:
            raise MocapError(
                "the session has no pictures", path=replay, remedy="give one with videos/ or images/"
            )
        return session, {name: str(path) for name, path in session.image_sources.items()}
    if calibration is None:
        raise MocapError("there are no cameras", remedy="give CALIBRATION and --camera, or --replay SESSION")
    rig = read_calibration(calibration).rig
    sources = sources_by_camera(cameras or [], rig, calibration)
    session = live_session(out, calibration, list(sources), fps)
    if background is not None:
        session = replace(session, background_sources=backgrounds_in(background, session.rig))
    return session, sources


def _sinks(
    json_to: Path | None,
    udp: str | None,
    osc: str | None,
    vmc: str | None,
    lsl: str | None,
    view: str | None,
    session: Session,
) -> Iterator[Sink]:
    """Everybody who wants the results, one by one."""
    from mocap.pipeline.live.lsl import LslStreams
    from mocap.pipeline.live.outputs import JsonLines, UdpJson, UdpOsc, UdpVmc, read_address

    if udp is not None:
        yield UdpJson(read_address(udp, "--udp"))
    if osc is not None:
        yield UdpOsc(read_address(osc, "--osc"))
    if vmc is not None:
        yield UdpVmc(read_address(vmc, "--vmc"))
    if lsl is not None:
        yield LslStreams(lsl)
    if json_to is not None and str(json_to) == "-":
        yield JsonLines(sys.stdout, is_closed=False)
    elif json_to is not None:
        yield JsonLines(json_to.open("w", encoding="utf-8"))
    if view is not None:
        yield _scene(view, session)


def _scene(view: str, session: Session) -> Sink:
    """The 3D scene; where its page is, is said."""
    from mocap.pipeline.live.outputs import OnThread
    from mocap.pipeline.live.scene import PLACES, LiveScene

    check_choice("--view", view, PLACES)
    scene = LiveScene(session, view)
    if scene.url is not None:
        _say(f"The 3D scene: {scene.url}")
    return OnThread(scene)


def _count_down(left_s: float) -> None:
    if sys.stderr.isatty():
        _say(f"Filming the empty room: {left_s:.0f} s; nobody may be in it", is_rewritten=True)


def _compiling(what: str, done: int, total: int) -> None:
    if done % 10 == 1:
        _say(f"{what}: {done}/{total}; `mocap warm-up` does it beforehand", is_rewritten=True)


def _show(status: LiveStatus) -> None:
    _say(_words(status), is_rewritten=True)


def _say(text: str, *, is_rewritten: bool = False) -> None:
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\x1b[K{text}" + "\n" * (not is_rewritten))
    else:
        sys.stderr.write(f"{text}\n")
    sys.stderr.flush()


def _words(status: LiveStatus) -> str:
    """For example `24.1 results/s, latency 61 / 98 ms (p50 / p95), 3 dropped, 7 cameras, person 1 1.76 m`."""
    p50, p95 = (1000 * status.latency_s(p) for p in (50, 95))
    words = [
        f"{status.results_per_s:.1f} results/s",
        f"latency {p50:.0f} / {p95:.0f} ms (p50 / p95)",
        f"{status.counts.n_dropped} dropped",
    ]
    if status.latest is not None:
        words.append(f"{status.latest.n_cameras} cameras")
        words += [
            f"person {p.person} " + ("looked at" if p.height_m is None else f"{p.height_m:.2f} m")
            for p in status.latest.persons
        ]
        words += [f"left out at ({t.xyz[0]:.1f}, {t.xyz[1]:.1f}) m: a thing" for t in status.latest.things]
    failed = [name for name, n in status.n_failures.items() if n]
    if failed:
        words.append(f"failed at times: {', '.join(failed)}")
    return ", ".join(words)
