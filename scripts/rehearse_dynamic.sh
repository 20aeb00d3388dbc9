#!/usr/bin/env bash
# A dynamic calibration, rehearsed: maneuvers designed, made in the simulator over UDP, recorded and
# solved. Usage: scripts/rehearse_dynamic.sh [--help] [--noise paper] [--seed 1] [--out DIR]
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
"$here/setup.sh"
# shellcheck source=scripts/env.sh
. "$here/env.sh"
exec python3 -m fss_sim.rehearsal.dynamic "$@"
