#!/usr/bin/env bash
# Sets up what is lacking, then runs lint, types and tests. Options go to pytest (--slow: the slow
# tests too; -k WORD: some).
set -euo pipefail
root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd -P)
"$root/scripts/setup.sh" --dev
# shellcheck source=scripts/env.sh
. "$root/scripts/env.sh"

said=$(mktemp -d)
declare -A beside=()
end_all() {
  local group
  for group in "${beside[@]}"; do kill -INT -- "-$group" 2>/dev/null || true; done
  rm -rf "$said"
}
trap end_all EXIT
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
      "${tools[@]}"; } >"$said/apt" 2>&1 || tail -n 3 "$said/apt" >&2
  fi
fi

# Options may choose tests (-k) of which one step has none: pytest's code 5.
chosen=$*
tests() {
  python -m pytest "$@" || { local code=$?; [[ $code == 5 && $chosen ]] || return "$code"; }
}

# Begins a command beside what comes next, to which it gives way; the step `ended NAME` waits for it.
begin() {   # begin NAME COMMAND...
  local name=$1
  shift
  set -m   # a process group of its own, which can be ended as one
  { renice -n 10 "$BASHPID" >/dev/null; "$@"; } >"$said/$name" 2>&1 &
  beside[$name]=$!
  set +m
}
ended() {
  local code=0
  wait "${beside[$1]}" || code=$?
  unset "beside[$1]"
  cat "$said/$1"
  return "$code"
}

# A process a core, each with its own ROS domain, and one thread of linear algebra in each. Tests of
# nodes and of whole graphs mostly wait, but not long: what only computes is done beside them, with
# what they leave of the processor. The demo keeps two cores busy, and slow tests keep time. What
# fails of nodes and whole graphs is given one more try, elsewhere what missed a deadline or met a
# watchdog on a busy machine; the output shows it as R, and at the end which.
export OPENBLAS_NUM_THREADS=1
patience=(--reruns 1 --only-rerun "not within|still running after|not armed|not seen to switch")
pure=(tests test/pure "${patience[@]}" -n "$(nproc)" --dist loadfile "$@")
node=(tests test/node --reruns 1 -raR -n "$((2 * $(nproc)))" --dist loadfile "$@")
graphs=(tests test/e2e --ignore test/e2e/test_demo.py --reruns 1 -raR --dist loadfile
  --no-loadscope-reorder "$@")   # as they stand, the longest files are not last
cd "$root"
step ruff ruff check .
step format ruff format --check --quiet .
begin mypy mypy src/*/fss_*/
if [[ " $* " == *" --slow "* ]]; then
  step pure "${pure[@]}"
  step mypy ended mypy
  step node "${node[@]}"
  step graphs "${graphs[@]}" -n 0
else
  begin pure "${pure[@]}"
  step node "${node[@]}"
  step graphs "${graphs[@]}" -n 2
  step mypy ended mypy
  step pure ended pure
fi
step demo tests test/e2e/test_demo.py "${patience[@]}" "$@"
[[ " $* " != *" --slow "* ]] ||
  step colcon colcon test --base-paths src --return-code-on-test-failure \
    --event-handlers console_direct- desktop_notification-

printf '\n== summary\n'
printf '%s\n' "${summary[@]}"
exit $status
