"""Process that draws a picture: the library's V8 aborts where memory is limited, and takes its process along.

`python -P -m studies.reporting.drawing_process KIND SCALE` reads a specification and writes the picture.
"""

import sys


def main() -> int:
    """Read from standard input, and write to standard output."""
    import vl_convert

    kind, scale, given = sys.argv[1], float(sys.argv[2]), sys.stdin.read()
    if kind == "svg":
        drawn = vl_convert.vegalite_to_svg(given).encode()
    elif kind == "png":
        drawn = vl_convert.vegalite_to_png(given, scale=scale)
    else:
        # The stub demands an argument that the function does not need.
        drawn = vl_convert.javascript_bundle().encode()  # pyrefly: ignore[missing-argument]
    sys.stdout.buffer.write(drawn)
    return 0


if __name__ == "__main__":
    sys.exit(main())
