#!/usr/bin/env bash
# Run the set-up if needed, then lint, type checks and tests. Options go to pytest.
set -euo pipefail
if [[ ${1:-} == -h || ${1:-} == --help ]]; then
  cat <<'HELP'
usage: scripts/test.sh [--slow] [-k WORD] [PYTEST OPTION...]

Run the set-up if needed, then lint, type checks and tests: a quarter of an hour
on two cores.

  --slow    also the tests that take minutes each
  -k WORD   only tests whose names contain WORD
HELP
  exit
fi
root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd -P)
FSS_SETUP_NEXT='' "$root/scripts/setup.sh" --dev
# shellcheck source=scripts/env.sh
. "$root/scripts/env.sh"

logs=$(mktemp -d)
declare -A background=()
stop_all() {
  local group
  for group in "${background[@]}"; do kill -INT -- "-$group" 2>/dev/null || true; done
  rm -rf "$logs"
}
trap stop_all EXIT
trap 'exit 130' INT
summary=() status=0
step() {   # step NAME COMMAND...
  local name=$1 start=$SECONDS verdict=passed
  shift
  printf '\n== %s\n' "$name"
  "$@" || { verdict=FAILED; status=1; }
  summary+=("$(printf '%-8s %-7s %4d s' "$name" "$verdict" $((SECONDS - start)))")
}

# A test without its tool is skipped. For the slow tests, install the tools with apt if possible.
if [[ " $* " == *" --slow "* && $(id -u) == 0 ]] && command -v apt-get >/dev/null; then
  tools=(chromium zsh iproute2 rsync openssh-server systemd qemu-system-arm gcc-arm-none-eabi
    libnewlib-arm-none-eabi libstdc++-arm-none-eabi-newlib)
  if ! dpkg -s "${tools[@]}" >/dev/null 2>&1; then
    echo "test: installing for the slow tests: ${tools[*]}" >&2
    { apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends \
      "${tools[@]}"; } >"$logs/apt" 2>&1 || tail -n 3 "$logs/apt" >&2
  fi
fi

# With a selection (-k), a step may have no tests: pytest's exit code 5.
selection=$*
tests() {
  python -m pytest "$@" || { local code=$?; [[ $code == 5 && $selection ]] || return "$code"; }
}

# Start a command in the background at low priority; the step `finish NAME` waits for it.
start() {   # start NAME COMMAND...
  local name=$1
  shift
  set -m   # in a process group of its own, to stop it as a whole
  { renice -n 10 "$BASHPID" >/dev/null; "$@"; } >"$logs/$name" 2>&1 &
  background[$name]=$!
  set +m
}
finish() {
  local code=0
  wait "${background[$1]}" || code=$?
  unset "background[$1]"
  cat "$logs/$1"
  return "$code"
}

# Each process has its own ROS domain and one thread of linear algebra. Tests of nodes and of whole
# graphs mostly wait; pure tests run beside them at low priority. The demo keeps two cores busy and
# slow tests keep time, so these run alone. No test is run again: a failure is a failure.
export OPENBLAS_NUM_THREADS=1
pure=(tests test/pure -n "$(nproc)" --dist loadfile "$@")
node=(tests test/node -n "$((2 * $(nproc)))" --dist loadfile "$@")
graphs=(tests test/e2e --ignore test/e2e/test_demo.py --dist loadfile
  --no-loadscope-reorder "$@")   # unsorted, so that the longest files are not last
cd "$root"
mapfile -t sources < <(git ls-files '*.py')   # not what a user tries in this folder
step ruff ruff check --force-exclude "${sources[@]}"
step format ruff format --check --quiet --force-exclude "${sources[@]}"
start mypy mypy src/*/fss_*/
if [[ " $* " == *" --slow "* ]]; then
  step pure "${pure[@]}"
  step mypy finish mypy
  step node "${node[@]}"
  step graphs "${graphs[@]}" -n 0
else
  start pure "${pure[@]}"
  step node "${node[@]}"
  step graphs "${graphs[@]}" -n 2
  step mypy finish mypy
  step pure finish pure
fi
step demo tests test/e2e/test_demo.py "$@"
[[ " $* " != *" --slow "* ]] ||
  step colcon colcon test --base-paths src --return-code-on-test-failure \
    --event-handlers console_direct- desktop_notification-

printf '\n== summary\n'
printf '%s\n' "${summary[@]}"
exit $status
