#!/bin/sh
# Build the program that runs FMUs for Windows: needs ziglang 0.17.1 from PyPI, which brings compiler and headers.
set -eu
cd "$(dirname "$0")"
target=${1:-fmu_worker-x86_64-windows.exe}
digest=$(sha256sum fmu_worker.c | cut -c1-64)
"${PYTHON:-python}" -m ziglang cc -target x86_64-windows-gnu -O2 -s -Wall -Wextra -DSOURCE="\"$digest\"" fmu_worker.c -o "$target"
