"""The wheel and the sdist: what they hold, and that the installed package writes into the project alone."""

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
EMBEDDED = "studies/cases/"
# A case has a case.toml, perhaps further ones beside it, an FMU of its own and recordings.
CASES = {
    str(file.relative_to(REPOSITORY))
    for case in (REPOSITORY / "fmus").glob("*/case.toml")
    for pattern in (
        f"fmus/{case.parent.name}/*.toml",
        f"fmus/{case.parent.name}/*.fmu",
        f"data/{case.parent.name}/*.csv",
    )
    for file in REPOSITORY.glob(pattern)
    if file.name != "build.toml"
}


def run(*words: str | Path, where: Path, **environment: str) -> str:
    done = subprocess.run(
        [*map(str, words)],
        cwd=where,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in folder.rglob("*")
        if file.is_file() and not {"__pycache__", ".cache"} & set(file.parts)
    }


def build(checkout: Path, kind: str) -> Path:
    """Build in the folder with the setuptools that is installed here; nothing is fetched."""
    code = f"from setuptools import build_meta; print(build_meta.build_{kind}('dist'))"
    return checkout / "dist" / run(sys.executable, "-c", code, where=checkout).split()[-1]


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    try:
        if int(version("setuptools").split(".")[0]) < 77:
            pytest.skip("setuptools is older than 77: pip install -U setuptools")
    except PackageNotFoundError:
        pytest.skip("setuptools is not installed: pip install setuptools")
    if not (REPOSITORY / ".git").exists():
        pytest.skip("not a git checkout")
    copy = tmp_path_factory.mktemp("checkout")
    # What lies about in a checkout is in no package; a stray case of the user's own shows that.
    for name in run("git", "ls-files", "-co", "--exclude-standard", where=REPOSITORY).splitlines():
        if (REPOSITORY / name).is_file():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(REPOSITORY / name, copy / name)
    for stray in ("fmus/mine/case.toml", "data/wall/generated/set.csv", "mlruns/mlflow.db"):
        (copy / stray).parent.mkdir(parents=True, exist_ok=True)
        (copy / stray).write_text("", encoding="utf-8")
    return build(copy, "sdist")


@pytest.fixture(scope="module")
def wheel(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sdist")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    (unpacked,) = folder.iterdir()
    return build(unpacked, "wheel")


@pytest.fixture(scope="module")
def site(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("site")
    pip = ("-m", "pip", "install", "-q", "--no-deps", "--no-index", "--disable-pip-version-check")
    run(sys.executable, *pip, "--target", target, wheel, where=target)
    return target


def test_the_sdist_holds_the_sources_and_no_results(sdist: Path) -> None:
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {
        "LICENSE",
        "CHANGELOG.md",
        "CITATION.cff",
        "README.md",
        "pyproject.toml",
        "studies/cli.py",
    } <= names
    assert {"fmus/wall/Wall.mo", "fmus/compiler/c/fmi3.c"} <= names
    assert not [name for name in names if name.split("/")[0] in ("tests", "mlruns", ".ci")]
    left_out = ("generated", "benchmarks", "/mine")
    assert not [name for name in names if any(word in f"/{name}" for word in left_out)]


def test_the_wheel_holds_three_packages_and_the_embedded_cases(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if not name.endswith("/")}
    tops = {name.split("/")[0] for name in names}
    (about,) = (top for top in tops if top.endswith(".dist-info"))
    assert tops == {"simulation", "pelsvae", "studies", about}
    assert {name.removeprefix(EMBEDDED) for name in names if name.startswith(EMBEDDED)} == CASES
    assert {
        f"{about}/licenses/LICENSE",
        f"{about}/licenses/LICENSES/FMI-headers-BSD-2-Clause.txt",
        "studies/profiles/quick.toml",
        "studies/reporting/charts.js",
        "studies/reporting/page.html",
        "studies/doctor/findings.toml",
        "studies/new/case.toml.jinja",
        "simulation/worker/fmu_worker-x86_64-windows.exe",
    } <= names
    rest = {Path(name).suffix for name in names if not name.startswith((EMBEDDED, about))}
    assert rest == {".py", ".typed", ".toml", ".html", ".jinja", ".js", ".exe"}
    modules = {name for name in names if name.endswith(".py")}
    assert modules == {
        file.relative_to(REPOSITORY).as_posix()
        for top in ("simulation", "pelsvae", "studies")
        for file in (REPOSITORY / top).rglob("*.py")
    }


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_the_installed_package_writes_into_the_project_alone(site: Path, tmp_path: Path) -> None:
    project, home = tmp_path / "project", tmp_path / "home"
    project.mkdir()
    home.mkdir()
    unset = dict.fromkeys(("STUDIES_ROOT", "STUDIES_STORAGE", "NUMBA_CACHE_DIR"), "")
    environment = unset | {"PYTHONPATH": str(site), "HOME": str(home), "PYTHONWARNINGS": "ignore"}
    environment |= {"TMPDIR": str(tmp_path / "scratch"), "MLFLOW_DISABLE_TELEMETRY": "true"}
    (tmp_path / "scratch").mkdir()

    def studies(*words: str | Path, where: Path = project) -> str:
        return run(sys.executable, "-m", "studies", *words, where=where, **environment)

    before = contents(site)
    at = run(sys.executable, "-c", "import studies; print(studies.__file__)", where=project, **environment)
    assert Path(at.strip()).is_relative_to(site)
    for reading in (["status"], ["run", "wall", "--dry-run"]):
        studies(*reading)
        assert not contents(project), f"{reading} wrote something"
    (project / "below").mkdir()
    studies("calibrate", "wall", "-q")
    assert (project / "studies.toml").is_file()
    studies("new", REPOSITORY / "fmus" / "vanderpol" / "VanDerPol.fmu", where=project / "below")
    made = contents(project)
    assert {
        "studies.toml",
        "fmus/vanderpol/case.toml",
        "mlruns/results/wall-quick/calibrate-adaptive.json",
    } <= made.keys()
    assert any(name.startswith("data/wall/generated/") for name in made)
    assert {name.split("/")[0] for name in made} == {"studies.toml", "fmus", "data", "mlruns"}
    assert contents(site) == before
    assert not contents(home)
    assert not contents(tmp_path / "scratch")
