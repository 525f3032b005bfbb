"""The built package contains exactly the right files, and requires the packages that a run needs."""

import subprocess
import sys
import tarfile
import tomllib
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest

from hyperflex import extras
from hyperflex.errors import MissingPackage

ROOT = Path(__file__).parent.parent
SOURCE = ROOT / "src"
HIDDEN = ("cv2", "av", "xarray", "pandas", "mcap", "rosbags", "gymnasium", "c3d")


def built(kind: str, folder: Path) -> Path:
    """The one file that the build backend makes of this tree."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, capture_output=True, check=True)
    (file,) = folder.iterdir()
    return file


def test_the_wheel_holds_the_package_and_nothing_else(tmp_path):
    with zipfile.ZipFile(built("wheel", tmp_path)) as wheel:
        names = {name for name in wheel.namelist() if ".dist-info/" not in name}
        (metadata,) = (name for name in wheel.namelist() if name.endswith(".dist-info/METADATA"))
        told = Parser().parsestr(wheel.read(metadata).decode())
        entries = wheel.read(metadata.replace("METADATA", "entry_points.txt")).decode()
    files = (path for path in SOURCE.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    assert names == {path.relative_to(SOURCE).as_posix() for path in files}
    assert {Path(name).suffix for name in names} >= {".py", ".html", ".mp4", ".toml", ".typed"}
    assert "hyperflex = hyperflex.cli:main" in entries
    needed = {line.split(">")[0] for line in told.get_all("Requires-Dist") if "extra" not in line}
    assert not needed & {"opencv-python-headless", "av", "xarray", "mcap", "rosbags", "gymnasium", "c3d", "pytest"}
    assert {"vision", "xarray", "gym", "mcap", "c3d", "ros", "all"} <= set(told.get_all("Provides-Extra"))


def test_the_sdist_can_be_built_and_tested(tmp_path):
    with tarfile.open(built("sdist", tmp_path)) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    wanted = {"pyproject.toml", "LICENSE", "README.md", "Makefile", "constraints.txt", "tests/conftest.py"}
    assert wanted | {"src/hyperflex/py.typed", "docs/index.md"} <= names
    assert not [name for name in names if name.startswith(("benchmarks/results", ".venv")) or "__pycache__" in name]


def test_each_extra_is_named_as_it_is_called():
    """By what loads its packages; `pip` installs nothing for an extra that is not there, and only warns."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    text = "".join(path.read_text("utf-8") for path in SOURCE.rglob("*.py"))
    for extra in ("vision", "xarray", "gym", "mcap", "c3d", "ros"):
        assert extra in project["optional-dependencies"]
        assert f'"{extra}", "' in text


def test_a_package_that_lacks_is_refused_with_its_command(monkeypatch):
    with pytest.raises(MissingPackage, match=r"Films need no_such_a, not installed.*pip install 'hyperflex\[vision\]'"):
        extras.require(("numpy", "no_such_a"), "vision", "Films")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MissingPackage, match=r"need opencv-python-headless \(cv2\), av, not installed"):
        extras.require(("cv2", "av"), "vision", "Films")
    monkeypatch.undo()
    extras.require(("numpy",), "vision", "Films")


def test_nothing_but_the_extras_needs_their_packages(tmp_path):
    """Set-ups, runs, fits and casts load where the extras' packages are hidden, and so do their pictures."""
    code = (
        "import sys\n"
        f"for name in {HIDDEN}: sys.modules[name] = None\n"
        "import hyperflex as hf, hyperflex.report as report\n"
        "hf.simulate, hf.identify, hf.plan_cast, hf.plan_whip, hf.follow_plan, hf.write_mjcf, hf.read_recording\n"
        "run = hf.simulate(hf.Rope.uniform(1.0, 0.1, n_links=2, friction=0.0), duration=0.1, q0=[0.1, 0.2])\n"
        "run.to_netcdf('a.nc'); hf.read_trajectory('a.nc').plot(); run.to_html('a.html')\n"
        "import hyperflex.cli.app\n"
        "try:\n    run.dataset\nexcept ImportError as error:\n    print(error)\n"
        "try:\n    from hyperflex.vision import Camera\nexcept ImportError as error:\n    print(error)\n"
        "try:\n    import hyperflex.envs\nexcept ImportError as error:\n    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    named = [line.split("'")[1] for line in done.stdout.splitlines()]
    assert named == ["hyperflex[xarray]", "hyperflex[vision]", "hyperflex[gym]"]


def test_the_package_works_without_the_modules_that_windows_lacks(tmp_path):
    """All modules load, and files and folders are written, with names that Windows allows."""
    script = """
import pkgutil, sys
for name in ("fcntl", "resource", "pwd", "grp", "termios"):
    sys.modules[name] = None
import importlib
import hyperflex as hf
for each in pkgutil.walk_packages(hf.__path__, "hyperflex."):
    if not each.name.endswith("__main__"):
        importlib.import_module(each.name)
from hyperflex.report import whole_folder
run = hf.simulate(hf.Rope.uniform(1.0, 0.1, 3, friction=1e-3), duration=0.1, q0=0.3)
run.to_netcdf("run.nc")
with whole_folder("kept", ("run.nc",)) as stage:
    run.to_netcdf(stage / "run.nc")
print(hf.read_trajectory("kept/run.nc").success)
"""
    done = subprocess.run([sys.executable, "-c", script], check=False, capture_output=True, text=True, cwd=tmp_path)
    assert done.stdout == "True\n", done.stderr
    names = [each.name for each in tmp_path.rglob("*")]
    assert not any(set(name) & set('<>:"|?*\\\\') or name.endswith((".", " ")) for name in names)
