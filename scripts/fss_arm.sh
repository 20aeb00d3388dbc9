#!/usr/bin/env bash
# What a person tells the arm: scripts/fss_arm.sh arm | disarm | stop | solve
set -euo pipefail
here=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")" && pwd -P)
# shellcheck source=scripts/env.sh
. "$here/env.sh"
exec python3 "$here/fss_arm.py" "$@"
