"""The wheel: it holds the package `mocap` alone, and what is installed from it works without the checkout."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

from mocap.errors import DISTRIBUTION, MissingExtra

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
# `pip install "NAME[extra]"` in code and documents; `.[...]` is the checkout itself.
REMEDY = re.compile(r"""pip install ["']([\w.-]+)\[([\w,]+)\]["']""")


def test_the_errors_know_the_name_of_the_distribution() -> None:
    assert PROJECT["name"] == DISTRIBUTION
    said = str(MissingExtra("drawing needs a pen", "view", otherwise="leave it out"))
    assert f'pip install "{DISTRIBUTION}[view]", or leave it out' in said


def test_every_remedy_names_this_distribution_and_an_extra_that_exists() -> None:
    texts = {path: path.read_text("utf-8") for path in [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")]}
    named = {(path.name, *found) for path, text in texts.items() for found in REMEDY.findall(text)}
    assert named, "the pattern finds nothing any more"
    assert {name for _, name, _ in named} <= {DISTRIBUTION, "."}
    assert {extra for _, _, extras in named for extra in extras.split(",")} <= set(EXTRAS)


def test_code_names_missing_extras_that_exist_and_writes_no_remedy_by_hand() -> None:
    for path in (ROOT / "mocap").rglob("*.py"):
        text = path.read_text("utf-8")
        if path.name != "errors.py":
            assert "pip install" not in text, f"{path}: raise MissingExtra"
        for extra in re.findall(r'MissingExtra\(\s*"[^"]*",\s*"(\w+)"', text):
            assert extra in EXTRAS, f"{path}: no extra {extra}"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    # A copy without build outputs of earlier calls; building in the checkout would leave a folder build/ there.
    source = folder / "source"
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()
    for name in listed:
        if name.startswith(("mocap/", "eval/", "pyproject", "README", "LICENSE")) and (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            (source / name).write_bytes((ROOT / name).read_bytes())
    build = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--quiet", "-w", str(folder), str(source)]
    done = subprocess.run(build, capture_output=True, text=True)
    if done.returncode and "No matching distribution" in done.stderr:
        pytest.skip("setuptools for the build is out of reach")
    assert done.returncode == 0, done.stderr
    (made,) = folder.glob("*.whl")
    return made


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of an environment with the wheel in it; the dependencies are those of the running Python."""
    folder = tmp_path_factory.mktemp("installed")
    venv.create(folder, with_pip=False, symlinks=True)
    (site,) = folder.glob("lib/python*/site-packages")
    with zipfile.ZipFile(wheel) as packed:
        packed.extractall(site)
    # Behind the wheel, and as a plain path: no .pth file of that folder (an editable mocap) is read.
    (site / "dependencies.pth").write_text(str(Path(pytest.__file__).resolve().parents[1]) + "\n", "utf-8")
    return folder


def run(installed: Path, *arguments: str) -> str:
    done = subprocess.run(
        [str(installed / "bin" / "python"), "-P", *arguments],
        cwd=installed,
        capture_output=True,
        text=True,
        env={"HOME": str(installed), "PATH": "/usr/bin:/bin"},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_the_wheel_holds_mocap_alone(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    information = f"{DISTRIBUTION.replace('-', '_')}-{PROJECT['version']}.dist-info"
    assert {name.split("/")[0] for name in names} == {"mocap", information}
    kept = {p.relative_to(ROOT).as_posix() for p in (ROOT / "mocap").rglob("*.toml")}
    assert kept <= set(names), f"data is left out: {sorted(kept - set(names))[:5]}"


@pytest.mark.slow
def test_the_installed_package_is_the_one_of_the_wheel(installed: Path) -> None:
    where = run(installed, "-c", "import mocap; print(mocap.__file__)").strip()
    assert Path(where).is_relative_to(installed)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["eval", "tests", "data_synth", "configs"])
def test_nothing_else_can_be_imported(installed: Path, name: str) -> None:
    asked = f"from importlib.util import find_spec; print(find_spec({name!r}))"
    assert run(installed, "-c", asked).strip() == "None"


@pytest.mark.slow
def test_the_installed_command_finds_its_presets_filters_and_scenes(installed: Path) -> None:
    from mocap.pipeline.config import presets
    from mocap.synth import list_scenes

    assert "demo" in run(installed, "-m", "mocap", "--help")
    assert run(installed, "-m", "mocap", "synth", "--list").split() == list_scenes()
    assert "apf" in run(installed, "-m", "mocap", "run", "--list-filters").split()
    load = "from mocap.pipeline.config import *; print(*[p for p in presets() if load_config(p)])"
    assert run(installed, "-c", load).split() == list(presets())


@pytest.mark.slow
def test_the_installed_command_makes_a_session(installed: Path) -> None:
    pytest.importorskip("embreex")
    scene = installed / "small.toml"
    scene.write_text(
        'description = "Three frames"\nseed = 1\nn_frames = 3\n'
        '[[persons]]\nseed = 3\nmotion = { kind = "stand" }\n'
        '[rig]\nkind = "ring"\nn_cameras = 2\nsize_px = [160, 120]\n',
        "utf-8",
    )
    run(installed, "-m", "mocap", "synth", "-o", "session", "--scene", str(scene), "--workers", "2")
    assert (installed / "session" / "calibration.toml").is_file()
