#!/usr/bin/env bash
# Rehearses a capture: go to a tumbling target by thrusters, grip it with the arm, stop it.
# Usage: scripts/mission.sh [--help] [--seed 1] [--speed 1] [--reach jacobian] [--out DIR]
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
"$here/setup.sh"
# shellcheck source=scripts/env.sh
. "$here/env.sh"
exec python3 -m fss_sim.rehearsal.mission "$@"
