#!/usr/bin/env bash
# Exports the simulated plant of a description, or a control law in C, as an FMU for co-simulation.
# Usage: scripts/fmu.sh ARM.yaml|LAW.c [--fmi 2|3] [--output FILE.fmu]
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
FSS_SETUP_NEXT='' "$here/setup.sh"
# shellcheck source=scripts/env.sh
. "$here/env.sh"
exec python3 "$here/fmu.py" "$@"
