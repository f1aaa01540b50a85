"""Numbers of the pose method: every constant that decides a pose, named, with its unit and its reason.

The configuration holds them as its section `[method]`: the defaults fix them, an experiment may change them, as in
`--set method.limb_search.turn_frames=2`, and run.json keeps them. Numbers without another word were chosen on
development scenes with `python -m eval.pose_sessions`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar


class _Strict:
    """Settings that a configuration may hold: unknown keys are refused there."""

    __pydantic_config__: ClassVar[Mapping[str, str]] = {"extra": "forbid"}


@dataclass(frozen=True)
class EvidenceSettings(_Strict):
    """What a pose is judged by in one frame of volumes."""

    crop_margin_m: float = 0.3
    """How far beyond the hull particles may meet themselves."""
    hidden_reach_m: float = 0.9
    """How far beyond the hull hidden limbs may lie where nothing is known: the length of a leg."""
    cut_off_m: float = 0.35
    """A hull that ends higher, with the unknown below, is that of somebody whose legs are hidden."""
    upright_share: float = 0.85
    """Of the standing height, which the head of somebody upright exceeds."""
    hidden_leg_std_rad: float = 0.3
    """How far the angles of such legs are from 0: half a nat at this angle, 14 at a bent hip of 90 degrees, which the
    surface of a hull that is too wide is worth."""
    shared_leg: float = 0.1
    """Among furniture a lower leg that lies in other parts by more than this share is not observed. Free legs
    have 0.03 at most (19 of 20 frames), two in the volume of one 0.11 to 0.24 (scene `furnished_place`)."""
    min_voxels: int = 200
    """Fewer (1.6 litres at 2 cm) are no body: the pose is carried on instead."""
    nats_per_m2: float = 90_000.0
    """Evidence per square metre of mean surface cost: the lost arm of a person, a tenth of the surface, is worth about
    7 nats."""
    refine_std_m: float = 0.1
    """How far the root may be expected to move in a refinement."""
    refine_std_rad: float = 0.5
    """How far a joint may be expected to turn in a refinement."""
    refine_iterations: int = 7
    """Most iterations of a refinement."""
    refine_reach: float = 1.6
    """Factor on its steps: hull and outlines pull by a loss that bends away from the squares, and plain steps come two
    thirds of the way. Six of these come as near as ten (`dev:walk`, `dev:reach`)."""
    coarse_hull_points: int = 400
    """Points of the hull in the brief attempts of a start."""
    coarse_flesh_points: int = 150
    """Points of the body in the brief attempts of a start."""
    observed_occupancy: float = 0.5
    """Share of a part's flesh in occupied voxels from which its landmarks count as observed, and of the flesh of
    each."""
    observed_near: float = 0.05
    """How far around a landmark its flesh reaches, of the height: an ankle's is the end of the shank."""
    min_judges: int = 2
    """Cameras that must have a landmark in their picture, with nothing known to stand before it: one tells no depth."""
    colour_max_double: float = 0.15
    """A part that overlaps others by a larger share teaches no colours."""
    colour_min_occupancy: float = 0.6
    """A part that lies in the hull by a smaller share teaches no colours."""
    texture_frames: int = 60
    """Frames of a clip, evenly spread, that its texture is learnt from; twice as many teach no more, and nor do half as
    many (decision 71)."""
    unexplained_m: float = 0.05
    """A point of the hull further than this from the body is not explained by it."""


@dataclass(frozen=True)
class StartSettings(_Strict):
    """The first pose of a person: many kinds of poses in all directions, the promising ones followed."""

    window_s: float = 2.0
    """Seconds in the middle of a person's frames in which the first pose is looked for: from there a clip is followed
    to both ends side by side."""
    standing_share: float = 0.95
    """Somebody stands whose head is above this share of his height. Who does not in the middle is looked at when he
    does: who sits says less of how large he is, and a chair may be one with him (decision 92)."""
    small_nats: float = 60.0
    """By so much more a first pose of somebody small who stands must explain a low volume than one of somebody who sits
    or crouches in it. Seven children gained 220 to 357, twelve people who sit or crouch lost 172 to gained 27 (decision
    110), five tall men who sit at a table lost 21 to 64 (decision 113); a child who walks with a rucksack gained 58."""
    pelvis_share: float = 0.45
    """Who walks does not sit, and nor does he whose pelvis is higher, of his height: 0.50 to 0.52 in first poses of who
    stands, 0.32 to 0.40 of who sits at a table (decision 113). The better of the two is taken then."""
    n_directions: int = 16
    """Directions that each kind of pose is tried in."""
    n_copies: int = 8
    """Particles around each candidate; its value is that of the best."""
    search_std_m: float = 0.06
    """Noise of the root around each candidate."""
    search_std_rad: float = 0.2
    """Noise of the angles around each candidate."""
    brief_factor: int = 4
    """Candidates followed briefly, per candidate that is followed to the end (`pose.n_first_poses`)."""
    brief_layers: int = 4
    """Annealing layers of a brief attempt."""
    brief_particles: int = 80
    """Particles of a brief attempt."""
    brief_survival_rate: float = 0.5
    """Survival rate of a brief attempt."""
    brief_iterations: int = 5
    """Of the refinement after a brief attempt."""
    thorough_layers: int = 8
    """Annealing layers of an attempt to the end."""
    thorough_particles: int = 200
    """Its particles."""
    thorough_survival_rate: float = 0.6
    """Its survival rate."""
    thorough_iterations: int = 8
    """Of the refinement after it."""
    n_opposite: int = 3
    """Candidates that face against the best one and are followed too: a person from behind has the silhouette of one
    from the front."""
    same_nats: float = 25.0
    """Poses are followed to the end in one frame after the other, the most promising first, until two are explained
    alike, by so much; the better one counts. A third was asked in 8 of 21 searches, and wrong poses cost 20 to 120
    (decision 115)."""
    n_searched: int = 3
    """Settled poses whose limbs are searched for."""
    max_limbs: int = 4
    """Limbs searched for in each of them."""
    facing_nats: float = 8.0
    """Cost of facing against the direction of walking; CF 6.3.3 takes that direction as a certainty."""
    walking_m_s: float = 0.3
    """A slower person does not say by his path which way he faces."""
    walking_window_s: float = 0.25
    """How far each way the velocity is read from the track."""
    trial_s: float = 3.0
    """How far each way two starting hypotheses are followed to compare them."""
    trial_stride_frames: int = 3
    """Between frames of that comparison."""
    trial_layers: int = 4
    """Annealing layers of the filter that follows them."""
    trial_particles: int = 200
    """Its particles."""
    decisive_nats: float = 25.0
    """One frame decides alone when its two hypotheses are this far apart."""
    decisive_share: float = 0.3
    """And by this share of what it says against the better one: a body turned round explained a volume without legs
    better by 37 nats of 180 in one frame, and not at all over its four seconds (decision 134)."""
    clear_facing_nats: float = 3.0
    """Hypotheses that end nearer to each other than this leave the facing open: a warning says so."""
    short_frames: int = 10
    """A clip with fewer usable frames is too short to compare hypotheses over time."""
    short_factor: int = 3
    """Factor on `pose.n_first_poses` there: no motion will tell front from back."""
    max_evaluations: int = 160_000
    """Most poses that are scored in one person's search, brief and thorough attempts of all frames together:
    `pose.n_first_poses` is lowered to what they allow. The default takes 53,000 to 88,000 in its three frames, a clip
    of two 151,000; with half of that one of 18 pairs of frames of development sessions was started worse (51 mm instead
    of 34, when one of the two was followed to the end)."""
    crowded_share: float = 0.4
    """Share of a hull's surface that the body leaves unexplained, from which it holds much else than the person, if the
    silhouettes do too."""
    crowded_outline_share: float = 0.3
    """Share of their outlines that lies beside the body then. Two cameras leave as much of a hull unexplained (0.45 to
    0.52) as a chair (0.50), but hardly any outline: 0.01 to 0.10, as seven cameras do; with the chair it is 0.34 to
    0.36, of who balances on one leg before four cameras 0.10 to 0.26 (decision 102)."""
    crowded_outline_weight: float = 0.3
    """Largest weight of outlines there: a chair's outlines are not the person's. On a real person who sits still on a
    chair (426 frames, judged by eye) weights of 1 and 3 stretch a leg into the chair's (knee at 10 degrees); with 0.3
    the knees stay at 51 to 81 degrees and the hands on the thighs; with 0 and 0.5 an arm hangs beside the chair."""
    height_frames: int = 60
    """Frames, spread over the clip, that the standing height is read from."""


@dataclass(frozen=True)
class FollowSettings(_Strict):
    """Following one pose from frame to frame."""

    blind_std_m: float = 0.02
    """What a landmark may be off at once where nothing is seen; it grows with every frame by the filter's noise."""
    gone_s: float = 0.4
    """Without a volume for so long, a pose is looked for anew when the person comes back; so it is in frames so far
    apart."""
    apart_s: float = 0.08
    """Frames so far apart, or further: limbs go further in between than a search from the pose before may follow, and
    a pose is looked for anew in every frame (decision 106)."""
    few_cameras: int = 2
    """While no more show the person, a pose is looked for anew in every frame, too (decision 106)."""
    max_limbs: int = 2
    """Limbs searched for in one frame, those that promise most."""
    many_cameras: int = 5
    """While so many show the person, `pose.search_every_frames = "auto"` searches in some frames alone: what is found
    lasts. With four, wrists are lost for longer, with two and three whole arms (decision 79)."""
    rarely_frames: int = 2
    """From one search to the next there."""


@dataclass(frozen=True)
class LimbSearchSettings(_Strict):
    """When a limb counts as lost or doubtful, and how it is searched for over its whole range."""

    unexplained_share: float = 0.025
    """Share of the hull's surface points that must be unexplained before they count: a lost forearm leaves 0.04."""
    most_unexplained_share: float = 0.08
    """Share of the surface points that count at most, those furthest from the body: a lost arm leaves no more, clothes
    or a hull that are wide all over a third, which would draw every limb (decision 95)."""
    zeal: float = 4.0
    """Factor on what an unexplained point is worth in the search; what is found is judged by the evidence itself."""
    n_lost_points: int = 24
    """Unexplained points that are looked at."""
    pixel_stride: int = 4
    """Every so many pixels' colours are looked at in the search."""
    n_alternatives: int = 6
    """Other poses of a searched limb that are refined and judged."""
    alternative_iterations: int = 4
    """Of the refinement of each."""
    turn_frames: int = 4
    """Frames between searches for single limbs."""
    longest_pause_frames: int = 8
    """Longest pause between searches for all limbs while they find nothing."""
    least_misfit_nats: float = 0.5
    """A limb that fits better counts as if it fitted this badly when the next one is chosen."""
    look_again_frames: int = 10
    """Age that a limb gets which was found: it is looked at again at once, it seldom is right at first."""
    fallen_nats: float = 6.0
    """Evidence so far below the usual has fallen: all limbs are searched for."""
    find_nats: float = 1.0
    """A smaller gain is no find."""
    usual_rate: float = 0.2
    """Rate of the running mean of the usual evidence, per frame."""
    free_speed_m_s: float = 4.0
    """A landmark may move so fast without cost (`pose.jump_nats`)."""
    jump_m: float = 0.25
    """A jump by this much beyond the free speed costs all that a jump can cost."""


@dataclass(frozen=True)
class LegsSettings(_Strict):
    """Whether each leg is where it is, or where the other one is."""

    turn_frames: int = 6
    """Frames between looks, while legs are seen and told apart."""
    n_iterations: int = 7
    """Of the refinement of the exchanged legs."""
    better_nats: float = 3.0
    """Exchanged legs must be better by this much."""
    clear_nats: float = 5.0
    """Legs are told apart when exchanged ones are worse by this much. For legs that were right it was 8 nats at the
    least, 15 to 50 usually; exchanged ones gained 6 to 20 by the exchange back (a walk past low cupboards)."""
    apart_m: float = 0.1
    """A landmark that is nearer than this to its place in a pose which explains the frame almost as well is not in
    doubt."""
    std_per_apart: float = 0.4
    """Standard deviation per distance to that place: its 90 % region reaches there."""


@dataclass(frozen=True)
class RestartSettings(_Strict):
    """When a whole pose counts as lost, and how a new one is found."""

    lost_nats: float = 12.0
    """Evidence so far below what this person's poses usually reach: the pose is lost."""
    margin_nats: float = 4.0
    """A new pose must be better than the lost one by this much."""
    after_frames: int = 8
    """Frames before anything is usual."""
    memory_frames: int = 90
    """Frames that tell what is usual."""
    usual_quantile: float = 0.6
    """Quantile of the remembered evidence that counts as usual."""
    shortest_pause_frames: int = 2
    """Pause after a restart that helped."""
    longest_pause_frames: int = 32
    """A failed restart doubles the pause before the next."""
    most_lead_nats: float = 100.0
    """Most that earlier frames may say for the way a pose faces, where one that faces the other way was tried: so much
    lies between the two in a clear frame. A second clear frame turns about who was followed the wrong way round."""
    facing_cosine: float = 0.5
    """A lost pose that faces further off the direction of walking is turned into it."""
    std_factor: float = 0.5
    """Factor on the start's search noise: where the person is and faces is known."""
    brief_layers: int = 4
    """Annealing layers of a brief attempt."""
    brief_particles: int = 80
    """Particles of a brief attempt."""
    brief_survival_rate: float = 0.5
    """Survival rate of a brief attempt."""
    thorough_layers: int = 6
    """Annealing layers of an attempt to the end."""
    thorough_particles: int = 200
    """Its particles."""
    thorough_survival_rate: float = 0.6
    """Its survival rate."""
    n_settled: int = 2
    """Brief attempts that are followed to the end."""


@dataclass(frozen=True)
class RepairSettings(_Strict):
    """Limbs that jump from one frame to the next: what was known on one side is carried to the other."""

    jump_m: float = 0.15
    """A jump is a move by this much beyond what a limb may move in a frame; an elbow or a wrist has jumped when it has
    moved further than that."""
    fast_m_s: float = 3.0
    """What a limb may move."""
    same_m: float = 0.08
    """Nearer than this, the carried limb has met the other one: the jump is gone."""
    joined_nats: float = 6.0
    """What it is worth that a jump vanishes."""
    give_up_nats: float = 12.0
    """A carried limb whose gain falls so far below its best is followed no further."""
    largest_nats: float = 8.0
    """Most that one frame may gain or lose, so that no single frame decides."""
    n_iterations: int = 7
    """Of the refinement in each frame."""
    turn_s: float = 0.2
    """Who faces another way after so short a time ..."""
    turn_cosine: float = -0.5
    """... by more than 120 degrees has not turned about, but was followed the wrong way round before or after."""


@dataclass(frozen=True)
class EditSettings(_Strict):
    """Edits by hand: how far a pin is believed."""

    pin_std_m: float = 0.01
    """Standard deviation of a place that somebody has given: what a hand and two pictures are good for."""
    reach_m: float = 0.15
    """A pin that the stretched limb misses by more is a mistake: what sizes and collar bones leave open."""
    view_share: float = 0.02
    """Share of the picture's width by which the places in several pictures may miss each other: a body part's width."""


@dataclass(frozen=True)
class DoubtSettings(_Strict):
    """Which frames are worth looking at: each number is what counts as one unit of doubt, or is usual and counts as
    none. They order a list and decide no pose."""

    usual_std_m: float = 0.03
    """Deviation of a landmark that is nothing unusual: that of a wrist in full view."""
    std_m: float = 0.1
    """Beyond it, one unit: the landmark may be in another limb."""
    unseen_share: float = 0.4
    """Share of the landmarks that are not observed: two limbs."""
    fast_m_s: float = 6.0
    """What the fastest hand of a person who walks, runs or boxes moves; beyond it a landmark jumps."""
    jump_m: float = 0.1
    """One unit."""
    usual_nats: float = 3.0
    """How far the likelihood of a frame may lie below the median."""
    fallen_nats: float = 10.0
    """Beyond it, one unit: what a lost limb costs."""
    least: float = 0.5
    """Less doubt is not listed."""
    told: float = 0.15
    """A smaller part of the doubt is no reason that is told."""
    together_s: float = 0.2
    """Doubtful frames no further apart are one entry of the list."""


@dataclass(frozen=True)
class SizeSettings(_Strict):
    """The size of a person at which refined poses explain the volumes best."""

    stride_s: float = 0.1
    """Between frames that are looked at."""
    n_frames: int = 6
    """Frames the size is fitted to, those that are explained best: a limb that is lost says nothing of the size."""
    below_std: float = 0.01
    """Standard deviation of the logarithm of the size below the head's highest place: a lower bound, but for the hull's
    grain."""
    above_std: float = 0.04
    """The same above it: how far below his height a person may hold the head is not known."""
    unseen_std: float = 0.06
    """Of a usual height, taken for someone whose head was never high enough to say anything."""
    girth_std: float = 0.08
    """Standard deviation of the logarithm of the girth."""
    frames_worth: float = 2.0
    """Body and person differ in more than size, in all frames alike: however many frames, they count as so many."""
    step: float = 0.03
    """Of the search, in the logarithm of the size."""
    girth_step: float = 0.08
    """Of the search, in the logarithm of the girth."""
    own_girth: float = 0.05
    """Whose girth differs more from the usual one, in its logarithm, has girths of his own: who wears wide clothes, who
    is stout or slim (decision 119)."""
    girth_cameras: int = 3
    """Before fewer cameras nobody has: two leave hulls that are wider than who is in them."""
    apart_std: float = 0.1
    """Standard deviation of the logarithms of his girths from their common one."""
    n_girth_passes: int = 2
    """So often all of them are walked downhill, one after the other."""
    own_step: float = 0.015
    """Of the size meanwhile."""
    furthest_steps: int = 5
    """Steps that the search may go."""
    n_refinements: int = 5
    """Iterations of the refinement at every size tried."""
    same_size: float = 0.01
    """Change of the logarithm of the size for which nobody is followed once more."""


@dataclass(frozen=True)
class LoadSettings(_Strict):
    """When somebody wears something on the trunk, or holds it before the trunk (decisions 111, 117)."""

    unexplained_share: float = 0.1
    """It is looked for where half of the frames leave more of the hull's surface unexplained: with a rucksack .11 to
    .43, in fitted clothes and a clean room .02 to .10."""
    n_times: int = 2
    """So often its owner is followed with it. With 1 an arm that was lost in it may stay there (decision 117)."""
    n_frames: int = 32
    """Frames, spread over the clip, that are looked at."""
    walked_m: float = 1.0
    """Who has not gone so far, and"""
    turned_rad: float = 1.0
    """has not turned so much, wears nothing: a chair stays with somebody who sits on it, too, and so does what cameras
    on one side leave of a hull."""
    reach_m: float = 0.5
    """How far from the joint of the upper trunk. With .7 a bag in the hand counts, which swings (13.8 mm after offsets
    instead of 11.9)."""
    cell_m: float = 0.02
    """Side of the cells in which hulls are counted."""
    deep: float = 0.034
    """Of the height: what is further from all flesh tells a load from wide clothes; 6 cm of 1.75 m."""
    share: float = 0.6
    """Share of the frames in which a cell must be filled."""
    judged_share: float = 0.25
    """Least share of the frames that say something of a cell behind the trunk: where a limb is, they say nothing."""
    judged_before: float = 0.375
    """The same before the trunk, where hands hold things: where the other side's limb would be they say nothing, too.
    With .25 or .5 arms beside a box are lost in it; with .5 behind the trunk, too, arms are lost in a rucksack
    (decision 117)."""
    least: float = 0.0004
    """So much of it in one piece, of the height's cube: two litres of who is 1.7 m tall. Rucksacks have 5 to 21 litres
    there, people who walk in fitted clothes .2, in wide ones .6, among furniture up to 1.6."""
    beyond_m: float = 0.02
    """The load itself begins so far from the flesh."""
    n_balls: int = 16
    """Balls that it is made of, at most."""
    least_radius_m: float = 0.03
    """Of the smallest."""


@dataclass(frozen=True)
class ThingSettings(_Strict):
    """When what was tracked as a person is a thing, and is left out (decision 120)."""

    least_s: float = 1.0
    """Who is there for less time is not asked."""
    watched_s: float = 4.0
    """Live, where nobody knows what comes: the last so many seconds are asked."""
    stays_m: float = 0.1
    """A thing is no further from its place, in"""
    stays_share: float = 0.9
    """this share of the frames: who passes it moves the centre of its volume."""
    misfit_nats: float = 30.0
    """Half of the frames leave more unexplained by the body's parts: boxes have 33 to 57, people who keep still at most
    25, and those sit (decision 120)."""
    n_looks: int = 24
    """Frames, spread over its track or over the seconds that are asked, whose colours are compared."""
    seen_share: float = 0.6
    """Share of them in which a voxel must be on the surface."""
    colour_levels: float = 2.0
    """Mean change of its colours, grey levels of 255: boxes have .5 to 1.5, people who stand or gesture 2.4 and more,
    who sits like a statue .8 (decision 120)."""
    head_depths_m: tuple[float, ...] = (0.12, 0.18)
    """So far below the highest place the middle of a head is, and its lower half."""
    head_slab_m: float = 0.06
    """Height of the slab that is measured there."""
    head_m2: float = 0.05
    """Section of the volume from which that is no head: people have .02 to .04, boxes under a roof of what no camera
    sees .07 to .29 (decision 120)."""
    head_top_m: float = 1.0
    """No head is lower: of who sits on a chair it is at 1.2 m. Boxes of .9 m may have a roof as narrow as a head."""


@dataclass(frozen=True)
class SmoothSettings(_Strict):
    """The smoother over whole clips. Half the acceleration blurs a jog, twice leaves jitter."""

    noise_m: float = 0.006
    """Noise of a point of the body between frames."""
    noise_per_nat_m: float = 0.007
    """Its growth per nat of misfit."""
    acceleration_m_s2: float = 25.0
    """Half of the largest expected acceleration."""
    handle_m: float = 0.15
    """Arm of the points that hold a joint's direction."""
    n_iterations: int = 10
    """Of the body's fit to the smoothed points."""


@dataclass(frozen=True)
class ContactSettings(_Strict):
    """When heels and toes rest on the floor, and how firmly they are held there; of bodies that have feet."""

    height_std_m: float = 0.015
    """How much the height of a point that rests varies: soles roll and shoes are soft."""
    speed_std_m_s: float = 0.18
    """How fast a point that rests seems to be."""
    lift_m: float = 0.15
    """Heights of a heel or toe in the air go so far."""
    swing_m_s: float = 1.5
    """Speed of a point in the air."""
    still_share: float = 0.2
    """Share of the points in the air that are as slow as one that rests."""
    usual_s: float = 0.3
    """How long a contact or a swing usually lasts."""
    least_stance_s: float = 0.08
    """A foot that is down for less has not stood: sprinters stand for longer."""
    most_nats: float = 8.0
    """A single frame speaks no louder for or against a contact."""
    low_quantile: float = 0.15
    """Share of the frames in which a point is lower than the height at which it rests."""
    most_level_m: float = 0.06
    """A sole that rests farther from the floor than this is no sole that rests."""
    least_observed: float = 0.5
    """A foot that is observed in a smaller share of the frames is not judged."""
    tilt_spread_m: float = 0.15
    """Contacts that lie nearer together, across, do not tell how the floor is tilted."""
    down_m: float = 0.02
    """A heel that is higher than this above its usual lowest place is not down."""
    floor_off_m: float = 0.05
    """Feet that stand farther from the calibration's floor are told of: on development sessions whose floor is right
    they stand 1 to 3.5 cm over it, by shoes and by what legs differ in."""
    floor_tilt_deg: float = 1.5
    """A floor that falls more steeply is told of."""
    hold_s: float = 0.4
    """A point is held where it rests within about this time."""
    hold_speed_m_s: float = 1.2
    """A point that moves as fast is held with 0.6 of the weight, one of three times the speed hardly."""
    hold: float = 30.0
    """Weight of a point that rests in the fit of the body to the smoothed points, against 1 of every other; 0 = none.
    With this, the time and the speed above a planted heel or toe moves by 3 to 5 mm instead of 19 (`python -m eval.feet
    --only walk,dev:steps`)."""


# Standard deviation, m, of a landmark of a pose that fits perfectly, and its growth per nat of its limb's misfit:
# fitted on development scenes by `python -m eval.pose_coverage --preset realtime --fit`, and printed there.
UNCERTAINTY: Mapping[str, tuple[float, float]] = {
    "pelvis": (0.0047, 0.004),
    "neck": (0.0156, 0.009),
    "head": (0.0073, 0.012),
    "shoulder": (0.0031, 0.007),
    "elbow": (0.0047, 0.006),
    "wrist": (0.0140, 0.006),
    "hip": (0.0083, 0.012),
    "knee": (0.0088, 0.003),
    "ankle": (0.0104, 0.003),
    "heel": (0.012, 0.003),
    "toe": (0.014, 0.004),
    "hand_tip": (0.012, 0.008),
}


@dataclass(frozen=True)
class DeviationSettings(_Strict):
    """How far off a landmark may be."""

    of_landmark: Mapping[str, tuple[float, float]] = field(default_factory=lambda: dict(UNCERTAINTY))
    """Kind of landmark -> standard deviation where the pose fits perfectly, m, and its growth per nat of misfit."""
    settled: float = 0.88
    """Share of its deviation that is left to a landmark of `settled_kinds` whose part was settled on the texture of a
    clip (`pose.texture_weight`): `python -m eval.pose_coverage --fit`."""
    settled_kinds: tuple[str, ...] = ("elbow", "wrist", "knee", "ankle")
    """Texture tells where limbs lie; what is left at the trunk is where this person's joints lie in the flesh."""
    correlated: float = 2.5
    """Neighbouring points of hull and outlines err alike: so many count as one. From the jitter of the poses of walking
    people, which is this much larger than independent residuals would make it."""
    weak_std_m: float = 0.3
    """What is known of the root without data."""
    weak_std_rad: float = 0.7
    """What is known of a joint without data."""
    most_misfit_nats: float = 15.0
    """A larger misfit counts as this one."""
    usual_unexplained: float = 0.22
    """Share of a hull's surface far from the body that is usual: clothes, the hull's own excess, a limb that is off. It
    reached 0.23 on development scenes; a hull with two persons in it has 0.5, one of three cameras 0.7."""
    astray_m: float = 0.4
    """By how much the limbs may be off there, per share beyond the usual."""
    usual_fall_nats: float = 3.0
    """How far the likelihood of a frame may lie below the median of the person's."""
    per_fallen_nat: float = 0.004
    """By how much the landmarks may be off there, m per nat: a body with a stiff trunk explains somebody who bends his
    back worse by 20 nats, and all of it is off. Where likelihoods had fallen by 6 nats and more regions of `dev:reach`
    held 73 %, and with this 97; those of four other development sessions held 97 to 100, and hold as much."""
    per_rig_offset: float = 2.0
    """By how much any landmark may be off, per metre by which lines of sight miss each other where cameras disagree."""


# Standard deviation, degrees, of an anatomical angle whose landmarks are all in place: what bodies differ in; and how
# much of the deviation that follows from the landmarks' counts: errors of neighbours are alike, and do not turn a
# segment. Fitted on development scenes by `python -m eval.angles --fit`, and printed there. What is inferred
# is not in it: synthetic people turn no forearm, and share every bend of the spine alike.
ANGLE_UNCERTAINTY: Mapping[str, tuple[float, float]] = {
    "pelvis_rotation": (2.5, 0.4),
    "pelvis_obliquity": (1.5, 0.2),
    "pelvis_tilt": (4.0, 0.3),
    "trunk_flexion": (3.5, 1.0),
    "trunk_bending": (0.5, 0.6),
    "trunk_rotation": (3.0, 0.5),
    "neck_flexion": (9.0, 0.9),
    "neck_bending": (3.0, 0.6),
    "hip_flexion": (2.5, 0.9),
    "hip_adduction": (2.0, 0.5),
    "hip_rotation": (2.5, 0.8),
    "knee_flexion": (2.0, 0.3),
    "ankle_dorsiflexion": (1.0, 0.7),
    "ankle_inversion": (4.0, 0.9),
    "mtp_extension": (8.0, 0.4),
    "shoulder_flexion": (5.5, 0.2),
    "shoulder_adduction": (3.5, 0.4),
    "shoulder_rotation": (5.0, 0.7),
    "shoulder_plane": (13.5, 1.0),
    "shoulder_elevation": (4.0, 0.4),
    "shoulder_axial_rotation": (7.0, 0.6),
    "elbow_flexion": (2.0, 0.3),
    "wrist_flexion": (5.5, 0.0),
    "wrist_deviation": (2.5, 0.2),
}


@dataclass(frozen=True)
class AngleSettings(_Strict):
    """How far off an anatomical angle may be."""

    of_angle: Mapping[str, tuple[float, float]] = field(default_factory=lambda: dict(ANGLE_UNCERTAINTY))
    """Kind of angle -> standard deviation where all its landmarks are in place, degrees, and the factor on what follows
    from the landmarks' deviations."""
    of_others: tuple[float, float] = (5.0, 1.0)
    """The same of an angle that is not listed."""
    weak_std_rad: float = 0.7
    """What is known of a joint without landmarks, where the body does not know better (`usual_std`)."""
    spine_share: float = 1.0
    """What the lumbar spine takes of a bend of the trunk, as a share of what the pelvis takes: equal parts over a whole
    bend (Esola et al. 1996)."""
    spine_std_deg: float = 10.0
    """How far the lumbar spine usually is from that."""
    bend_deg: float = 20.0
    """A knee or elbow bent by less does not show how the limb above it is turned about its own length."""


@dataclass(frozen=True)
class MarkerStartSettings(_Strict):
    """The first pose from unlabelled marker detections: points on which the cameras agree, a body fitted to them."""

    max_error_px: float = 6.0
    """Views agree on a point when it projects this near to their detections."""
    steady_m: float = 0.05
    """A marker is found again this near in a neighbouring frame; false points are not."""
    min_points: int = 5
    """Fewer points are no person."""
    n_directions: int = 24
    """Directions that each kind of pose is tried in."""
    icp_rounds: int = 8
    """Rounds of moving candidates onto the points."""
    icp_scale_m: float = 0.15
    """A point further off than this pulls little."""
    max_turn_rad: float = 0.3
    """Largest turn in a round."""
    wide_gate_px: float = 60.0
    """Gate of the filter's score while poses are far off."""
    n_followed: int = 32
    """Candidates followed by a short filter."""
    search_std_m: float = 0.06
    """Noise of the root around each candidate."""
    search_std_rad: float = 0.25
    """Noise of the angles."""
    search_layers: int = 4
    """Annealing layers of the short filter."""
    search_particles: int = 100
    """Its particles."""
    apart_m: float = 0.25
    """Candidates are different when a landmark is this far off."""
    n_looks: int = 12
    """Frames, spread over the clip, that height and number of persons are read from."""
    window_s: float = 2.0
    """Seconds in which the first pose is looked for."""
    n_window_looks: int = 12
    """Frames of these seconds that are looked at."""
    trial_frames: int = 25
    """Frames that candidates are followed for before one is taken."""
    trial_layers: int = 3
    """Annealing layers of the filter that follows them."""
    trial_particles: int = 100
    """Its particles."""
    clear_nats: float = 3.0
    """Between the best first pose and one that faces another way; nearer ones raise a warning."""
    facing_cosine: float = 0.5
    """Two poses face alike when the cosine between them is larger."""
    rough_slack_m: tuple[float, float] = (0.03, 0.01)
    """Slack of markers that are not fitted yet: before the first fit, before the second."""
    fit_s: float = 6.0
    """How far from the start, each way, body and markers are fitted."""
    good_share: float = 0.9
    """Frames whose pose explains less than this share of the usual are not fitted to: they are likely to be wrong in a
    limb."""
    bundle_reach_m: float = 0.12
    """How far a fitted marker looks for its detections."""
    other_person_m: float = 1.2
    """Steady points further from the person belong to somebody else."""
    other_points: int = 6
    """So many of them in one look are a second person."""
    other_share: float = 0.3
    """Share of the looks with so many points elsewhere from which a second person is reported."""


@dataclass(frozen=True)
class MarkerPoseSettings(_Strict):
    """The refinement of a pose on one frame of detections, and what it leaves uncertain."""

    narrow_rounds: tuple[tuple[float, int], ...] = ((0.12, 4), (0.08, 6))
    """Rounds of matching near a pose: how far markers are looked for, m, and iterations."""
    wide_rounds: tuple[tuple[float, int], ...] = ((0.25, 5), (0.15, 5), (0.08, 6))
    """The same for a pose that may be far off."""
    prior_std_m: float = 0.1
    """How far the root may be expected to move in a refinement."""
    prior_std_rad: float = 0.5
    """How far a joint may be expected to turn."""
    min_matched_markers: int = 5
    """Nothing but so many matched markers tells a body from clutter."""
    acceleration_m_s2: float = 5.0
    """Half of the largest expected acceleration of the smoother's random walk."""
    acceleration_rad_s2: float = 30.0
    """The same for angles."""
    model_std_m: float = 0.010
    """What markers do not tell of a joint: it lies somewhere under the skin."""
    near_landmark_m: float = 0.16
    """A marker this near to a landmark, at rest, shows it."""


@dataclass(frozen=True)
class BeamSettings(_Strict):
    """Several hypotheses of one pose, followed side by side over detections."""

    jump_std: float = 2.0
    """What a pose may move between frames without much cost, in the filter's noise."""
    jump_nats: float = 30.0
    """What any jump costs at most; a lost limb costs as much in two or three frames."""
    worthless_nats: float = 60.0
    """Hypotheses that are so much worse than the best are dropped."""
    apart_m: float = 0.06
    """Hypotheses are different when a landmark is this far off."""
    max_step: float = 0.25
    """rad and m per frame that a pose may go on by itself."""
    limb_gate_px: float = 20.0
    """Gate of the filter's score while a limb is searched for."""
    limb_samples: int = 300
    """Poses of the limb drawn over its whole range."""
    limb_particles: int = 100
    """Particles that the best of them become."""
    limb_layers: int = 3
    """Layers in which these close in."""
    limb_std_rad: float = 0.5
    """Their noise in the first layer."""
    feedback_share: float = 0.5
    """Share of the particles that take over the best pose, the lightest ones first."""
    lost_share: float = 0.6
    """A pose that explains less than this share of the usual is bad."""
    lost_frames: int = 8
    """So many bad frames in a row: the body is lost."""
    memory_frames: int = 60
    """Frames that tell what is usual."""
    after_pause_frames: int = 3
    """Frames after a pause before a new start: it needs neighbours to tell true points from false ones."""


@dataclass(frozen=True)
class KeypointPoseSettings(_Strict):
    """A pose from keypoints: how they pull, and how body and offsets are fitted to a clip.

    Chosen on development sessions with `python -m eval.evidence`.
    """

    scale: float = 3.0
    """Error, in standard deviations, at which a view's keypoint loses three quarters of its pull (Geman-McClure)."""
    wide_scale: float = 15.0
    """The same for poses that may be far off."""
    n_iterations: int = 12
    """Most iterations of a refinement on keypoints alone."""
    min_points: int = 5
    """Keypoints that two views must see: fewer are no body, the pose is carried on instead."""
    near_landmark_m: float = 0.12
    """A keypoint this near to a landmark, at rest, shows it."""
    worth: float = 0.1
    """What a residual is worth as evidence: views of one keypoint err alike, and for many frames."""
    lone_std_m: float = 0.1
    """Deviation of how far away somebody is whom one camera alone shows: a body's middle is not above the foot."""
    fused_worth: float = 1.0
    """The same beside volumes, with `fused_noise`: a limb on which views agree outweighs a volume that lacks it, while
    small differences, offsets of a tool perhaps, weigh as little as alone."""
    fused_scale: float = 8.0
    """As `scale`, beside volumes: views that do not agree with the others have no say there, and those that do outweigh
    a volume which lacks a whole limb."""
    fused_noise: float = 3.0
    """Factor on the deviation of keypoints beside the volumes of `tight_cameras`; with fewer it falls with their
    number: volumes of few cameras are loose, and keypoints weigh more beside them."""
    tight_cameras: int = 6
    """Cameras whose volumes are as tight as volumes get."""
    elsewhere_m: float = 0.1
    """Keypoints that pull a landmark so far from where volume and keypoints together hold it are followed there too."""
    fit_frames: int = 40
    """Frames, spread over the clip, that segment lengths and offsets are fitted to."""
    offset_std_m: float = 0.015
    """How far a tool's keypoint may lie from where the table of places says."""
    size_std: float = 0.06
    """Standard deviation of the logarithm of a person's size."""
    stretch_std: float = 0.03
    """The same of every segment, beyond the size."""
    model_std_m: float = 0.012
    """What keypoints do not tell of a joint: their offset is known only so well."""
    acceleration_m_s2: float = 5.0
    """Half of the largest expected acceleration of the smoother's random walk."""
    acceleration_rad_s2: float = 30.0
    """The same for angles."""


@dataclass(frozen=True)
class Method(_Strict):
    """The numbers of the pose method, room by room."""

    evidence: EvidenceSettings = EvidenceSettings()
    start: StartSettings = StartSettings()
    follow: FollowSettings = FollowSettings()
    limb_search: LimbSearchSettings = LimbSearchSettings()
    legs: LegsSettings = LegsSettings()
    restart: RestartSettings = RestartSettings()
    repair: RepairSettings = RepairSettings()
    edits: EditSettings = EditSettings()
    doubt: DoubtSettings = DoubtSettings()
    size: SizeSettings = SizeSettings()
    load: LoadSettings = LoadSettings()
    thing: ThingSettings = ThingSettings()
    smooth: SmoothSettings = SmoothSettings()
    contact: ContactSettings = ContactSettings()
    deviation: DeviationSettings = field(default_factory=DeviationSettings)
    angles: AngleSettings = field(default_factory=AngleSettings)
    marker_start: MarkerStartSettings = MarkerStartSettings()
    marker_fit: MarkerPoseSettings = MarkerPoseSettings()
    beam: BeamSettings = BeamSettings()
    keypoints: KeypointPoseSettings = KeypointPoseSettings()
