#!/usr/bin/env bash
# Makes the public data set of calibration experiments: bags of five simulated
# arms, their truth (a blind part as a hash), and the results of the calibrations.
# usage: dataset.sh DIR [--seed 1]
set -euo pipefail
fss_scripts=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
# shellcheck source=scripts/fss/config.sh
. "$fss_scripts/fss/config.sh"
set_up "$@"
# shellcheck source=scripts/env.sh
. "$fss_scripts/env.sh"
exec python3 -m fss_rehearsal.dataset "$@"
