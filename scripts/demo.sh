#!/usr/bin/env bash
# The main job, end to end, on a simulated test bed: simulator, drivers, calibration, bag, and back.
# Usage: scripts/demo.sh [--help] [--speed 5] [--seed 1] [--out DIR]
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
"$here/setup.sh"
# shellcheck source=scripts/env.sh
. "$here/env.sh"
exec python3 -m fss_sim.rehearsal.demo "$@"
