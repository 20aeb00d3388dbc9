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
  local name=$1 start=${begun:-$SECONDS} verdict=passed
  shift
  printf '\n== %s\n' "$name"
  "$@" || { verdict=FAILED; status=1; }
  summary+=("$(printf '%-8s %-7s %4d s' "$name" "$verdict" $((SECONDS - start)))")
}

# Options may choose tests (-k) of which one step has none: pytest's code 5.
chosen=$*
tests() {   # tests NICENESS ARGUMENTS...
  nice -n "$1" python -m pytest "${@:2}" ||
    { local code=$?; [[ $code == 5 && $chosen ]] || return "$code"; }
}

# One thread of linear algebra in each process; each has its own ROS domain. The end to end tests run
# whole node graphs, one at a time, and mostly wait: all else goes on meanwhile, but gives way.
export OPENBLAS_NUM_THREADS=1
cd "$root"
said=$(mktemp) start=$SECONDS
trap '[[ -z $whole ]] || kill -- "-$whole"; rm -f "$said"' EXIT
set -m   # a process group of its own, which can be ended as one
tests 0 test/e2e "$@" >"$said" 2>&1 &
whole=$!
set +m
follow() {
  tail -n +1 -f --pid="$whole" "$said"
  local code=0
  wait "$whole" || code=$?
  whole=
  return "$code"
}

step ruff ruff check .
step mypy nice -n 10 mypy src/*/fss_*/
step parts tests 10 test/pure test/node -n $(($(nproc) + 1)) "$@"
begun=$start step whole follow

printf '\n== summary\n'
printf '%s\n' "${summary[@]}"
exit $status
