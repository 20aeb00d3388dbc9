#!/usr/bin/env bash
# Rehearses on a simulated test bed. Each rehearsal leaves a bag, pictures, and a page that says what
# was expected and what happened. Usage: scripts/rehearse.sh NAME [--help] [--seed 1] [--out DIR]
# What NAME may be: scripts/rehearse.sh --help
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
FSS_SETUP_NEXT='' "$here/setup.sh"
# shellcheck source=scripts/env.sh
. "$here/env.sh"
exec python3 -m fss_rehearsal "$@"
