"""Compile the C sources and pack the FMU."""

import hashlib
import subprocess
import tempfile
import zipfile
from pathlib import Path

import fmpy

from fmus.compiler.causal import make_explicit
from fmus.compiler.code import write_code, write_data
from fmus.compiler.compile_error import CompileError
from fmus.compiler.model_description import write_build_description, write_description
from fmus.compiler.modelica import read_model
from fmus.compiler.settings import BuildSettings, read_settings

WRAPPER = Path(__file__).parent / "c"
# No contraction and no build id: the same sources give the same numbers and the same file.
COMPILER = ("gcc", "-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC", "-fvisibility=hidden")
# No build id and no symbols: the same sources give the same bytes.
LINKER = ("-Wl,--build-id=none", "-Wl,-s", "-lm")
_FMI_HEADERS = {
    "2.0": ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    "3.0": ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}
_BINARIES = {"2.0": "linux64", "3.0": "x86_64-linux"}
# The earliest date that a ZIP entry can bear: a build has no time of its own.
_ZIP_DATE = (1980, 1, 1, 0, 0, 0)


def build_fmu(folder: Path, target: Path | None = None) -> Path:
    """Build the FMU of a model's folder.

    Args:
        folder: Folder with build.toml and Modelica sources.
        target: File to write; by default ``<identifier>.fmu`` in the folder.

    Returns:
        Path of the FMU.

    Raises:
        CompileError: If the model, the build file or the compiler does not allow it.
        OSError: If there is no gcc, a source cannot be read or the target not written.
    """
    settings = read_settings(folder)
    target = target or folder / f"{settings.identifier}.fmu"
    modelica = sorted(folder.glob("*.mo"))
    ode = make_explicit(read_model(modelica, settings.model, with_events=settings.events))
    functions, header = write_code(ode, settings)
    own = sorted({*settings.source_files, *settings.headers} - {"model.c"})
    sources = {name: (WRAPPER / name).read_bytes() for name in own}
    sources |= {"model.c": functions.encode(), "model.h": header.encode()}
    fmi = Path(fmpy.__file__).parent / "c-code"
    sources |= {name: (fmi / name).read_bytes() for name in _FMI_HEADERS[settings.fmi_version]}
    described = write_description(ode, settings, guid="") + write_data(ode, guid="")
    guid = _guid([*sources.values(), described.encode(), *(path.read_bytes() for path in modelica)])
    sources["model_data.h"] = write_data(ode, guid).encode()
    files = {
        "modelDescription.xml": write_description(ode, settings, guid).encode(),
        f"binaries/{_BINARIES[settings.fmi_version]}/{settings.identifier}.so": _compile(sources, settings),
        **{f"sources/{name}": content for name, content in sources.items()},
        **{f"resources/{path.name}": path.read_bytes() for path in modelica},
    }
    if settings.fmi_version == "3.0":
        files["sources/buildDescription.xml"] = write_build_description(settings).encode()
    _pack(files, target)
    return target


def _guid(parts: list[bytes]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "little"))
        digest.update(part)
    text = digest.hexdigest()
    return f"{{{text[:8]}-{text[8:12]}-{text[12:16]}-{text[16:20]}-{text[20:32]}}}"


def _compile(sources: dict[str, bytes], settings: BuildSettings) -> bytes:
    with tempfile.TemporaryDirectory(prefix="fmu-build-") as name:
        build = Path(name)
        for file, content in sources.items():
            (build / file).write_bytes(content)
        # Relative names in the build folder: no path of this machine gets into the binary.
        command = [*COMPILER, "-I.", "-o", "model.so", *settings.source_files, *LINKER]
        result = subprocess.run(command, cwd=build, capture_output=True, text=True, check=False)
        if result.returncode != 0:
            raise CompileError(f"gcc failed: {(result.stderr.strip().splitlines() or ['no message'])[0]}")
        return (build / "model.so").read_bytes()


def _pack(files: dict[str, bytes], target: Path) -> None:
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name in sorted(files):
            entry = zipfile.ZipInfo(name, _ZIP_DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (0o755 if name.endswith(".so") else 0o644) << 16
            archive.writestr(entry, files[name])
