#!/bin/sh
# What a person tells the arm: scripts/fss_arm.sh arm | disarm | stop | solve
set -eu
cd -- "$(dirname -- "$0")/.."
# shellcheck source=scripts/env.sh
. scripts/env.sh
exec python3 scripts/fss_arm.py "$@"
