"""Process that draws pictures: the library's V8 aborts where memory is limited, and takes its process along.

Its start takes longer than ten pictures, so it draws until its input ends or nothing comes for a while.
"""

import base64
import json
import select
import sys
from typing import Any

IDLE_S = 20.0


def main() -> None:
    """Read requests, each a line of JSON, and write a line of JSON for each."""
    while select.select([sys.stdin], [], [], IDLE_S)[0] and (line := sys.stdin.readline()):
        try:
            answer = {"drawn": drawn(**json.loads(line))}
        except Exception as error:
            answer = {"error": str(error).strip().rpartition("\n")[-1] or type(error).__name__}
        print(json.dumps(answer), flush=True)


def drawn(kind: str, scale: float, specification: dict[str, Any]) -> str:
    """Draw a picture.

    Args:
        kind: "svg" or "png"; "library" for the programs that draw in a browser.
        scale: Pixels of a PNG per CSS pixel.
        specification: In Vega-Lite.

    Returns:
        A text; for "png" in base64.
    """
    import vl_convert

    if kind == "svg":
        return vl_convert.vegalite_to_svg(specification)
    if kind == "png":
        return base64.b64encode(vl_convert.vegalite_to_png(specification, scale=scale)).decode("ascii")
    # The stub demands an argument that the function does not need.
    return vl_convert.javascript_bundle()  # pyrefly: ignore[missing-argument]


if __name__ == "__main__":
    main()
