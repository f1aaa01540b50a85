"""The arrows of the house and its bans, read from the source: who may import whom, and what nobody may write."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

STAGES = ("foreground", "volume", "tracking", "body", "likelihood", "filters", "metrics")
# Modules that every package may import.
EVERYBODYS = (
    "arrays",
    "compiling",
    "errors",
    "files",
    "forks",
    "threads",
    "portable",
    "profiling",
    "progress",
    "rng",
)
# Package of mocap -> packages of mocap that it may import besides itself and these.
ARROWS: dict[str, frozenset[str]] = {
    **{module: frozenset() for module in EVERYBODYS},
    "geometry": frozenset(),
    "data": frozenset({"geometry"}),
    **{stage: frozenset({"data", "geometry"}) for stage in STAGES},
    "likelihood": frozenset({"data", "geometry", "body"}),
    "io": frozenset({"data", "geometry"}),
    "view": frozenset({"data", "geometry", "metrics"}),
    # Cameras from a board.
    "calibrate": frozenset({"data", "geometry", "io", "view"}),
    "pose": frozenset({"data", "geometry", "body", "likelihood", "filters", "metrics", "volume"}),
    "products": frozenset({"data", "io", "volume", "body", "pose"}),
    # `mocap eval`; a run is scored by it too.
    "compare": frozenset({"data", "geometry", "io", "metrics", "products", "view"}),
    "pipeline": frozenset({"data", "geometry", "io", "pose", "products", "view", "compare", *STAGES}),
    # The 2D world on which the sources compare filters, apart from the product's rooms.
    "polygons": frozenset({"data"}),
    # Synthetic sessions with exact truth: of the product's rooms it needs the containers and the file formats.
    "synth": frozenset({"data", "geometry", "io", "polygons"}),
    "cli": frozenset({"calibrate", "io", "synth", "filters", "metrics", "compare", "pipeline"}),
    "__main__": frozenset({"cli"}),
    "": frozenset(),  # mocap/__init__.py
}
# Package with walls -> room in it -> rooms in it that it may import besides itself.
WALLS: dict[str, dict[str, frozenset[str]]] = {
    "likelihood": {
        "voxels": frozenset(),
        "markers": frozenset(),
        "keypoints": frozenset({"markers"}),
        "residuals": frozenset({"voxels", "colours"}),
        "colours": frozenset(),
    }
}
# Modules outside mocap that only some of its packages may import, at any depth.
ONLY_IN: dict[str, frozenset[str]] = {
    "eval": frozenset(),
    "tests": frozenset(),
    "pickle": frozenset(),
    "shelve": frozenset(),
    # Of one operating system.
    **{name: frozenset({"portable"}) for name in ("resource", "fcntl", "msvcrt", "winreg", "pwd", "grp")},
    "typer": frozenset({"cli"}),
}
# Slow to import or optional: only inside functions, so that `mocap --help` answers at once.
LAZY = frozenset(
    {
        "matplotlib",
        "rerun",
        "pylsl",
        "ezc3d",
        "cdflib",
        "zarr",
        "embreex",
        "open3d",
        "trimesh",
        "skimage",
        "pxr",
        "motmetrics",
        "dask",
        "distributed",
    }
)
# The same for rooms of mocap, seen from other rooms: rendering is not needed by who only runs the pipeline.
LAZY_ROOMS = frozenset({"synth"})


@dataclass(frozen=True)
class Import:
    """module : dotted name.  is_lazy : inside a function or under TYPE_CHECKING."""

    module: str
    line: int
    is_lazy: bool


def imports_of(tree: ast.Module, package: str) -> Iterator[Import]:
    """Every import of a module; `package` (dotted) resolves relative ones."""

    def walk(node: ast.AST, is_lazy: bool) -> Iterator[Import]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Import):
                for alias in child.names:
                    yield Import(alias.name, child.lineno, is_lazy)
            elif isinstance(child, ast.ImportFrom):
                base = child.module or ""
                if child.level:
                    parents = package.split(".")[: len(package.split(".")) - child.level + 1]
                    base = ".".join([*parents, base] if base else parents)
                for alias in child.names:
                    yield Import(f"{base}.{alias.name}", child.lineno, is_lazy)
            elif isinstance(child, ast.Call) and _is_dynamic_import(child):
                yield Import(ast.literal_eval(child.args[0]), child.lineno, is_lazy)
            inside = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) or (
                isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test)
            )
            yield from walk(child, is_lazy or inside)

    yield from walk(tree, False)


def _is_dynamic_import(call: ast.Call) -> bool:
    name = ast.unparse(call.func)
    return (
        name in ("importlib.import_module", "import_module", "__import__")
        and bool(call.args)
        and isinstance(call.args[0], ast.Constant)
    )


def package_of(path: Path, root: Path = ROOT) -> str:
    """The first level below mocap/ that a file belongs to: `likelihood`, `cli`, or "" for mocap/__init__.py."""
    parts = path.relative_to(root / "mocap").with_suffix("").parts
    return "" if parts == ("__init__",) else parts[0]


def _through_a_wall(where: tuple[str, ...], target: list[str]) -> list[str]:
    """What is wrong with an import of mocap.<target> by the file mocap/<package>/<room>/..., at most one line."""
    rooms = WALLS.get(where[1], {})
    if target[0] != where[1] or len(target) < 2 or target[1] not in rooms or where[2] not in rooms:
        return []
    if target[1] == where[2] or target[1] in rooms[where[2]]:
        return []
    return [f"{where[1]}/{where[2]} must not import {target[1]}"]


def violations(path: Path, text: str, root: Path = ROOT) -> list[str]:
    """What is wrong with one file of mocap, one line each."""
    own = package_of(path, root)
    dotted = ".".join(path.relative_to(root).parent.parts)
    tree = ast.parse(text)
    where = path.relative_to(root).as_posix()
    found = []
    if own not in ARROWS:
        found.append(f"{where}: package {own!r} has no place in the house; add it to ARROWS on purpose")
        return found
    for item in imports_of(tree, dotted):
        top, *rest = item.module.split(".")
        at = f"{where}:{item.line}"
        if top == "mocap" and rest and rest[0] in ARROWS:
            other = rest[0]
            if other not in (own, *EVERYBODYS) and other not in ARROWS[own]:
                found.append(f"{at}: {own or 'mocap'} must not import {other}")
            if other in LAZY_ROOMS and other != own and not item.is_lazy:
                found.append(f"{at}: import mocap.{other} inside the function that needs it")
            found += [f"{at}: {wrong}" for wrong in _through_a_wall(path.relative_to(root).parts, rest)]
            if item.module.startswith("mocap.pipeline.config") and own not in ("pipeline", "cli"):
                found.append(f"{at}: only the pipeline and the command line know the configuration")
        if top in ONLY_IN and own not in ONLY_IN[top]:
            found.append(f"{at}: {own} must not import {top}")
        if top in LAZY and not item.is_lazy:
            found.append(f"{at}: import {top} inside the function that needs it")
        if top == "numba" and not path.stem.endswith("_kernels") and own != "compiling":
            found.append(f"{at}: numba belongs into a _kernels.py")
    for node in ast.walk(tree):
        line = getattr(node, "lineno", 0)
        if isinstance(node, ast.ExceptHandler) and node.type is None:
            found.append(f"{where}:{line}: bare except")
        if isinstance(node, ast.keyword) and node.arg in ("fastmath", "parallel", "allow_pickle"):
            if isinstance(node.value, ast.Constant) and node.value.value is False:
                continue
            found.append(f"{where}:{node.value.lineno}: {node.arg}")
        if (
            isinstance(node, ast.Attribute)
            and ast.unparse(node.value) in ("np.random", "numpy.random")
            and node.attr not in _RANDOM_TYPES
        ):
            found.append(f"{where}:{line}: global random state {ast.unparse(node)}")
    return found


_RANDOM_TYPES = ("Generator", "default_rng", "SeedSequence", "PCG64", "BitGenerator")


def mocap_files() -> list[Path]:
    return sorted((ROOT / "mocap").rglob("*.py"))


LEFTOVERS = ("*.orig", "*.rej", "*.bak", "*~", "*.partial")


def test_no_merge_left_anything_behind() -> None:
    folders = [ROOT / name for name in ("mocap", "eval", "tests", "docs")]
    found = [p for folder in folders for pattern in LEFTOVERS for p in folder.rglob(pattern)]
    assert not found, f"left behind by a merge or an editor: {found}"


def test_there_is_something_to_read() -> None:
    names = {p.relative_to(ROOT).as_posix() for p in mocap_files()}
    assert {
        "mocap/data/camera.py",
        "mocap/likelihood/voxels/_exact_kernels.py",
        "mocap/pipeline/config.py",
    } <= names


def test_every_arrow_points_the_right_way_and_nothing_banned_is_written() -> None:
    found = [v for path in mocap_files() for v in violations(path, path.read_text("utf-8"))]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("where", "text", "message"),
    [
        ("mocap/volume/x.py", "from mocap.tracking import features", "volume must not import tracking"),
        ("mocap/filters/x.py", "import mocap.body.model", "filters must not import body"),
        (
            "mocap/filters/x.py",
            "def f():\n    from mocap.likelihood import VoxelProblem",
            "must not import likelihood",
        ),
        (
            "mocap/likelihood/markers/x.py",
            "from mocap.likelihood.residuals.surface import SurfaceProblem",
            "likelihood/markers must not import residuals",
        ),
        ("mocap/geometry/x.py", "from mocap.data import Camera", "geometry must not import data"),
        ("mocap/geometry/x.py", "from ..data import Camera", "geometry must not import data"),
        ("mocap/data/x.py", "from mocap import pipeline", "data must not import pipeline"),
        ("mocap/io/x.py", "from mocap.pipeline.config import Config", "only the pipeline"),
        ("mocap/view/x.py", "from mocap.body import Body", "view must not import body"),
        ("mocap/pipeline/x.py", "def f():\n    import mocap.synth", "must not import synth"),
        ("mocap/pipeline/x.py", "from eval.bench import scene", "must not import eval"),
        ("mocap/cli/x.py", "import mocap.synth", "inside the function"),
        ("mocap/cli/x.py", "from mocap.synth import synthesise", "inside the function"),
        ("mocap/io/x.py", "import zarr", "inside the function"),
        ("mocap/view/x.py", "import matplotlib.pyplot as plt", "inside the function"),
        ("mocap/view/x.py", "import importlib\nm = importlib.import_module('rerun')", "inside the function"),
        ("mocap/body/x.py", "import pickle", "must not import pickle"),
        ("mocap/body/x.py", "from numba import njit", "_kernels.py"),
        ("mocap/body/_kernels.py", "@njit(fastmath=True)\ndef f(): pass", "fastmath"),
        ("mocap/body/x.py", "import numpy as np\nnp.load(f, allow_pickle=True)", "allow_pickle"),
        ("mocap/body/x.py", "try:\n    f()\nexcept:\n    pass", "bare except"),
        ("mocap/body/x.py", "import numpy as np\nnp.random.seed(0)", "global random state"),
        ("mocap/body/x.py", "import numpy as np\nx = np.random.normal()", "global random state"),
        ("mocap/newstage/x.py", "import numpy", "no place in the house"),
    ],
)
def test_a_wrong_arrow_is_caught(where: str, text: str, message: str) -> None:
    found = violations(ROOT / where, text)
    assert len(found) >= 1
    assert message in "\n".join(found)


@pytest.mark.parametrize(
    ("where", "text"),
    [
        ("mocap/likelihood/x.py", "from mocap.body import Body"),
        (
            "mocap/filters/x.py",
            "from mocap.data import StateLayout\nfrom mocap.geometry.rigid import wrap_angle",
        ),
        ("mocap/io/x.py", "def f():\n    import zarr"),
        ("mocap/io/x.py", "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import zarr"),
        ("mocap/cli/x.py", "def demo():\n    from mocap.synth import synthesise"),
        ("mocap/body/_kernels.py", "from numba import njit"),
        ("mocap/body/x.py", "from mocap.errors import MocapError\nfrom mocap.body.model import Body"),
        ("mocap/body/x.py", "import numpy as np\ndef f(*, rng: np.random.Generator): pass"),
        ("mocap/body/x.py", "import numpy as np\nx = np.random.default_rng(0).permutation(5)"),
    ],
)
def test_a_right_arrow_is_let_through(where: str, text: str) -> None:
    assert violations(ROOT / where, text) == []


def imports_among(files: dict[str, Path]) -> dict[str, set[str]]:
    """Module -> modules of `files` (dotted name -> file) that it imports, at any depth; its own package left out."""
    found: dict[str, set[str]] = {}
    for module, path in files.items():
        package = module if path.name == "__init__.py" else module.rpartition(".")[0]
        found[module] = set()
        for item in imports_of(ast.parse(path.read_text("utf-8")), package):
            name = item.module
            while name and name not in files:
                name = name.rpartition(".")[0]
            # A module that asks its own package for something is served by the package's other modules.
            if name and not f"{module}.".startswith(f"{name}."):
                found[module].add(name)
    return found


def test_no_circle_of_imports() -> None:
    files = {
        ".".join(p.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): p
        for p in mocap_files()
    }
    try:
        TopologicalSorter(imports_among(files)).prepare()
    except CycleError as circle:
        pytest.fail(f"imports run in a circle: {' -> '.join(circle.args[1])}")


def test_a_circle_of_imports_is_found(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("def f():\n    from b import g\n", "utf-8")
    (tmp_path / "b.py").write_text("import a\n", "utf-8")
    graph = imports_among({name: tmp_path / f"{name}.py" for name in "ab"})
    assert graph == {"a": {"b"}, "b": {"a"}}
    with pytest.raises(CycleError):
        TopologicalSorter(graph).prepare()


def test_stages_have_tests() -> None:
    """tests/ mirrors the packages of mocap."""
    for package in ("geometry", "data", "io", "view", "compare", "synth", *STAGES):
        assert list((ROOT / "tests" / package).glob("test_*.py")), f"tests/{package} is empty"
