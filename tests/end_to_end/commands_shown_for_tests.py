"""The commands that README and pages show: which of them a test runs, and why it leaves the others out."""

import re
import shutil
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
WHY_NOT = {
    r"\bpip install|^source ": "needs the network; .ci/run and tests/package install the package",
    r"^(export|B=|F=|mkdir|watch )": "belongs to the shell, or shows again and again what is run",
    r"^sudo ": "needs an administrator; .ci/run installs the package",
    r"^sbatch|--dask": "needs a cluster; tests/simulation run a local one of Dask",
    r"^studies ui|^optuna-dashboard": "serves until it is stopped; tests/browser opens both",
    r"mlflow models serve|^curl ": "serves until it is stopped; tests/tuning load the model as it does",
    r"^python -P -m studies.tuning.worker": "names a study of another project; trials are trained so",
    r"^python tests/benchmarks|^\$B ": "takes hours; tests/calibration check the table's file",
    r"--budget full|--trials (200|40)|--profile paper|--max-hours|--only fig6 fig7": "takes hours",
    r"^studies (run|tune|simulate)( --parallel 4| room| office| office-recorded --seed 3)?$": "all sizes",
    r"^studies run office --n-train 32 64 --trials 12$": "made this project",
    r"office-recorded|^studies import-recording": "needs the recording; tests/paper and tests/cli use it",
    r"^studies (choose|next) ": "tests/cli/test_cli_planning.py types such lines for the wall",
    r"^studies uncertainty( |$)": "takes 10 s; tests/cli ask how sure calibrations are",
    r"--simulations \d+": "tunes several sizes; tests/cli/test_budget.py runs it for the wall",
    r"--profile refined.toml$": "networks of that form were trained for this project",
    r"^studies compare ": "needs two labels of one case; tests/cli/test_compare.py compares some",
    r"^studies reproduce office-quick": "tests/cli reproduce a trial and a calibration",
    r"mlflow.example.com|wall --max-calls 30$|best wall$": "its page is run with a server",
    r"--write (fmu|onnx|csv) ": "the page of these lines is run as a whole",
    r" --experiment ": "tests/cli/test_cli_experiments.py types them for a case with experiments",
    r"(?i)crauste|cells.yaml": "tests/cli/test_petab.py reads problems",
    r"--values room.ssv$": "tests/cli/test_system.py gives a new case such values",
    r"--output TAir": "names variables of an FMU that is not there",
    r"--profile own.toml$|^studies best office-own$": "tests/tuning/test_own_surrogates.py uses the classes",
    r"--objective |^studies (status|best) error$": "tests/tuning/test_objectives.py types the page's lines",
    r"\$RUN_ID": "tests/cli reproduces runs of MLflow",
    r"^studies tune --profile my.toml$": "`--dry-run` reads the profile",
    r"^studies check (room|fmus|slow-model)": "`studies check` examines the office",
    r"^studies calibrate (room|my-case) --": "tests/cli give these options to the wall",
    r"^studies calibrate office --seed 0$": "the seed without the option",
    r"^studies sensitivity office --window": "tests/cli choose windows",
    r"--again$": "tests/cli repeats a calibration",
    r"^studies status 'office-quick-seed": "this project has one seed",
    r"(?i)mywall": "tests/end_to_end/test_tutorials.py types these lines",
    r"^studies tune office --n-train 64 256 --trials 1 ": "takes long; the trials are the same",
}
"""Why a command is not run, by what its line matches."""


def lines_shown() -> list[str]:
    """Return each line of the shell blocks once, without its comment."""
    texts = [page.read_text("utf-8") for page in PAGES]
    blocks = [block for text in texts for block in re.findall(r"^```sh\n(.*?)^```$", text, re.M | re.S)]
    lines = [re.split(r"\s+# ", line)[0].strip() for block in blocks for line in block.splitlines()]
    return [*dict.fromkeys(line for line in lines if line)]


def give_what_commands_name(project: Path) -> None:
    """Put the cases, profiles and files into a project that the pages' commands name."""
    shutil.copy(ROOT / "fmus" / "wall" / "Wall.fmu", project / "Room.fmu")
    for name, folder in (("room", "fmus/room"), ("slow-model", "fmus/slow-model"), ("my-case", "my-case")):
        shutil.copytree(ROOT / "fmus" / "wall", project / folder)
        shutil.copytree(ROOT / "data" / "wall", project / "data" / name)
        case = project / folder / "case.toml"
        text = case.read_text("utf-8").replace('name = "wall"', f'name = "{name}"')
        case.write_text(text.replace('"../../data/wall"', f'"{project / "data" / name}"'), "utf-8")
    office = ROOT / "data" / "office"
    occupancy = dict(
        row.split(",") for row in (office / "occupancy_600s.csv").read_text("utf-8").splitlines()
    )
    rows = (office / "recording_1800s.csv").read_text("utf-8").splitlines()
    winter = "".join(f"{row},{occupancy[row.partition(',')[0]]}\n" for row in rows)
    (project / "next-winter.csv").write_text(winter, "utf-8")
    profile = (ROOT / "studies" / "profiles" / "quick.toml").read_text("utf-8")
    small = profile.replace("[32, 64, 128, 256, 512]", "[32]").replace(
        "n_trials = 12", "max_epochs = 5\nn_trials = 1"
    )
    for name, surrogate in (("my", "state-space"), ("pca-gp", "pca-gp")):
        text = small.replace('name = "quick"', f'name = "{name}"')
        text = text.replace('surrogate = "state-space"', f'surrogate = "{surrogate}"')
        if surrogate == "pca-gp":  # as docs/how-to/compare-surrogates.md says
            text = re.sub(r"\[tuning\.search\].*?(?=\n\[)", "", text, flags=re.DOTALL)
        (project / f"{name}.toml").write_text(text, "utf-8")
