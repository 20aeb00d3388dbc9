#!/usr/bin/env bash
# Sets up what is lacking, then runs lint, types and tests. Arguments go to pytest, which runs at
# the top folder (--slow: the slow tests too).
set -euo pipefail
root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd -P)
"$root/scripts/setup.sh" --dev
# shellcheck source=scripts/env.sh
. "$root/scripts/env.sh"

summary=() status=0
step() {   # step NAME COMMAND...
  local name=$1 start=$SECONDS verdict=passed
  shift
  printf '\n== %s\n' "$name"
  "$@" || { verdict=FAILED; status=1; }
  summary+=("$(printf '%-8s %-7s %4d s' "$name" "$verdict" $((SECONDS - start)))")
}

# One pytest process a core, each with its own ROS domain, and one thread of linear algebra in each.
cores=$(nproc)
export OPENBLAS_NUM_THREADS=1
cd "$root"
step ruff ruff check .
step mypy mypy src/*/fss_*/
step pytest python -m pytest -n "$cores" "$@"

printf '\n== summary\n'
printf '%s\n' "${summary[@]}"
exit $status
