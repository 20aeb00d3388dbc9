#!/usr/bin/env bash
# Rehearses on a simulated test bed. Each rehearsal leaves a bag, pictures, and a
# page that says what was expected and what happened.
# usage: rehearse.sh NAME [--help] [--seed 1] [--out DIR]
# After setup.sh, --help also lists the rehearsals, and NAME --help their options.
set -euo pipefail
fss_scripts=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
# shellcheck source=scripts/fss/config.sh
. "$fss_scripts/fss/config.sh"
set_up "$@"
# shellcheck source=scripts/env.sh
. "$fss_scripts/env.sh"
exec python3 -m fss_rehearsal "$@"
