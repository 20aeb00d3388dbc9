#!/usr/bin/env bash
# Exports the simulated plant of a description, or a control law in C, as an FMU
# for co-simulation.
# usage: fmu.sh ARM.yaml|LAW.c [--fmi 2|3] [--output FILE.fmu]
set -euo pipefail
fss_scripts=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
# shellcheck source=scripts/fss/config.sh
. "$fss_scripts/fss/config.sh"
set_up "$@"
# shellcheck source=scripts/env.sh
. "$fss_scripts/env.sh"
exec python3 "$fss_scripts/fmu.py" "$@"
