#!/usr/bin/env bash
# Sets up what is lacking, then runs lint, types and tests. Options go to pytest (--slow: the slow
# tests too; -k WORD: some).
set -euo pipefail
root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd -P)
"$root/scripts/setup.sh" --dev
# shellcheck source=scripts/env.sh
. "$root/scripts/env.sh"

said=$(mktemp) other=
trap '[[ ! $other ]] || kill -INT -- "-$other" 2>/dev/null || true; rm -f "$said"' EXIT
trap 'exit 130' INT
summary=() status=0
step() {   # step NAME COMMAND...
  local name=$1 start=$SECONDS verdict=passed
  shift
  printf '\n== %s\n' "$name"
  "$@" || { verdict=FAILED; status=1; }
  summary+=("$(printf '%-8s %-7s %4d s' "$name" "$verdict" $((SECONDS - start)))")
}

# A test that lacks its tool is skipped. Of the slow ones none is to be, where apt can help.
if [[ " $* " == *" --slow "* && $(id -u) == 0 ]] && command -v apt-get >/dev/null; then
  tools=(chromium zsh iproute2 systemd qemu-system-arm gcc-arm-none-eabi libnewlib-arm-none-eabi
    libstdc++-arm-none-eabi-newlib)
  if ! dpkg -s "${tools[@]}" >/dev/null 2>&1; then
    echo "test: installing for the slow tests: ${tools[*]}" >&2
    { apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends \
      "${tools[@]}"; } >"$said" 2>&1 || tail -n 3 "$said" >&2
  fi
fi

# Options may choose tests (-k) of which one step has none: pytest's code 5.
chosen=$*
tests() {
  python -m pytest "$@" || { local code=$?; [[ $code == 5 && $chosen ]] || return "$code"; }
}

# Begins a command beside what comes next; the step `ended` waits for it.
beside() {
  set -m   # a process group of its own, which can be ended as one
  "$@" >"$said" 2>&1 &
  other=$!
  set +m
}
ended() {
  local code=0
  wait "$other" || code=$?
  other=
  cat "$said"
  return "$code"
}
giving_way() { renice -n 10 "$BASHPID" >/dev/null; "$@"; }   # in a subshell

# A process a core, each with its own ROS domain, and one thread of linear algebra in each; the type
# checker beside them. Tests of nodes mostly wait, as do those end to end, which run whole graphs,
# two at once: so they go side by side, graphs first. But the demo keeps two cores busy, and slow
# ones keep time. Where nodes wait for each other, a deadline missed on a busy machine is given one
# more try, which the output shows as R.
export OPENBLAS_NUM_THREADS=1
patience=(--reruns 1 --only-rerun "not within|still running after|is silent|stood still")
nodes=(tests test/node "${patience[@]}" --dist loadfile)
graphs=(tests test/e2e --ignore test/e2e/test_demo.py "${patience[@]}" --dist loadfile
  --no-loadscope-reorder)   # as they stand, the longest files are not last
cd "$root"
beside mypy src/*/fss_*/
step ruff ruff check .
step format ruff format --check --quiet .
step pure tests test/pure -n "$(nproc)" --dist loadfile "$@"
step mypy ended
if [[ " $* " == *" --slow "* ]]; then
  step node "${nodes[@]}" -n "$((2 * $(nproc)))" "$@"
  step graphs "${graphs[@]}" -n 0 "$@"
else
  beside giving_way "${nodes[@]}" -n "$(nproc)" "$@"
  step graphs "${graphs[@]}" -n 2 "$@"
  step node ended
fi
step demo tests test/e2e/test_demo.py "${patience[@]}" "$@"
[[ " $* " != *" --slow "* ]] ||
  step colcon colcon test --base-paths src --return-code-on-test-failure \
    --event-handlers console_direct- desktop_notification-

printf '\n== summary\n'
printf '%s\n' "${summary[@]}"
exit $status
