"""Run the command line as `python -m studies`."""

import os
import sys

if __name__ == "__main__" and not sys.flags.safe_path:
    # Python looks for modules in the working folder first, which may be a stranger's. Nothing is imported
    # before that ends, unless this package lies in that folder itself.
    _first = os.path.realpath(sys.path[0] or ".")
    _is_ours = os.path.realpath(__file__) == f"{_first}{os.sep}studies{os.sep}__main__.py"
    if _first == os.path.realpath(".") and not _is_ours:
        del sys.path[0]

from studies.entry import main

if __name__ == "__main__":
    raise SystemExit(main())
