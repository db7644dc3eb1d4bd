"""What the README shows in Python runs as it stands there."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
CHECKED = """
assert found.converged and found.mse < 0.002
assert y.shape == deviation.shape == (1, *found.y.shape)
assert (abs(y[0] - found.y) < 4.0 * deviation[0]).all()
"""


def test_the_example_in_python_calibrates_and_predicts(tmp_path: Path) -> None:
    (example,) = re.findall(
        "```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL
    )
    script = tmp_path / "example.py"
    script.write_text(f"import sys; sys.path.insert(0, {str(ROOT)!r})\n{example}{CHECKED}", encoding="utf-8")
    command = [sys.executable, "-W", "error", str(script)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(r"\d simulations, MSE 0\.0019\d: \{.*\}\n", done.stdout)
