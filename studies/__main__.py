"""Run the command line as `python -m studies`."""

from studies.entry import main

if __name__ == "__main__":
    raise SystemExit(main())
