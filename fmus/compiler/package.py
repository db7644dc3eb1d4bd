"""Write an explicit ODE as C, compile it, and pack the FMU."""

import hashlib
import subprocess
import tempfile
import uuid
import zipfile
from pathlib import Path
from typing import Any

import casadi as ca
import fmpy

from fmus.compiler.causal import Ode, column, make_explicit
from fmus.compiler.filled import filled
from fmus.compiler.model_description import write_description
from fmus.compiler.modelica import read_model
from fmus.compiler.settings import BuildSettings, CompileError, read_settings

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
        described = filled("buildDescription.xml.jinja", settings=settings)
        files["sources/buildDescription.xml"] = described.encode()
    _pack(files, target)
    return target


def _guid(parts: list[bytes]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "little"))
        digest.update(part)
    return f"{{{uuid.UUID(digest.hexdigest()[:32])}}}"


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


def write_code(ode: Ode, settings: BuildSettings) -> tuple[str, str]:
    """Generate the C code of a model.

    Args:
        ode: Explicit model.
        settings: Solver and its numbers.

    Returns:
        Texts of model.c and model.h.

    Raises:
        CompileError: If exact stepping is asked for a model that is not affine in its states.
    """
    functions = _functions(ode, exact=settings.solver == "exact")
    generator = ca.CodeGenerator("model.c", {"with_header": False, "with_export": False, "casadi_int": "int"})
    for function in functions:
        generator.add(function)
    # With the header's declarations, which hide the functions, whatever the compiler's flags.
    source = f'#include "model.h"\n\n{generator.dump()}'
    header = filled(
        "model.h.jinja",
        ode=ode,
        settings=settings,
        functions=functions,
        work=max(1, *(function.sz_w() for function in functions)),
        integer_work=max(1, *(function.sz_iw() for function in functions)),
    )
    return source, header


def _functions(ode: Ode, *, exact: bool) -> list[Any]:
    t, x, u, p = ode.time, ode.x, ode.u, ode.p
    dx, du, dp = (ca.SX.sym(name, symbol.numel()) for name, symbol in (("dx", x), ("du", u), ("dp", p)))
    arguments, seeds = ca.vertcat(x, u, p), ca.vertcat(dx, du, dp)
    functions = [
        ("model_derivatives", [t, x, u, p], [ode.derivative]),
        ("model_outputs", [t, x, u, p], [ode.output]),
        ("model_start", [p], [ode.start]),
        ("model_checks", [p], [column([check.expression for check in ode.checks])]),
        (
            "model_forward",
            [t, x, u, p, dx, du, dp],
            [ca.jtimes(ode.derivative, arguments, seeds), ca.jtimes(ode.output, arguments, seeds)],
        ),
        ("model_start_forward", [p, dp], [ca.jtimes(ode.start, p, dp)]),
    ]
    if ode.has_events:
        targets = [v.symbol for v in (*ode.states, *ode.discrete)]
        actions = [a.values.get(place, old) for a in ode.actions for place, old in enumerate(targets)]
        functions += [
            ("model_relations", [t, x, u, p], [ode.margins, ode.relations]),
            ("model_conditions", [t, x, u, p], [column([action.condition for action in ode.actions])]),
            ("model_actions", [t, x, u, p], [column(actions)]),
        ]
    if exact:
        matrix = ca.jacobian(ode.derivative, x)
        if ca.depends_on(matrix, x) or ca.depends_on(ode.derivative, t):
            raise CompileError(f'{ode.name}: not affine in its states; take solver = "rk4" in the build file')
        rest = ca.substitute(ode.derivative, x, ca.SX.zeros(x.shape))
        # CasADi stores by column, the C code reads by row.
        functions.append(("model_affine", [u, p], [ca.densify(matrix).T, rest]))
    return [
        ca.Function(name, list(ins), [ca.densify(out) for out in ca.cse(list(outs))])
        for name, ins, outs in functions
    ]


def write_data(ode: Ode, guid: str) -> str:
    """Write model_data.h: names, start values and limits, which only the FMI functions read.

    Args:
        ode: Explicit model.
        guid: GUID of the FMU.

    Returns:
        Text of the header.
    """
    kinds = {"INPUT": ode.inputs, "PARAMETER": ode.parameters, "STATE": ode.states, "OUTPUT": ode.outputs}
    targets = range(len(ode.states) + len(ode.discrete))
    sets = [int(place in action.values) for action in ode.actions for place in targets]
    return filled("model_data.h.jinja", ode=ode, guid=guid, kinds=kinds | {"CHECK": ode.checks}, sets=sets)
