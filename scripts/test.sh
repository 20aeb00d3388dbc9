#!/usr/bin/env bash
# Sets up what is lacking, then runs lint, types and tests. Options go to pytest (--slow: the slow
# tests too; -k WORD: some).
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

# Options may choose tests (-k) of which one step has none: pytest's code 5.
chosen=$*
tests() {
  python -m pytest "$@" || { local code=$?; [[ $code == 5 && $chosen ]] || return "$code"; }
}

# A process a core and one more, as some wait, each with its own ROS domain, and one thread of linear
# algebra in each; the type checker beside them. The end to end tests run whole node graphs, so one at
# a time.
export OPENBLAS_NUM_THREADS=1
cd "$root"
said=$(mktemp)
trap 'rm -f "$said"' EXIT
mypy src/*/fss_*/ >"$said" 2>&1 &
checker=$!
types() {
  local code=0
  wait "$checker" || code=$?
  cat "$said"
  return "$code"
}
step ruff ruff check .
step parts tests test/pure test/node -n "$(($(nproc) + 1))" "$@"
step mypy types
step whole tests test/e2e "$@"

printf '\n== summary\n'
printf '%s\n' "${summary[@]}"
exit $status
