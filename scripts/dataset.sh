#!/usr/bin/env bash
# Makes the public data set of calibration experiments: bags of five simulated arms, their truth (a
# blind part as a hash), and the results of the calibrations. Usage: scripts/dataset.sh DIR [--seed 1]
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
FSS_SETUP_NEXT='' "$here/setup.sh"
# shellcheck source=scripts/env.sh
. "$here/env.sh"
exec python3 -m fss_rehearsal.dataset "$@"
