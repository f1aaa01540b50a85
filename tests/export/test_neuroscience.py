"""netCDF for `movement` and BIDS-Motion: read back by readers of others, and against what their makers ask for."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.io import netcdf_file

from mocap.data import ALL_LANDMARKS, LANDMARKS, Motion
from mocap.errors import MocapError
from mocap.io.formats import write_bids_motion, write_movement

FPS = 25.0
EXACT_M = 1e-12  # netCDF keeps doubles
TEXT_M = 0.5e-6  # BIDS is text of six decimals


def two_persons() -> list[Motion]:
    """Person 1 in frames 4 to 9 without frame 6, person 3 in frames 8 to 12; one landmark unknown once."""
    rng = np.random.default_rng(5)
    found = []
    for person, frames in ((1, [4, 5, 7, 8, 9]), (3, list(range(8, 13)))):
        n, at = len(frames), np.array(frames)
        found.append(
            Motion(
                person,
                at,
                at / FPS,
                rng.normal(0, 1, (n, 15, 3)),
                std=rng.uniform(0.01, 0.1, (n, 15, 3)),
                observed=rng.uniform(size=(n, 15)) > 0.4,
            )
        )
    found[0].landmarks[2, 4] = np.nan
    return found


def expected(motions: list[Motion], what: str) -> np.ndarray:
    """(P, 9, 15, 3) or (P, 9, 15): frames 4 to 12."""
    shape = np.shape(getattr(motions[0], what))[1:]
    out = np.full((len(motions), 9, *shape), np.nan)
    for p, motion in enumerate(motions):
        out[p, motion.frames - 4] = getattr(motion, what)
    return out


# ------------------------------------------------------------------------------------------------ movement


def words(variable: np.ndarray) -> list[str]:
    return [b"".join(row).rstrip(b"\0").decode() for row in variable[:]]


def test_netcdf_has_the_documented_layout_and_our_numbers(tmp_path: Path) -> None:
    motions = two_persons()
    write_movement(tmp_path / "a.nc", motions, FPS)
    with netcdf_file(tmp_path / "a.nc", "r", mmap=False) as file:
        assert file.variables["position"].dimensions == ("time", "space", "keypoints", "individuals")
        assert file.variables["confidence"].dimensions == ("time", "keypoints", "individuals")
        assert words(file.variables["keypoints"]) == list(LANDMARKS)
        assert words(file.variables["individuals"]) == ["person_1", "person_3"]
        assert words(file.variables["space"]) == ["x", "y", "z"]
        assert (file.ds_type, file.time_unit, file.source_software) == (b"poses", b"seconds", b"mocap")
        assert (file.fps, file.first_frame) == (FPS, 4)
        found = {n: v[:].copy() for n, v in file.variables.items()}
    np.testing.assert_allclose(found["time"], np.arange(4, 13) / FPS, atol=EXACT_M)
    for name, what in (("position", "landmarks"), ("std", "std")):
        np.testing.assert_allclose(
            found[name].transpose(3, 0, 2, 1), expected(motions, what), atol=EXACT_M, rtol=0
        )
    np.testing.assert_array_equal(found["confidence"].transpose(2, 0, 1), expected(motions, "observed"))


@pytest.mark.filterwarnings("ignore:numpy.ndarray size changed")  # of netCDF4, when it is imported
def test_movement_takes_it_for_its_own(tmp_path: Path) -> None:
    pytest.importorskip("movement", reason="the package movement, which no extra of ours brings")
    xarray = pytest.importorskip("xarray")
    from movement.kinematics import compute_velocity
    from movement.validators.datasets import ValidPosesInputs

    motions = two_persons()
    write_movement(tmp_path / "a.nc", motions, FPS)
    with xarray.open_dataset(tmp_path / "a.nc") as dataset:
        ValidPosesInputs.validate(dataset)
        assert dataset.attrs["fps"] == FPS
        place = dataset.position.sel(individuals="person_3", keypoints="left_wrist", space="y")
        column = LANDMARKS.index("left_wrist")
        np.testing.assert_allclose(place.values[4:], motions[1].landmarks[:, column, 1], atol=EXACT_M, rtol=0)
        speed = compute_velocity(dataset.position).sel(individuals="person_3", time=10 / FPS)
        step = (motions[1].landmarks[3] - motions[1].landmarks[1]) * FPS / 2
        np.testing.assert_allclose(speed.values.T, step, atol=1e-9)


def test_feet_of_one_are_unknown_of_the_other(tmp_path: Path) -> None:
    plain = two_persons()[0]
    rng = np.random.default_rng(6)
    footed = Motion(2, plain.frames, plain.time_s, rng.normal(0, 1, (5, 21, 3)))
    write_movement(tmp_path / "a.nc", [plain, footed], FPS)
    with netcdf_file(tmp_path / "a.nc", "r", mmap=False) as file:
        assert words(file.variables["keypoints"]) == list(ALL_LANDMARKS)
        places = file.variables["position"][:]
    assert np.isnan(places[:, :, 15:, 0]).all()
    np.testing.assert_allclose(places[0, :, 15:, 1].T, footed.landmarks[0, 15:], atol=EXACT_M)


# ---------------------------------------------------------------------------------------------------- BIDS


def table(path: Path) -> list[list[str]]:
    with path.open(encoding="utf-8") as file:
        return list(csv.reader(file, delimiter="\t"))


def test_bids_folder_has_the_documented_files_and_our_numbers(tmp_path: Path) -> None:
    motions = two_persons()
    written = write_bids_motion(tmp_path / "set", motions, FPS, "slow walk_2")
    assert all(path.is_file() for path in written)
    assert table(tmp_path / "set" / "participants.tsv")[0][0] == "participant_id"
    assert [row[0] for row in table(tmp_path / "set" / "participants.tsv")[1:]] == ["sub-01", "sub-03"]
    about = json.loads((tmp_path / "set" / "dataset_description.json").read_text())
    assert {"Name", "BIDSVersion"} <= set(about)
    for p, subject in enumerate(("sub-01", "sub-03")):
        stem = tmp_path / "set" / subject / "motion" / f"{subject}_task-slowwalk2_tracksys-mocap"
        header, *channels = table(stem.with_name(stem.name + "_channels.tsv"))
        assert header[:5] == ["name", "component", "type", "tracked_point", "units"]
        assert len({row[0] for row in channels}) == len(channels) == 46
        samples = table(stem.with_name(stem.name + "_motion.tsv"))
        assert all(len(row) == len(channels) for row in samples)
        values = np.array([[np.nan if cell == "n/a" else float(cell) for cell in row] for row in samples])
        (latency,) = [k for k, row in enumerate(channels) if row[2] == "LATENCY"]
        np.testing.assert_allclose(values[:, latency], np.arange(4, 13) / FPS, atol=TEXT_M)
        places = np.full((9, 15, 3), np.nan)
        for k, (_, component, kind, point, unit, *_more) in enumerate(channels):
            if kind == "POS":
                assert unit == "m"
                places[:, LANDMARKS.index(point), "xyz".index(component)] = values[:, k]
        np.testing.assert_allclose(places, expected(motions, "landmarks")[p], atol=TEXT_M, rtol=0)
        meta = json.loads(stem.with_name(stem.name + "_motion.json").read_text())
        counts = {
            f"{kind}ChannelCount": sum(row[2] == kind for row in channels) for kind in ("POS", "LATENCY")
        }
        assert {key: meta[key] for key in counts} == counts
        assert (meta["MotionChannelCount"], meta["TrackedPointsCount"]) == (46, 15)
        assert (meta["SamplingFrequency"], meta["TaskName"]) == (FPS, "slow walk_2")
        frames = json.loads(stem.with_name(stem.name + "_channels.json").read_text())["reference_frame"][
            "Levels"
        ]
        assert {row[6] for row in channels} - {"n/a"} == set(frames)


def test_bids_schema_knows_every_file_and_motionbids_the_recording(tmp_path: Path) -> None:
    for package in ("motionbids", "bids_validator"):
        pytest.importorskip(package, reason=f"the package {package}, which no extra of ours brings")
    from bids_validator import BIDSValidator
    from motionbids import Channel, MotionData, ReferenceFrame, validate_motion_data

    folder = tmp_path / "set"
    written = write_bids_motion(folder, two_persons(), FPS, "walk")
    assert [path for path in written if not BIDSValidator().is_bids(f"/{path.relative_to(folder)}")] == []
    for path in folder.rglob("*_motion.tsv"):
        stem = str(path)[: -len("_motion.tsv")]
        header, *rows = table(Path(f"{stem}_channels.tsv"))
        fields = [dict(zip(header, row, strict=True)) for row in rows]
        channels = [
            Channel(
                channel_name=f["name"],
                channel_component=f["component"],
                channel_type=f["type"],
                channel_tracked_point=f["tracked_point"],
                channel_units=f["units"],
            )
            for f in fields
        ]
        meta = {
            re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", key).lower(): value
            for key, value in json.loads(Path(f"{stem}_motion.json").read_text()).items()
        }
        samples = np.genfromtxt(path, delimiter="\t", missing_values="n/a", filling_values=np.nan)
        accepted = ("task_name", "sampling_frequency", "tracked_points_count", "manufacturer")
        motion = MotionData(
            subject=path.name[4:6],
            tracksys="mocap",
            data=samples,
            channels=channels,
            **{key: meta[key] for key in accepted},
        )
        # Names of laboratories and serial numbers are recommended.
        with pytest.warns(UserWarning, match="Missing recommended"):
            assert validate_motion_data(motion)
    levels = json.loads(Path(f"{stem}_channels.json").read_text())["reference_frame"]["Levels"]
    for name, level in levels.items():
        frame = ReferenceFrame(name, spatial_axes=level["SpatialAxes"], rotation_rule=level["RotationRule"])
        assert frame.handedness == "right-hand"


def test_a_task_of_signs_alone_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MocapError, match="letters and digits"):
        write_bids_motion(tmp_path, two_persons(), FPS, "--")


@pytest.mark.parametrize("write", [write_movement, lambda *a: write_bids_motion(*a, "walk")])
def test_nobody_and_wrong_rates_are_refused(tmp_path: Path, write) -> None:
    with pytest.raises(MocapError, match="no person"):
        write(tmp_path / "a", [], FPS)
    with pytest.raises(ValueError, match="fps"):
        write(tmp_path / "a", two_persons(), 0.0)
    assert not list(tmp_path.iterdir())
