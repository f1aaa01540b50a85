"""Configuration: one section per stage, validated, from presets in TOML and `key=value` settings."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, is_dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mocap.errors import MocapError, did_you_mean
from mocap.files import SETTINGS_LIMIT_BYTES, parse_toml, read_text
from mocap.io.formats import BoneNames, MarkerNames
from mocap.pipeline.edits.model import Edits
from mocap.pose.method import Method

_UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")  # of a section, of the method's settings


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


_NAMES_FILE = "names a file"
# A name that comes with the package, or the path of the user's own file, whose content decides a result.
NameOrFile = Annotated[str, _NAMES_FILE]


class SegmentationConfig(_Section):
    """Foreground segmentation (CF 2.2.3)."""

    background: Literal["auto", "clip", "recording", "first", "median"] = "auto"
    """Where the background is learnt: `clip` = background/, `recording` = the videos themselves, with the other cameras
    as witnesses of who stays in place, `first` = the first frames of the videos, `median` = their temporal median;
    `auto` = clip if there is one, else recording, with fewer than three cameras median."""
    first_frames: int = Field(default=30, ge=1)
    """Frames that `first` learns from; the room must be empty in them."""
    median_frames: int = Field(default=50, ge=3)
    """Frames, spread over the clip, that `median` looks at."""
    method: Literal["gaussian", "mog2", "knn"] = "gaussian"
    """Own running Gaussian with shadow test, or one of OpenCV's subtractors."""
    second_look: bool = True
    """With six cameras or more, four without colours, give back to a person what one camera took for his shadow and the
    others see as him; false = every camera on its own."""
    grey_outlines: bool = True
    """After the second look at pictures without colours, find every outline once more by brightness and edges, which
    takes about 20 ms per picture; false = leave it out, as the presets `realtime` and `live` do."""
    hold_s: float = Field(default=600.0, gt=0)
    """Seconds after which what never stops being foreground becomes background, such as a chair that was moved; longer
    than anybody sits still."""
    pixels_per_voxel: float = Field(default=2.0, ge=0)
    """Pictures larger than 640 x 360 are reduced by a whole factor as long as a voxel where the cameras look is so many
    pixels wide; 0 = never. 640 x 480 in a room of 5 m has 3 at 2 cm."""


class VolumeConfig(_Section):
    """Shape from silhouette (CF 2.2.4)."""

    voxel_size_m: float = Field(default=0.02, gt=0.002, le=0.5)
    n_faulty_views: Annotated[int, Field(ge=0)] | Literal["auto"] = "auto"
    """Cameras that may vote background for an occupied voxel; `auto` = 1 with six or more segmented cameras, else 0."""
    min_views: Annotated[int, Field(ge=1)] | Literal["auto"] = "auto"
    """Cameras that must have a voxel in view; `auto` = 4, or all when there are fewer, but one less of three or four
    cameras for what hangs on a person."""
    room_bounds_m: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    """Lower and upper corner of the room; the session's own bounds or the cameras' common view when absent."""
    outside_view: Literal["abstain", "background"] = "abstain"
    """What a camera says of a voxel outside its picture: nothing, or `background`."""
    occluders: Literal["learn", "ignore"] = "learn"
    """What stands still between cameras and people: `learn` it from the silhouettes, so that no camera speaks of what
    it cannot see; `ignore` = every camera judges its whole picture."""
    depth_noise_m: float = Field(default=0.003, ge=0.0, le=0.1)
    """Standard deviation of a depth camera's readings next to it, m; depth/ of a session is always used."""
    depth_noise_per_m: float = Field(default=0.0015, ge=0.0, le=0.1)
    """By how much it grows with the square of the distance, m per m^2: 0.001 to 0.002 for structured light and stereo
    cameras; a time-of-flight camera is better far away."""
    visibility: Literal["line", "zbuffer"] = "line"
    """How cameras that see a voxel are found: a walk to the optical centre, or a depth buffer per camera."""
    on_bad_camera: Literal["warn", "exclude", "ignore"] = "exclude"
    """A camera that moves, lags, freezes or goes black: `warn`; `exclude` = warn and carve without it from that frame
    on; `ignore` = do not look for such cameras."""


class TrackingConfig(_Section):
    """Person tracking (CF 4.2-4.3; docs/tracking.md)."""

    tracker: Literal["naive", "particle", "sparse"] = "naive"
    """Ellipsoid of influence (CF 4.3.1), particle filter (CF 4.3.2) or sparse sampling (CF 4.3.3)."""
    n_samples: int | None = Field(default=None, ge=1)
    """Particles or samples per person; 100 or 800 when absent."""
    colour: bool = True
    """Use the voxels' colours: in the likelihood, when persons meet, and to know again who returns."""
    expected_persons: int | None = Field(default=None, ge=1)
    """Most persons there can be: never more are confirmed, and who is lost gives his number to the next who comes."""
    voxel_size_m: float | None = Field(default=None, gt=0.002, le=0.5)
    """Side of the voxels that persons are tracked on, at least that of the volume; the volume's own when absent."""
    confirm_frames: int = Field(default=3, ge=1)
    """Frames in which a blob must look like a person before it becomes one (fewer for shorter clips)."""
    lost_frames: int = Field(default=15, ge=0)
    """Frames that a person may be out of sight before the track ends."""
    reid_s: float = Field(default=60.0, ge=0)
    """Seconds after which a person who was lost is still known again by colour; 0 = never."""
    person_tree: Literal["wide", "trained"] = "wide"
    """What looks like a person (CF 4.2.3): wide limits set by hand, or a tree trained on synthetic scenes."""
    published: bool = False
    """The trackers as they stand in the source: their own estimates, no motion model, no repair of identities."""


class BodyConfig(_Section):
    """The body model."""

    model: NameOrFile = "auto"
    """A preset (`anthropometric`, `girdle`, `thesis`, `whole`) or a body file; `auto` = `whole`, with feet and
    hands, where poses are refined on volumes, else `anthropometric`."""
    height_m: float | None = Field(default=None, gt=0.3, lt=2.6)
    """Standing height; the body file's value, the session's or the volume decides when absent."""
    sizing: Literal["head", "poses"] = "head"
    """How the volume decides: by the highest place of the head (CF 6.3.4), or by it and the size at which refined poses
    explain the volumes best, for people who never stand upright."""
    marker_set: NameOrFile = "markers_20"
    """Where markers sit: a set that comes with the package, or a file (docs/markers.md)."""
    marker_offsets: Literal["fit", "given"] = "fit"
    """Fit marker offsets and segment lengths to the person, or take them as the set and the body give them."""


class LikelihoodConfig(_Section):
    """Voxel likelihood (CF 6.5)."""

    kind: Literal["exact", "fast"] = "exact"
    """All points of the body's look-up table, or a sample of them and overlaps from tables: a third of the time. It
    proposes poses; where they are refined, what is kept is judged with all points."""
    n_points: int = Field(default=200, ge=20, le=5000)
    """Points per part of the fast kind."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """What scores the filter's particles: `cpu`, or `cuda` = a graphics card (extra `gpu`), whose scores differ by
    points at borders of voxels; `auto` = cpu, so that results do not depend on what a machine has."""
    factorised: bool = True
    """Per-part likelihoods (CF 6.23); false = one global likelihood (CF 6.21)."""
    variance_out: float = Field(default=0.01, gt=0)
    """Source: CF Table 6.2."""
    variance_double: float = Field(default=0.01, gt=0)
    """Source: CF Table 6.2."""
    variance_empty: float = Field(default=0.1, gt=0)
    """Source: CF Table 6.2."""
    variance_surface: float = Field(default=0.1, gt=0)
    """Source: CF Table 6.2."""


class PoseConfig(_Section):
    """Pose filter (CF 6) and refinement."""

    filter: str = "apf"
    """One of `mocap run --list-filters`."""
    n_layers: int = Field(default=6, ge=1, le=40)
    """Annealing layers. Source: CF 6.7.2."""
    n_particles: int = Field(default=600, ge=2)
    """Particles per layer. Source: CF 6.7.2."""
    survival_rate: float = Field(default=0.5, gt=0, lt=1)
    """Target ESS / N of every layer. Source: CF 3.2.2."""
    resampling: Literal["systematic", "stratified", "multinomial", "residual", "weighted"] = "systematic"
    hierarchy: NameOrFile = "model2"
    """Scalable body of shbm-apf and shbm-ddma-pf: `model1` (straight limbs first) or `model2` (proximal parts first),
    each also as `_printed`, or a TOML file. Source: CF 7.3.2."""
    level_particles: tuple[Annotated[int, Field(ge=2)], ...] = ()
    """Particles of each of its models; none = as many as n_layers * n_particles evaluations pay for."""
    level_layers: int = Field(default=2, ge=1, le=20)
    """Annealing layers of each model. Source: CF 7.5.1."""
    structural_rate: float = Field(default=0.8, gt=0, le=1)
    """Factor on the noise covariance from model to model. Source: CF 7.5.1."""
    crossing: Literal["direct", "mirror", "random"] = "mirror"
    """Who gives columns to whom between models, by rank: best with best, mostly, or by chance. Source: CF 7.3.2.3."""
    limbs: NameOrFile = "limbs"
    """Limbs that ddma-pf and shbm-ddma-pf may drop: `limbs` (a leg may end at the knee), `whole_limbs`, a TOML file."""
    limb_evidence: Literal["published", "own"] = "published"
    """A limb's data: all occupied voxels its flesh lies in (CF 7.4.2), or only those that no other part holds."""
    noise_scale: float = Field(default=1.0, gt=0)
    """Factor on the propagation noise, which is half of the body's largest expected speed per frame."""
    follow_track: bool = True
    """Move all particles by the track's displacement before the first layer."""
    surface_sigma_voxels: float = Field(default=1.0, ge=0, le=8)
    """Gaussian that smooths the surface map of CF 6.16."""
    table_density: float = Field(default=1.0, gt=0, le=4)
    """Spacing of the body's look-up table over the voxel side. Source: CF Eq. 6.26."""
    refine: bool = True
    """Second-order refinement of every estimate on the hull's surface; false = the published filter alone."""
    surface_weight: float = Field(default=1.0, ge=0)
    """Weight of the hull's surface in refinement and evidence."""
    outline_weight: float = Field(default=8.0, ge=0)
    """Weight of the silhouettes' outlines in refinement and evidence; 0 = without."""
    posture_nats: float = Field(default=2.0, ge=0)
    """What it costs an arm to point at right angles to where it hangs at ease, half of what the opposite way costs: it
    decides what the data do not."""
    colour_weight: float = Field(default=200.0, ge=0)
    """Nats that the colours of the silhouettes are worth in the evidence, per nat of a pixel's colour; 0 = without.
    What colours the limbs have is learnt while the person is followed."""
    texture_weight: float = Field(default=0.0, ge=0)
    """Nats that the colours of places on the body are worth when poses are refined once more, per half of their mean
    squared deviation; 0 = not once more. They are learnt over the clip, after all poses are found; the pictures are
    read twice more."""
    texture_every_frames: int = Field(default=1, ge=1, le=10)
    """Frames from one pose that is refined on these colours to the next; those between are moved along with them."""
    feedback_share: float = Field(default=0.5, ge=0, lt=1)
    """Share of the particles that take over the refined pose."""
    look_again: bool = True
    """Search anew for limbs that fit badly, over their whole range, and for the whole pose where it is lost; false =
    the published filter alone."""
    search_every_frames: Annotated[int, Field(ge=1, le=10)] | Literal["auto"] = 1
    """Frames from one search to the next, by the filter and for limbs; in those between, the pose goes on as it went
    and is refined. `auto` = 2 while five cameras or more show the person, 1 while fewer do."""
    repair: bool = True
    """Where a limb jumps, carry it over from the other side while the frames gain by it, after all poses are found."""
    jump_nats: float = Field(default=0.0, ge=0)
    """Most that a landmark which moves faster than people do may cost a limb that was searched for anew; 0 = jumps are
    free."""
    estimate: Literal["mean", "rotation_mean", "map"] = "mean"
    """One pose for the particles of a frame: mean over angles (CF 3.19), over rotations, or the likeliest particle."""
    smooth_lag_frames: int = Field(default=0, ge=0, le=1000)
    """Later frames that a frame's pose is smoothed with, after all poses are found; 0 = not smoothed."""
    n_start_frames: int = Field(default=3, ge=1)
    """Frames in the middle of a person's clip, or as near to it as he stands, in which the first pose is looked for."""
    n_first_poses: int = Field(default=8, ge=1)
    """Candidates that are followed to the end in each of them; four times as many are followed briefly."""


class MarkersConfig(_Section):
    """Marker observation (CF 6.4)."""

    gate_px: float = Field(default=12.0, gt=0)
    """The filter takes no detection for a marker that is further from its projection (rho of CF 6.4.1.2)."""
    reprojection_weight: float = Field(default=1.0, ge=0, le=1)
    """Share of the reprojection term in the filter's score; 0 = the printed cost, epipolar distances alone."""
    sigma: float = Field(default=1.0, gt=0)
    """Source: CF Eq. 6.10."""
    factorised: bool = True
    """Per-part likelihoods; false = one mean over all markers, as printed."""
    noise_px: float = Field(default=2.0, gt=0)
    """Standard deviation of a detection; the refinement weighs detections and judges agreement by it."""
    n_hypotheses: int = Field(default=3, ge=1, le=16)
    """Poses that are followed side by side until one of them costs less; 1 = the best one only."""
    fit_frames: int = Field(default=30, ge=5)
    """Frames, spread over the clip, that marker offsets and segment lengths are fitted to."""
    smooth: bool = True
    """Smooth the poses over time; every frame counts by its own uncertainty."""
    mahalanobis: float = Field(default=3.0, gt=0)
    """Gate of the colour detector: distance of a pixel's colour from the learnt one. Source: CF 6.6.2."""
    label_radius_px: float = Field(default=2.0, gt=0)
    """Pixels around a labelled point that the colour is learnt from."""
    min_area_px: int = Field(default=3, ge=1)
    """Smallest patch of marker colour that is a detection."""
    max_area_px: int = Field(default=400, ge=1)
    """Largest one."""


class OutputConfig(_Section):
    """What is written beside the CSV files."""

    formats: tuple[Literal["bvh", "trc", "c3d", "glb", "usd", "mot", "osim", "rrd", "report"], ...] = (
        "bvh",
        "trc",
        "c3d",
        "glb",
        "mot",
        "rrd",
        "report",
    )
    bone_names: BoneNames = "mocap"
    """What bones are called in BVH and GLB: as here, or as in the rigs of Mixamo, of VRM humanoids, of Unreal's
    mannequin, so that the motion falls onto such a character."""
    marker_names: MarkerNames = "mocap"
    """What markers are called in TRC and in OpenSim's files: as here, or as in OpenCap, in Halpe26 or BODY_25B of
    Pose2Sim; points that a set has no name for are left out."""
    trc_gaps: Literal["blank", "filled"] = "blank"
    """What a TRC holds where a landmark is unknown: nothing, or a straight line from the last known place to the next,
    for tools that know no gaps; person_N_filled.csv lists these places then."""
    report_frames: int = Field(default=3, ge=1, le=12)
    """Frames shown as pictures in the report."""
    report_cameras: int = Field(default=4, ge=1, le=16)
    keep: Literal["all", "masks", "nothing"] = "all"
    """What of the store a finished run keeps: `masks` = all but hulls and the owners of their voxels, `nothing` = no
    product. What is not kept cannot be reused, exported, viewed or reported again; results do not depend on it."""


Observed = Literal["auto", "voxels", "markers", "keypoints", "fused"]
OBSERVATIONS: tuple[str, ...] = get_args(Observed)


class Config(_Section):
    """Everything that decides a result besides the input and the seed."""

    observation: Observed = "auto"
    """What poses are found from; fused = voxels and keypoints together; `auto` = markers in a session that has
    detections/, keypoints in one that has nothing else, else voxels."""
    segmentation: SegmentationConfig = SegmentationConfig()
    volume: VolumeConfig = VolumeConfig()
    tracking: TrackingConfig = TrackingConfig()
    body: BodyConfig = BodyConfig()
    likelihood: LikelihoodConfig = LikelihoodConfig()
    pose: PoseConfig = PoseConfig()
    markers: MarkersConfig = MarkersConfig()
    method: Method = Field(default_factory=Method)
    """Numbers of the pose method that the defaults fix, for experiments."""
    output: OutputConfig = OutputConfig()
    edits: Edits = Edits()

    def only(self, sections: Sequence[str]) -> Config:
        """The same with some of its sections: to read another one is an AttributeError."""
        shown = self.model_copy()
        for name in type(self).model_fields:
            if name not in sections:
                del shown.__dict__[name]
        return shown

    def body_model(self, observation: Literal["voxels", "markers", "keypoints"]) -> str:
        """Name or file of the body that poses are found with from voxels, markers or keypoints."""
        if self.body.model != "auto":
            return self.body.model
        # Collar bones, hands and feet are held by what angles are usual, which only the refinement knows.
        return "whole" if observation != "markers" and self.pose.refine else "anthropometric"


_PRESETS = resources.files("mocap") / "presets"


def named_files(section: BaseModel | Method) -> list[str]:
    """Values of the settings of a section that may be paths."""
    fields = type(section).model_fields if isinstance(section, BaseModel) else {}
    return [getattr(section, name) for name in fields if _NAMES_FILE in fields[name].metadata]


def presets() -> tuple[str, ...]:
    """Names of the presets that come with the package."""
    return tuple(sorted(p.name.removesuffix(".toml") for p in _PRESETS.iterdir() if p.name.endswith(".toml")))


def load_config(preset: str = "default", settings: tuple[str, ...] = ()) -> Config:
    """A preset by name or path, changed by `section.key=value` settings.

    Raises MocapError naming the dotted path of an unknown key or a bad value, and the allowed keys.
    """
    if preset in presets():
        text = (_PRESETS / f"{preset}.toml").read_text("utf-8")
        path = Path(f"{preset}.toml")
    else:
        path = Path(preset)
        if not os.path.exists(path) and (meant := did_you_mean(preset, presets())):
            raise MocapError(
                f"--preset is {preset!r}{meant}",
                remedy=f"use one of {', '.join(presets())} or the path of a TOML file",
            )
        text = read_text(
            path,
            f"a preset or configuration file named {preset!r}",
            limit=SETTINGS_LIMIT_BYTES,
            remedy=f"use one of {', '.join(presets())} or the path of a TOML file",
        )
    try:
        values = parse_toml(text)
    except ValueError as error:
        raise MocapError(f"not a TOML file: {error}", path=path, remedy="correct the syntax") from error
    for setting in settings:
        _apply_setting(values, setting)
    try:
        return Config.model_validate(values)
    except ValidationError as error:
        raise _config_error(error, path, settings) from error


def _apply_setting(values: dict[str, Any], setting: str) -> None:
    key, sep, text = setting.partition("=")
    parts = key.strip().split(".")
    is_plain = key.strip() == "observation"  # the one key outside a section
    if not sep or not all(parts) or (len(parts) < 2 and not is_plain):
        raise MocapError(f"cannot read the setting {setting!r}", remedy="write it as --set section.key=value")
    try:
        value: Any = parse_toml(f"value = {text.strip()}")["value"]
    except ValueError:
        value = text.strip()  # a bare word is a string
    if isinstance(value, str) and _is_list(parts):
        value = _items(value)
    node = values
    for part in parts[:-1]:
        node = node.setdefault(part, {})
        if not isinstance(node, dict):
            raise MocapError(f"configuration: {key} is not a section", remedy="write section.key=value")
    node[parts[-1]] = value


def _is_list(parts: Sequence[str]) -> bool:
    """Whether a setting takes any number of values."""
    return get_origin(get_type_hints(_section_of(parts)).get(parts[-1])) is tuple


def _items(text: str) -> list[Any]:
    """`bvh,trc` or `400,200` as a list."""
    try:
        return list(parse_toml(f"value = [{text}]")["value"])
    except ValueError:
        return [word for item in text.split(",") if (word := item.strip())]


def _config_error(error: ValidationError, path: Path, settings: tuple[str, ...]) -> MocapError:
    """The first mistake of a configuration.  path : of the preset, named unless a setting is to blame."""
    first = error.errors()[0]
    loc = [str(part) for part in first["loc"]]
    dotted = ".".join(loc)
    section = _section_of(loc)
    what = first["msg"].lower()
    remedy = "see docs/configuration.md for what it may be"
    if first["type"] in _UNKNOWN:
        allowed = list(
            section.model_fields if issubclass(section, BaseModel) else section.__dataclass_fields__
        )
        what = f"unknown key{did_you_mean(loc[-1], allowed)}"
        remedy = f"allowed here: {', '.join(allowed)}"
    elif first["type"] == "literal_error":
        words = str(first["ctx"]["expected"]).split("'")[1::2]
        what += f", got {first['input']!r}{did_you_mean(str(first['input']), words)}"
        is_list = isinstance(first["loc"][-1], int)
        key = ".".join(loc[:-1] if is_list else loc)
        remedy = f"write for example --set {key}={_example(first['ctx']['expected'], 1 + is_list)}"
    keys = [setting.partition("=")[0].strip() for setting in settings]
    is_setting = any(
        dotted == key or dotted.startswith(key + ".") or key.startswith(dotted + ".") for key in keys
    )
    return MocapError(f"configuration: {dotted}: {what}", path=None if is_setting else path, remedy=remedy)


def _example(expected: str, n: int) -> str:
    """The first n of the words that pydantic expects, `'bvh', 'trc' or 'c3d'`, as they are typed."""
    return ",".join(expected.split("'")[1::2][:n])


def setting_keys() -> list[str]:
    """Every key that --set takes, dotted."""
    return list(_keys_under(Config, ""))


def _keys_under(section: Any, prefix: str) -> Iterator[str]:
    for name, kind in get_type_hints(section, include_extras=False).items():
        is_section = isinstance(kind, type) and (issubclass(kind, BaseModel) or is_dataclass(kind))
        if (
            (name == "edits" and not prefix)
            or get_origin(kind) is ClassVar
            or name.startswith(("_", "model_"))
        ):
            continue
        if is_section:
            yield from _keys_under(kind, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}"


def setting_words(key: str) -> list[str]:
    """The words that a setting may be, or the items of its list; none for numbers, texts and unknown keys."""
    parts = key.split(".")
    return list(_words_of(get_type_hints(_section_of(parts)).get(parts[-1])))


def _words_of(kind: Any) -> Iterator[str]:
    if kind is bool:
        yield from ("true", "false")
    for part in get_args(kind):
        if isinstance(part, str):
            yield part
        elif part is not Ellipsis:
            yield from _words_of(part)


def _section_of(parts: Sequence[str]) -> Any:
    """The class of the section or settings that hold a key, as far as there is one."""
    section: Any = Config
    for part in parts[:-1]:
        inner = get_type_hints(section).get(part)
        if not (isinstance(inner, type) and (issubclass(inner, BaseModel) or is_dataclass(inner))):
            break
        section = inner
    return section


def config_hash(*sections: BaseModel | Method | str | float | int | None) -> str:
    """A short hash of configuration sections and other plain values."""
    plain = [
        s.model_dump(mode="json") if isinstance(s, BaseModel) else asdict(s) if is_dataclass(s) else s  # type: ignore[arg-type]
        for s in sections
    ]
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()[:16]
