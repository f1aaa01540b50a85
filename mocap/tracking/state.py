"""State of the trackers: what they decide by, what they remember and what they say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from mocap.arrays import Array, Indices
from mocap.data import CameraRig
from mocap.tracking.features import PERSON_TREE, BlobFeatures, Split

TRACKERS = ("naive", "particle", "sparse")
DEFAULT_SAMPLES = {"naive": 0, "particle": 100, "sparse": 800}
TENTATIVE, CONFIRMED, COASTING = "tentative", "confirmed", "coasting"
RANK = {CONFIRMED: 2, COASTING: 1, TENTATIVE: 0}


# Fields of the settings, what their values must fulfil (None is always right), and how that is said.
_LIMITS: tuple[tuple[tuple[str, ...], Callable[[Any], bool], str], ...] = (
    (
        ("voxel_size_m", "semi_axis_xy_m", "alpha", "beta", "fps", "exclusion_scale"),
        lambda value: value > 0,
        "be positive",
    ),
    (
        ("merge_frames", "tentative_misses", "lost_frames", "reid_s"),
        lambda value: value >= 0,
        "not be negative",
    ),
    (
        ("confirm_frames", "n_samples", "expected_persons", "sample_radius"),
        lambda value: value >= 1,
        "be at least 1",
    ),
    (("sample_radius",), lambda value: value <= 12, "be at most 12"),
    (("colour_weight", "colour_adaptation", "similar_share"), lambda value: 0 <= value <= 1, "lie in 0 .. 1"),
)


@dataclass(frozen=True)
class TrackerSettings:
    """What a tracker decides by.

    voxel_size_m : side of the voxels that are fed in.
    tracker : one of TRACKERS.  n_samples : particles or samples per person; None = 100 or 800.
    colour : use colours: in the likelihood, for identities and for re-identification.
    fps : frames per second, for speeds and times.
    expected_persons : never more persons than this are confirmed, and one who is lost gives his number to the next
        who comes; None = any number.

    The filters (CF 4.3). semi_axis_xy_m, alpha, beta : semi-axes of the ellipsoid of influence are
        alpha * semi_axis_xy_m twice, and beta * height of the centroid.
    estimate : position of a track: `voxels` = centroid of the voxels it owns, `filter` = the filter's own estimate.
    motion : `velocity` = tracks and samples are moved by the person's velocity first; `none` = as published.
    colour_weight : 1 - lambda of CF Eq. 4.8, 4.19.  colour_adaptation : alpha of CF Eq. 4.11.
    similar_share : share of the histogram that counts as the person's colours, CF 4.3.3.
    exclusion_scale : k of CF Eq. 4.13 in units of 1 / semi_axis_xy_m**2.
    propagation_std_m : noise of a particle per frame along x, y and z.
    sample_radius : r of CF Eq. 4.20 and of the samples' discrete noise, voxels.
    even_samples : samples of the surface count less where there are many of them; false = as published.

    Who owns what. whole_components : a component that holds one track belongs to it whole; false = voxels in the
        ellipsoid alone, without those in two of them (CF Eq. 4.4, 4.7).
    reacquire_distance_m : a track without voxels takes over a free person blob within this distance.
    fragment_reach : loose parts whose centroid lies within so many ellipsoid radii belong to the track.
    min_fragment_kg : lighter loose parts are specks and belong to nobody.
    min_shared_weight : tracks share a component only while it has this share of their usual weights together;
        otherwise one of the persons is not in it.
    min_support_kg : with less weight than this a track's voxels do not move it, and a component is no person.
    person_tree : see `is_person`.

    Life cycle, counted in frames, not in calls. min_distance_m : no track is created nearer than this to another one
        (horizontally).  merge_distance_m, merge_frames : of two tracks nearer than this for more than so many frames
        in a row one is deleted.
    confirm_frames : sightings as a person until a tentative track is confirmed. Ghosts between two persons live about
        a quarter of a second, and offline the track is backdated: patience costs nothing. For a clip hardly longer
        than this, pass less.
    tentative_misses : a tentative track is deleted when it is missed in more frames in a row than this.
    tentative_frames : a track that is not confirmed by then (or thrice confirm_frames) is deleted.
    lost_frames : a confirmed track coasts so many frames, then it is deleted: no phantom lives longer.
    min_new_top_m, min_move_m : a new blob lower than this is confirmed only after it has moved so far, or changed its
        extent so much: chairs do neither by themselves, children and people on the floor do.
    lying_frames : one that is as long as somebody who lies is confirmed after so many sightings where it is, None =
        never: where the empty scene is known it is no furniture of the room.
    follow_low : a confirmed person who sinks below that stays seen whatever the classifier says, as long as weight,
        place and colours agree with what was there; what is left behind (a chair) is no longer the person, even where
        the classifier takes it for one. false = the classifier alone decides.

    Identity. keep_identity : repair exchanged persons by their colours after they were close; needs colour.
    identity_margin : sum of the two Bhattacharyya coefficients that must be gained by an exchange.
    reid_s : a person who was lost gets the old number back within this time when the colours agree; 0 = never.
    reid_likeness : least Bhattacharyya coefficient for that.  reid_margin : how much less the next best may have.

    rig : cameras that the hulls are of; several people in one volume have pixels of their own there. None = heads are
        enough.
    """

    voxel_size_m: float
    tracker: str = "naive"
    n_samples: int | None = None
    colour: bool = True
    fps: float = 25.0
    expected_persons: int | None = None
    semi_axis_xy_m: float = 0.3
    alpha: float = 1.5
    beta: float = 1.2
    estimate: Literal["voxels", "filter"] = "voxels"
    motion: Literal["velocity", "none"] = "velocity"
    colour_weight: float = 0.2
    colour_adaptation: float = 0.9
    similar_share: float = 0.8
    exclusion_scale: float = 1.0
    propagation_std_m: tuple[float, float, float] = (0.06, 0.06, 0.03)
    sample_radius: int = 2
    even_samples: bool = True
    whole_components: bool = True
    reacquire_distance_m: float = 1.0
    fragment_reach: float = 2.0
    min_fragment_kg: float = 0.1
    min_shared_weight: float = 0.6
    min_support_kg: float = 5.0
    person_tree: Split | bool = PERSON_TREE
    min_distance_m: float = 0.5
    merge_distance_m: float = 0.25
    merge_frames: int = 5
    confirm_frames: int = 8
    tentative_misses: int = 2
    tentative_frames: int = 150
    lost_frames: int = 15
    min_new_top_m: float = 1.0
    min_move_m: float = 0.3
    lying_frames: int | None = None
    follow_low: bool = True
    keep_identity: bool = True
    identity_margin: float = 0.2
    reid_s: float = 60.0
    reid_likeness: float = 0.7
    reid_margin: float = 0.1
    rig: CameraRig | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        if self.tracker not in TRACKERS:
            raise ValueError(f"tracker must be one of {', '.join(TRACKERS)}, got {self.tracker!r}")
        if self.estimate not in ("voxels", "filter"):
            raise ValueError(f"estimate must be voxels or filter, got {self.estimate!r}")
        if self.motion not in ("velocity", "none"):
            raise ValueError(f"motion must be velocity or none, got {self.motion!r}")
        for names, is_right, rule in _LIMITS:
            for name in names:
                value = getattr(self, name)
                if value is not None and not is_right(value):
                    raise ValueError(f"{name} must {rule}, got {value}")

    @property
    def samples(self) -> int:
        """Number of particles or samples per person."""
        return self.n_samples or DEFAULT_SAMPLES[self.tracker]


def published_settings(tracker: str, voxel_size_m: float, **changes: Any) -> TrackerSettings:
    """The trackers as they stand in the source; changes : any field of TrackerSettings.

    The filter's own estimate, no motion model, the ellipsoid alone, no repair of identities and nobody is recognised
    when he returns.  Source: CF 4.3.
    """
    published = TrackerSettings(
        voxel_size_m,
        tracker=tracker,
        estimate="filter",
        motion="none",
        even_samples=False,
        whole_components=False,
        keep_identity=False,
        reid_s=0.0,
        min_new_top_m=0.0,
        follow_low=False,
    )
    return replace(published, **changes)


@dataclass(frozen=True, eq=False)
class Track:
    """One person as the tracker believes it.

    person : id >= 1; ids of tracks that were never confirmed are used again, and a person who returns gets the old
        one back.  serial : number of this very track, never used again.
    xyz : (3,) m, world, position.  covariance : (3, 3) m^2, of xyz.  velocity : (3,) m/s.
    status : tentative, confirmed or coasting.
    born : frame of creation.  age : frames since then.  hits : sightings as a person.
    misses : frames since the last of them.  close : frames in a row too near to a better track.
    weight_kg : usual weight of its voxels, a running mean over the frames in which it shared with nobody.
    top_m : usual height of the highest voxel.  last_kg, last_top_m : both when it was last seen alone.
    home : (5,) m, position xy, both sides of the box and top when it was new.  has_moved : one of them by more than
    min_move_m.
    motion : (2, 2), covariance of position and velocity along each axis.
    samples : (n, 3) m and weights (n,), sum 1: particles, or samples of the surface; empty for the naive tracker.
    efficiency : mean likelihood of the samples before they were weighted, 1 for the naive tracker.
    histogram : (9261,), adaptive colour model of CF Eq. 4.11, zeros = none.
    appearance : (3, 9261), slow colour model by height band, of frames in which the person stood alone.
    n_appearance : number of those.  mixed : frames for which an exchange with another track remains possible.
    n_several : frames in a row in which its voxels looked like several persons.
    is_named : the id is final; a person who has just come in may still be recognised as somebody who was here before.
    """

    person: int
    xyz: Array
    status: str
    born: int
    age: int = 0
    hits: int = 1
    misses: int = 0
    close: int = 0
    weight_kg: float = 0.0
    serial: int = 0
    covariance: Array = field(default_factory=lambda: np.zeros((3, 3)))
    velocity: Array = field(default_factory=lambda: np.zeros(3))
    top_m: float = np.nan
    last_kg: float = 0.0
    last_top_m: float = np.nan
    home: Array = field(default_factory=lambda: np.full(5, np.nan))
    has_moved: bool = False
    motion: Array = field(default_factory=lambda: np.zeros((2, 2)))
    samples: Array = field(default_factory=lambda: np.zeros((0, 3)))
    weights: Array = field(default_factory=lambda: np.zeros(0))
    efficiency: float = 1.0
    histogram: Array | None = None
    appearance: Array | None = None
    n_appearance: int = 0
    mixed: int = 0
    n_several: int = 0
    is_named: bool = False

    def replace(self, **changes: Any) -> Track:
        """A copy with other values: `dataclasses.replace`, which takes 40 us for so many fields, in one."""
        new = object.__new__(Track)
        new.__dict__.update(self.__dict__)
        new.__dict__.update(changes)
        return new

    @property
    def is_seen(self) -> bool:
        """Seen as a person in this very frame."""
        return self.misses == 0

    @property
    def std_m(self) -> Array:
        """Standard deviation of xyz along the axes, (3,) m."""
        return np.sqrt(np.diagonal(self.covariance))


@dataclass(frozen=True, eq=False)
class LostPerson:
    """A person who was confirmed and is gone: id, colours, where and when last seen (frame)."""

    person: int
    appearance: Array | None
    xyz: Array
    frame: int


@dataclass(frozen=True, eq=False)
class TrackerState:
    """What the next step needs.

    tracks : live tracks.  frame : last frame, None before the first.  confirmed_ids : ids that were given to somebody.
    lost : persons who may return.  n_serials : tracks created so far.
    """

    tracks: tuple[Track, ...] = ()
    frame: int | None = None
    confirmed_ids: frozenset[int] = frozenset()
    lost: tuple[LostPerson, ...] = ()
    n_serials: int = 0


@dataclass(frozen=True, eq=False)
class TrackInfo:
    """What people, plots and the pose stage need of one step.

    tracks : live tracks after the step.  voxels_of : person -> ascending indices into `centers`; one entry
    per live track, empty where it coasts; the sets are disjoint.  features_of : of those voxels.
    created : ids.  deleted : id -> reason ("merged", "lost", "unconfirmed").  exchanged : pairs of ids whose
    tracks were exchanged by colour.  recognised : ids that a returning person got back.
    n_components : components in the input.  n_unassigned : voxels that belong to nobody.
    """

    frame: int
    tracks: tuple[Track, ...]
    voxels_of: dict[int, Indices]
    features_of: dict[int, BlobFeatures]
    created: tuple[int, ...] = ()
    deleted: dict[int, str] = field(default_factory=dict)
    exchanged: tuple[tuple[int, int], ...] = ()
    recognised: tuple[int, ...] = ()
    n_components: int = 0
    n_unassigned: int = 0
