"""Edits by hand: applied on every re-run, they mend what they speak of and leave the rest as it was."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from two_persons import CONFIG, exchange_tracks, two_persons_run, two_persons_session

from mocap.body import landmarks_of
from mocap.body.model import load_body_model
from mocap.errors import MocapError
from mocap.filters.refine import RefineSettings, refine
from mocap.io.session import open_session
from mocap.io.store import StageStore
from mocap.io.tables import read_landmarks_csv
from mocap.pipeline.edits.model import Edits, parse_edits, read_edits, with_edit, without_last
from mocap.pipeline.keys import stage_keys
from mocap.pipeline.run import run_session
from mocap.pipeline.stage import Job
from mocap.pipeline.stages import pose as pose_stage
from mocap.pose.edits import Exchange, Pin, PoseEdits, edited, exchanged
from mocap.pose.point_fit import PointFit
from mocap.pose.result import FollowedPerson
from mocap.products.followed import stored_followed

TABLES = ("pose.npz", "landmarks.csv", "tracks.csv")


@pytest.fixture
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.getbasetemp()


@pytest.fixture
def session(base: Path) -> Path:
    return two_persons_session(base)


@pytest.fixture
def out(base: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(two_persons_run(base), tmp_path / "out"))


def tables(out: Path) -> dict[str, bytes]:
    return {name: (out / name).read_bytes() for name in TABLES}


def edit(out: Path, **values: object) -> None:
    path = out / "edits.toml"
    path.write_text(with_edit(path.read_text() if path.exists() else "", values))


def again(session: Path, out: Path, monkeypatch: pytest.MonkeyPatch | None = None) -> list[int]:
    """Resume the run; the persons that were followed anew."""
    followed: list[int] = []
    follow = pose_stage.follow_frames

    def noted(clip, *rest, **named):  # type: ignore[no-untyped-def]
        followed.append(clip.person)
        return follow(clip, *rest, **named)

    if monkeypatch is not None:
        monkeypatch.setattr(pose_stage, "follow_frames", noted)
    result = run_session(session, out, config=CONFIG, resume=True)
    assert {"segment", "carve", "track"} <= set(result.reused)
    return sorted(followed)


def test_exchanged_tracks_are_mended_to_the_last_bit(session: Path, out: Path) -> None:
    right = tables(out)
    exchange_tracks(out, range(3, 7))
    again(session, out)
    wrong = np.load(out / "pose.npz")["person_1_landmarks_m"]
    true = np.load(two_pose(right, out))["person_1_landmarks_m"]
    assert np.linalg.norm(wrong - true, axis=2).mean() > 0.3, "the exchange did harm"
    edit(out, do="swap", persons=[1, 2], frames="3:7")
    again(session, out)
    assert tables(out) == right


def two_pose(right: dict[str, bytes], out: Path) -> Path:
    path = out.parent / "right.npz"
    path.write_bytes(right["pose.npz"])
    return path


def test_a_split_and_a_merge_undo_each_other(session: Path, out: Path) -> None:
    right = tables(out)
    edit(out, do="split", person=2, frames="5:")
    again(session, out)
    persons = np.load(out / "pose.npz")["persons"].tolist()
    assert persons == [1, 2, 3]
    edit(out, do="merge", persons=[2, 3])
    again(session, out)
    assert tables(out) == right


def test_a_run_anew_gives_the_same_bytes_as_one_taken_up(session: Path, out: Path, tmp_path: Path) -> None:
    place = np.load(out / "pose.npz")["person_1_landmarks_m"][4][5] + (0.0, 0.0, 0.05)
    edit(out, do="pin", person=1, landmark="left_wrist", frame=4, place_m=place.tolist())
    edit(out, do="bad", person=2, frames="2:4")
    edit(out, do="exchange", person=2, frames="7:", sides="arms")
    again(session, out)
    fresh = tmp_path / "fresh"
    fresh.mkdir()
    shutil.copy(out / "edits.toml", fresh)
    result = run_session(session, fresh, config=CONFIG)
    assert tables(fresh) == tables(out)
    assert (fresh / "edits.toml").read_text() == (out / "edits.toml").read_text(), (
        "a run leaves the file alone"
    )
    assert any("3 edits by hand" in warning for warning in result.warnings)
    observed = np.load(out / "pose.npz")["person_2_observed"]
    assert not observed[2:4].any()
    assert observed[[1, 4]].any(axis=1).all()


def test_only_who_is_concerned_is_followed_again(
    session: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    right = tables(out)
    edit(out, do="bad", frames="4:5")
    assert again(session, out, monkeypatch) == []
    edit(out, do="delete", person=2, frames="8:")
    assert again(session, out, monkeypatch) == [2]
    assert np.load(out / "pose.npz")["person_2_frames"].max() == 7
    (out / "edits.toml").write_text("")
    assert again(session, out, monkeypatch) == [2]
    assert tables(out) == right


def test_edits_change_the_key_of_poses_alone(session: Path, out: Path) -> None:
    opened = open_session(session)
    edit(out, do="bad", frames="4:5")
    first = read_edits(out / "edits.toml")
    (out / "edits.toml").write_text("# a comment\n" + (out / "edits.toml").read_text())
    moved = read_edits(out / "edits.toml")
    plain, one, other = (
        stage_keys(opened, CONFIG.model_copy(update={"edits": edits}), 0) for edits in (Edits(), first, moved)
    )
    assert one == other, "where an edit stands in the file does not matter"
    assert {name for name in plain if plain[name] != one[name]} == {"pose"}


def followed_person(session: Path, out: Path) -> tuple[pose_stage.PoseWork, FollowedPerson]:
    store, opened = StageStore(out / "store.zarr"), open_session(session)
    keys = {int(p): about["key"] for p, about in store.reader("pose-frames").attrs["persons"].items()}
    model = load_body_model(CONFIG.body_model("voxels"))
    work = pose_stage.PoseWork(Job(opened, CONFIG, store))
    found = stored_followed(store, keys, model, work.tools_of)
    assert sorted(found) == [1, 2]
    return work, found[1]


def put_right(session: Path, work: pose_stage.PoseWork, one: FollowedPerson) -> None:
    """Give a person, in place, the poses that the truth's landmarks and the frames' evidence lead to."""
    body, evidence_of = one.body, work.evidence_of(one)
    n, settings = body.layout.n_columns, {"residual_std_m": 1.0, "n_iterations": 30}
    roots = landmarks_of(body, one.series.states)[:, 0]
    persons = read_landmarks_csv(session / "truth" / "landmarks.csv")
    truth = min(persons, key=lambda p: np.linalg.norm(p.landmarks[: len(roots), 0] - roots, axis=1).mean())
    for row, places in enumerate(truth.landmarks[: len(roots)]):
        known = slice(len(places))
        fit = PointFit(body, body.landmark_joint[known], body.landmark_offset[known], places)
        state, _ = refine(fit, one.series.states[row], RefineSettings(np.full(n, 1e3), **settings))
        evidence = evidence_of(row)
        assert evidence is not None
        one.series.states[row] = evidence.refined(state)


def test_a_pin_pulls_a_wrong_wrist_right_and_its_neighbours_follow(session: Path, out: Path) -> None:
    work, one = followed_person(session, out)
    put_right(session, work, one)
    body, wrist = one.body, one.body.landmarks.index("left_wrist")
    arm = np.flatnonzero([name.startswith(("left_shoulder", "left_elbow")) for name in body.layout.names])
    right = landmarks_of(body, one.series.states)[:, wrist]
    wrong = range(3, 8)
    for row in wrong:
        one.series.states[row, arm] = np.clip(
            one.series.states[row, arm] + 0.9, body.layout.lower[arm], body.layout.upper[arm]
        )
    apart = np.linalg.norm(landmarks_of(body, one.series.states)[:, wrist] - right, axis=1)
    assert apart[list(wrong)].min() > 0.3
    place = right[5]
    pins = PoseEdits(pins=(Pin(int(one.frames[5]), "left_wrist", tuple(place.tolist())),))
    one = replace(one, series=replace(one.series, settled=np.ones_like(one.series.settled)))
    mended = edited(one, pins, work.evidence_of(one))
    moved = np.any(mended.series.states != one.series.states, axis=1)
    np.testing.assert_array_equal(mended.series.settled.all(axis=1), ~moved)
    assert moved[5]
    assert not mended.series.settled[moved].any()
    left = np.linalg.norm(landmarks_of(body, mended.series.states)[:, wrist] - right, axis=1)
    assert left[5] < 0.02
    assert left[list(wrong)].max() < 0.1, "the evidence carries the arm to the frames beside"
    assert left[[0, 1, 9]].max() == 0.0
    assert mended.series.observed[5, wrist]


def test_bad_frames_are_bridged_and_grow_uncertain(session: Path, out: Path) -> None:
    work, one = followed_person(session, out)
    mended = edited(one, PoseEdits(bad=(range(3, 7),)), work.evidence_of(one))
    plain = ~one.body.layout.is_circular
    steps = np.diff(mended.series.states[2:8, plain], axis=0)
    np.testing.assert_allclose(steps, np.tile(steps[:1], (5, 1)), atol=1e-12, err_msg="straight on")
    assert not mended.series.observed[3:7].any()
    blind = mended.series.blind_std
    assert blind[[3, 4, 5, 6]].min() > 0
    assert blind[4] > blind[3]
    assert blind[2] == one.series.blind_std[2]
    assert np.array_equal(mended.series.states[:3], one.series.states[:3])


def test_a_body_that_is_turned_has_its_sides_exchanged(session: Path, out: Path) -> None:
    _, one = followed_person(session, out)
    names = one.body.landmarks
    places = landmarks_of(one.body, one.series.states)
    striding = np.linalg.norm(
        places[:, names.index("left_knee")] - places[:, names.index("right_knee")], axis=1
    )
    state = one.series.states[np.argmax(striding)]
    for sides, moving in (("body", ("knee", "wrist")), ("legs", ("ankle",)), ("arms", ("wrist",))):
        both = landmarks_of(one.body, np.stack([state, exchanged(one.body, state, sides)]))
        for name in moving:
            left, right = names.index(f"left_{name}"), names.index(f"right_{name}")
            apart, left_over = (np.linalg.norm(pose[left] - both[0, right]) for pose in both)
            # An arm reaches for the place of the other one as far as its shoulder lets it.
            assert left_over < 0.5 * apart, (sides, name)
    still = names.index("left_wrist")
    turned = landmarks_of(one.body, np.stack([state, exchanged(one.body, state, "legs")]))
    assert np.linalg.norm(turned[1, still] - turned[0, still]) < 1e-3
    assert PoseEdits(exchanges=(Exchange(range(3)),))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('do = "swp"\npersons = [1, 2]', ["line 2", "'swp'", "did you mean 'swap'"]),
        ('do = "swap"\npersons = [1, 7]', ["line 2", "no person 7", "there are 1, 2"]),
        ('do = "swap"\npersons = [1, 1]', ["line 2", "both persons are 1"]),
        ('do = "swap"\npersons = [1]', ["line 2", "swap", "persons"]),
        ('do = "swap"\nperson = 1\npersons = [1, 2]', ["line 2", "person", "did you mean 'persons'"]),
        ('do = "merge"\npersons = [1, 2]', ["line 2", "both there in 10 frames from 0 on"]),
        ('do = "delete"\nperson = 1\nframes = "5:50"', ["line 2", "5:50", "frames 0 to 9"]),
        ('do = "delete"\nperson = 1\nframes = "5-9"', ["line 2", "write a:b"]),
        ('do = "bad"\nperson = 1\nframes = ":"', ["line 2", "all frames of person 1 are bad"]),
        ('do = "pin"\nperson = 1\nlandmark = "left_rist"\nframe = 3\nplace_m = [0, 0, 1]', ["left_wrist"]),
        ('do = "pin"\nperson = 1\nlandmark = "left_wrist"\nframe = 3', ["line 2", "place_m", "seen_px"]),
        (
            'do = "pin"\nperson = 1\nlandmark = "head"\nframe = 3\nseen_px = { cam_0 = [1, 2] }',
            ["one camera"],
        ),
        (
            'do = "pin"\nperson = 1\nlandmark = "head"\nframe = 3\nseen_px = { cam_0 = [1, 2], cm_1 = [3, 4] }',
            ["line 2", "no camera 'cm_1'", "did you mean 'cam_1'"],
        ),
        (
            'do = "pin"\nperson = 1\nlandmark = "head"\nframe = 3\nseen_px = { cam_0 = [1, 2], cam_1 = [3, 180] }',
            ["line 2", "show different places"],
        ),
        (
            'do = "pin"\nperson = 1\nlandmark = "left_wrist"\nframe = 3\nplace_m = [1.5, 1.5, 1]',
            ["line 2", "cannot reach", "left_wrist", "frame 3", "m are missing"],
        ),
        (
            'do = "exchange"\nperson = 1\nframes = "2:6"\n\n[[edit]]\ndo = "exchange"\nperson = 1\nframes = "5:8"',
            ["line 7", "line 2 exchanges the same sides"],
        ),
        (
            'do = "bad"\nframes = "2:6"\n\n[[edit]]\ndo = "pin"\nperson = 1\nlandmark = "head"\nframe = 3\n'
            "place_m = [0, 0, 1.7]",
            ["line 6", "marked as bad by line 2"],
        ),
        (
            'do = "split"\nperson = 1\nframes = "5:"\nnew = 2',
            ["line 2", "both there in 5 frames from 5 on"],
        ),
    ],
)
def test_bad_edits_are_one_clear_error(session: Path, out: Path, text: str, words: list[str]) -> None:
    before = tables(out)
    (out / "edits.toml").write_text(f"# edits\n[[edit]]\n{text}\n")
    with pytest.raises(MocapError) as caught:
        run_session(session, out, config=CONFIG, resume=True)
    for word in [*words, "edits.toml", "Remedy"]:
        assert word in str(caught.value)
    assert tables(out) == before
    (out / "edits.toml").unlink()
    assert set(run_session(session, out, config=CONFIG, resume=True).reused) >= {"track", "pose"}


def test_a_pin_in_two_pictures_is_where_their_rays_meet(session: Path, out: Path) -> None:
    from mocap.pipeline.edits.meaning import placed

    rig = open_session(session).rig
    point = np.array([[-0.7, 0.1, 1.1]])
    seen = {name: [float(v) for v in rig[name].project(point)[0][0]] for name in ("cam_0", "cam_1", "cam_3")}
    text = with_edit("", {"do": "pin", "person": 1, "landmark": "head", "frame": 3, "seen_px": seen})
    (pin,) = placed(parse_edits(text, Path("edits.toml")), rig, CONFIG.method.edits).edit
    np.testing.assert_allclose(pin.place_m, point[0], atol=1e-4)


def test_the_file_grows_and_shrinks_edit_by_edit() -> None:
    text = with_edit("", {"do": "swap", "persons": [1, 2], "frames": None})
    both = with_edit(text, {"do": "bad", "frames": "1:2"})
    assert len(parse_edits(both, Path("x")).edit) == 2
    assert without_last(both)[0] == text
    nothing, last = without_last(text)
    assert "swap" in last
    assert not parse_edits(nothing, Path("x"))
    with pytest.raises(ValueError, match="no edit"):
        without_last(nothing)
