#!/usr/bin/env bash
# Sets up the workspace: .venv, the colcon build, the compiled kernels.
# Steps whose inputs have not changed are skipped.
# usage: setup.sh [--dev] [--ros2cli]
# --dev adds the packages for the tests, --ros2cli the real `ros2` command line,
# which the wheels lack.
set -euo pipefail

root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd -P)
venv=$(readlink -m -- "$root/.venv")   # releases of fss_deploy.sh share one through a link

said=
say() { said=1; printf 'setup: %s\n' "$*" >&2; }
die() { say "$*"; exit 1; }
digest() { sha256sum -- "$@" | sha256sum | cut -c -16; }
current() { [[ -f $1 && $(<"$1") == "$2" ]]; }   # current STAMP KEY

# Runs a command in the background. `join` waits for all of them; if one failed, it prints its
# output and exits.
beside() {
  set -m   # a separate process group, which can be killed as a whole
  log=$log.${#jobs[@]} "$@" >"$log.said.${#jobs[@]}" 2>&1 &
  jobs+=($!)
  set +m
}
join() {
  local k
  for k in "${!jobs[@]}"; do
    wait "${jobs[k]}" || { unset "jobs[k]"; cat "$log.said.$k" >&2; exit 1; }
    unset "jobs[k]"
  done
}

end() {
  local job
  for job in "${jobs[@]}"; do kill -- "-$job" 2>/dev/null || true; done
  rm -f "$log"*
}

dev='' ros2cli=
for argument in "$@"; do
  case $argument in
    --dev) dev=-dev ;;
    --ros2cli) ros2cli=1 ;;
    -h | --help) sed -n '2,/^[^#]/s/^# \{0,1\}//p' "$0"; exit 0 ;;
    *) die "unknown argument '$argument'; usage: scripts/setup.sh [--dev] [--ros2cli]" ;;
  esac
done
[[ $root != *[[:space:]]* ]] ||
  die "colcon does not support spaces in paths; move the workspace out of '$root'"
[[ -w $root ]] || die "cannot write to $root, which is $(stat -c %U "$root")'s: make a clone of your own"

# Variables of another Python must not affect this one.
unset PYTHONHOME PYTHONDONTWRITEBYTECODE _ROS_WHEELS_BOOTSTRAP_COMPLETE

exec 9<"$root/scripts"
flock -n 9 || { say "waiting for another set-up of this workspace"; flock 9; }

# --- ROS 2: a sourced Jazzy, else wheels ---------------------------------------------------------

PROBE='
import importlib.util, os, sys, sysconfig
if sys.version_info[:2] not in ((3, 11), (3, 12)):
    sys.exit(1)
header = os.path.join(sysconfig.get_path("include"), "Python.h")
lacks = [] if os.path.exists(header) else ["headers"]
if not all(importlib.util.find_spec(name) for name in ("venv", "ensurepip")):
    lacks.append("venv")
print(getattr(sys, "_base_executable", sys.executable), *lacks)
'

# Fails if rclpy exists only in a venv, such as that of the wheels.
DISTRIBUTION='
import rclpy, sys
sys.exit(sys.prefix != sys.base_prefix and rclpy.__file__.startswith(sys.prefix))
'

# Prints each Python 3.11 or 3.12 and its missing parts. Each is run, because a version manager's
# stand-in may have a name without having that version.
pythons() {
  local name names=(python3 /usr/bin/python3)
  [[ $ros == jazzy ]] || names+=(python3.1{2,1} /usr/bin/python3.1{2,1})
  for name in "${names[@]}"; do
    [[ $ros == wheels ]] || "$name" -c "$DISTRIBUTION" 2>/dev/null || continue
    "$name" -c "$PROBE" 2>/dev/null || true
  done
}

choose_ros() {
  local distro=${ROS_DISTRO:-}
  ros=jazzy
  [[ $distro != jazzy || -z $(pythons) ]] || return 0
  ros=wheels
  unset PYTHONPATH   # packages from elsewhere must not mix with the wheels
  case $distro in
    '') ;;
    jazzy) [[ ${VIRTUAL_ENV:-} == "$venv" ]] || say "ROS_DISTRO is jazzy, but no Python here can import rclpy: using wheels" ;;
    *) die "ROS 2 $distro is sourced; begin in a shell with ROS 2 Jazzy, or with none" ;;
  esac
}

# --- system requirements -------------------------------------------------------------------------

# Sets `python`, and fills the arrays `missing` (in words) and `packages` (as apt names them).
look_for_needs() {
  local found version name
  missing=() packages=()
  if ! { c++ --version && cc --version; } >/dev/null 2>&1; then
    missing+=("a C++ compiler") packages+=(g++)
  fi
  if ! make --version >/dev/null 2>&1; then
    missing+=(make) packages+=(make)
  fi
  version=$(cmake --version 2>/dev/null | sed -n 's/^cmake version //p') || true
  if [[ $(printf '%s\n' 3.20 "${version:-0}" | sort -V | head -n 1) != 3.20 ]]; then
    missing+=("CMake 3.20 or later") packages+=(cmake)
  fi
  found=$(pythons)
  python=$(awk 'NF == 1 { print; exit }' <<<"$found")
  if [[ $found && ! $python ]]; then
    name=$("${found%% *}" -c 'import sys; print("python%d.%d" % sys.version_info[:2])')
    missing+=("the headers or venv of $name") packages+=("$name-dev" "$name-venv")
  elif [[ ! $found ]]; then
    missing+=("Python 3.11 or 3.12") packages+=(python3-dev python3-venv)
  fi
  [[ $ros == jazzy ]] || return 0
  for name in ament_cmake rosidl_default_generators common_interfaces control_msgs \
    tf2_msgs; do
    ament_has "$name" || { missing+=("$name") packages+=("ros-jazzy-${name//_/-}"); }
  done
}

ament_has() {
  local prefix
  while read -r -d : prefix; do
    [[ ! -e $prefix/share/ament_index/resource_index/packages/$1 ]] || return 0
  done <<<"$AMENT_PREFIX_PATH:"
  return 1
}

supply_needs() {
  local words command version
  look_for_needs
  [[ ${#missing[@]} -gt 0 ]] || return 0
  words=$(printf ', %s' "${missing[@]}") words=${words:2}
  command="apt-get install -y --no-install-recommends ${packages[*]}"
  version=$(/usr/bin/python3 --version 2>/dev/null || true)
  if [[ " ${packages[*]} " == *" python3-dev "* && $version ]]; then
    die "missing: $words; this system's is $version, which has no ROS wheels: add one of them"
  fi
  command -v apt-get >/dev/null || die "missing: $words; install with your system's package manager"
  [[ $(id -u) == 0 ]] || die "missing: $words; install with: sudo apt-get update && sudo $command"
  say "missing: $words; installing with: $command"
  # shellcheck disable=SC2086  # the command is words
  if ! { apt-get update && DEBIAN_FRONTEND=noninteractive $command; } >"$log" 2>&1; then
    ! grep -q 'No space left' "$log" || die "the disk is full"
    die "apt-get failed (no network?); try: apt-get update && $command"
  fi
  look_for_needs
  [[ ${#missing[@]} == 0 ]] || die "after the installation still missing: ${missing[*]}"
}

# --- .venv ---------------------------------------------------------------------------------------

# Errors of pip are printed in one line, without addresses. Python compiles modules on import.
pip() {
  "$venv/bin/python" -m pip --quiet --no-input --disable-pip-version-check install --no-deps \
    --no-compile --only-binary :all: --no-binary empy --no-build-isolation "$@" >"$log" 2>&1 &&
    return
  local where package
  where="$("$venv/bin/python" -c 'import platform as p
print("Python", p.python_version(), "on", p.machine())')"
  package=$(sed -n 's/.*No matching distribution found for \([^ ]*\).*/\1/p' "$log" | head -n 1)
  if grep -q 'No space left' "$log"; then die "the disk is full"; fi
  if grep -q 'CERTIFICATE_VERIFY_FAILED' "$log"; then
    die "the package index's certificate is not trusted; name yours in PIP_CERT"
  fi
  if grep -qE 'Retrying|[Cc]onnection|[Tt]imeout|timed out|resolve host|ProxyError|SSLError' "$log"
  then die "the package index cannot be reached: is there a network (and pip's proxy set)?"; fi
  [[ -z $package ]] || die "there is no wheel of $package for $where"
  die "pip failed: $(grep -v '^ *$' "$log" | tail -n 1 |
    sed -E "s#[a-z+]+://[^ ]*#(address)#g; s#host='[^']*'#host#g")"
}

# The wheels' CMake files name the folders of the machine that built them, and ament looks for a
# prefix's local_setup scripts.
repair_wheels() {
  local include numpy shell
  include=$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
  numpy=$("$venv/bin/python" -c 'import numpy; print(numpy.get_include())')
  { grep -rlE --include='*.cmake' '/opt/python/cp' "$venv/share" || true; } | xargs -r sed -i -E \
    -e "s#/opt/python/cp[0-9]+-cp[0-9]+/include/python3\.[0-9]+#$include#g" \
    -e "s#[^\";]*/site-packages/numpy/_core/include#$numpy#g"
  for shell in sh bash zsh; do
    cat >"$venv/local_setup.$shell" <<END
# Makes this venv an ament prefix.
case ":\${AMENT_PREFIX_PATH:-}:" in *":$venv:"*) ;; *)
  export AMENT_PREFIX_PATH="$venv\${AMENT_PREFIX_PATH:+:\$AMENT_PREFIX_PATH}" ;;
esac
case ":\${CMAKE_PREFIX_PATH:-}:" in *":$venv:"*) ;; *)
  export CMAKE_PREFIX_PATH="$venv\${CMAKE_PREFIX_PATH:+:\$CMAKE_PREFIX_PATH}" ;;
esac
END
  done
}

# The wheels lack some interface packages; the required parts are built into .venv.
add_interfaces() (
  # shellcheck disable=SC2030,SC2031  # meant for the subshell alone
  export PATH=$venv/bin:$PATH VIRTUAL_ENV=$venv AMENT_PREFIX_PATH=$venv CMAKE_PREFIX_PATH=$venv
  build=$(mktemp -d)
  trap 'rm -rf "$build"' EXIT
  for package in "$root"/scripts/interfaces/*_msgs; do
    name=${package##*/}
    if ! { cmake -S "$package" -B "$build/$name" -DCMAKE_INSTALL_PREFIX="$venv" \
      -DBUILD_TESTING=OFF && cmake --build "$build/$name" -j "$(nproc)" --target install; } >"$log" 2>&1
    then
      tail -n 25 "$log" >&2
      die "$name could not be built"
    fi
  done
)

make_venv() {
  local free needed options=()
  [[ $ros == jazzy || $(uname -sm) == "Linux x86_64" ]] ||
    die "the ROS wheels are for Linux on x86_64; here, source a ROS 2 Jazzy first"
  needed=$([[ $dev ]] && echo 3000 || echo 2000)
  free=$(df -Pk "$root" | awk 'NR == 2 { print int($4 / 1024) }')
  ((free > needed)) || die "too little disk: $free MB are free at $root, $needed MB are needed"
  supply_needs
  [[ $ros == wheels ]] || options=(--system-site-packages)
  say "making .venv with $("$python" --version)"
  # A build against another .venv cannot be used.
  rm -rf "$venv" "$root/build" "$root/install"
  "$python" -m venv "${options[@]}" "$venv" >"$log" 2>&1 ||
    die "$python -m venv failed: $(tail -n 1 "$log")"
  # setuptools goes first, as it builds the one package that has no wheel.
  pip "$(grep '^setuptools==' "$requirements.txt")"
  echo "$ros ${venv%/*}" >"$venv/.stamp"
}

add_packages() {
  say "installing the pinned packages for $ros${dev:+ and those of the tests} (a minute or two)"
  rm -f "$venv/.stamp-packages" "$venv/.stamp-dev"
  # The kernels take one core about as long as all the rest, and need little.
  mapfile -t few < <(grep -E '^(numpy|scipy|numba|llvmlite|pyyaml)==' "$requirements.txt")
  pip "${few[@]}"
  [[ -e $warm ]] || beside compile_kernels
  [[ -z $dev ]] || beside pip -r "$requirements-dev.txt"
  pip -r "$requirements.txt"
  [[ $ros == jazzy ]] || { repair_wheels; beside add_interfaces; }
}

# --- the build -----------------------------------------------------------------------------------

colcon_build() (
  cd "$root"
  # shellcheck disable=SC2030,SC2031  # meant for the subshell alone
  export PATH=$venv/bin:$PATH VIRTUAL_ENV=$venv
  if [[ $ros == wheels ]]; then
    unset COLCON_PREFIX_PATH
    # shellcheck disable=SC2030,SC2031
    export AMENT_PREFIX_PATH=$venv CMAKE_PREFIX_PATH=$venv
  fi
  mkdir -p log
  # Otherwise make starts no jobs while the load is high, as during the compilation of the kernels.
  MAKEFLAGS=-j$(nproc)
  export MAKEFLAGS
  colcon build --symlink-install --base-paths src \
    --cmake-args "-DCPP_TYPE_SUPPORT=$([[ $ros == wheels ]] && echo OFF || echo ON)" >"$log" 2>&1 ||
    { tail -n 25 "$log" >&2; die "the build failed; its log is in $root/log"; }
)

build() {
  supply_needs
  say "building with colcon (a minute)"
  colcon_build
  echo "$build_key $(readlink "$root/log/latest_build")" >"$root/install/.stamp"
}

# A kernel is kept under the path of its source, which is colcon's link to it.
compile_kernels() {
  local package path=
  say "compiling the kernels"
  for package in "${with_kernels[@]}"; do
    mkdir -p "$root/build/$package"
    [[ -e $root/build/$package/$package ]] ||
      ln -s "$root/src/$package/$package" "$root/build/$package"
    path+=:$root/build/$package
  done
  PYTHONPATH=${path:1} "$venv/bin/python" -m fss_arm_model.warm >"$log" 2>&1 ||
    { tail -n 25 "$log" >&2; die "the kernels did not compile"; }
  touch "$warm"
}

# --- the ros2 command line -----------------------------------------------------------------------

# Tags of the repositories below https://github.com/ros2, the newest of Jazzy.
ROS2CLI=0.32.2 ROSIDL_RUNTIME_PY=0.13.1

clone() {   # clone NAME TAG
  git clone --quiet --depth 1 --branch "$2" "https://github.com/ros2/$1" "$sources/$1" >"$log" 2>&1 ||
    die "cannot clone https://github.com/ros2/$1: $(grep -m 1 '^fatal:' "$log" || tail -n 1 "$log")"
}

add_ros2cli() (
  command -v git >/dev/null || die "missing: git; install it with your system's package manager"
  say "installing the ros2 command line $ROS2CLI"
  sources=$(mktemp -d)
  trap 'rm -rf "$sources"' EXIT
  clone ros2cli "$ROS2CLI"
  clone rosidl_runtime_py "$ROSIDL_RUNTIME_PY"
  pip "$sources/rosidl_runtime_py" "$sources"/ros2cli/ros2{cli,action,interface,node,param,pkg,run,service,topic}
  echo "$ROS2CLI" >"$venv/.stamp-ros2cli"
)

# --- in order ------------------------------------------------------------------------------------

log=$(mktemp) jobs=()
trap end EXIT

choose_ros
[[ ! $ros2cli || $ros == wheels ]] || die "ROS 2 Jazzy has a ros2: apt-get install ros-jazzy-ros2cli-common-extensions"
requirements=$root/scripts/requirements
[[ $ros == wheels ]] || requirements+=-jazzy
kind="$ros $root"
pins=$(digest "$requirements.txt" "$root"/scripts/interfaces/{*.cmake,*/CMakeLists.txt,*/*/*})
dev_pins=$(digest "$requirements-dev.txt")

if ! current "$venv/.stamp" "$ros ${venv%/*}" || ! "$venv/bin/python" -c '' 2>/dev/null; then
  make_venv
fi

mapfile -t with_kernels < <(cd "$root/src" &&
  grep -rl --include='*.py' '^@kernel(' fss_*/fss_* | cut -d / -f 1 | sort -u)
kernels=$({ cd "$root/src" && find "${with_kernels[@]}" -path '*/fss_*/*.py' -exec sha256sum {} + |
  sort && echo "$pins $kind"; } | sha256sum | cut -c -16)
home=~
caches=${NUMBA_CACHE_DIR:-${XDG_CACHE_HOME:-$home/.cache}/fss_arm}
warm=$caches/warm-$kernels
mkdir -p "$caches"

if ! current "$venv/.stamp-packages" "$pins" ||
  { [[ $dev ]] && ! current "$venv/.stamp-dev" "$dev_pins"; }
then
  add_packages
fi

# Python files are linked, so only changes of other files require a build. A build by hand may have
# copied them: then the latest build log is not the one named in the stamp.
shape=$(cd "$root" && find src colcon.meta -type f ! -path '*/.*' ! -name '*.pyc' \
  ! -path '*/firmware/*' ! \( -path 'src/*/*/*' -name '*.py' \) -exec sha256sum {} + | sort | sha256sum | cut -c -16)
build_key="$shape $pins $kind"
if ! current "$root/install/.stamp" \
  "$build_key $(readlink "$root/log/latest_build" 2>/dev/null || true)"
then
  build
fi

[[ ${#jobs[@]} == 0 ]] || { say "waiting for background jobs (kernels, packages)"; join; }
[[ -e $warm ]] || compile_kernels
echo "$pins" >"$venv/.stamp-packages"
[[ -z $dev ]] || echo "$dev_pins" >"$venv/.stamp-dev"
[[ ! $ros2cli ]] || current "$venv/.stamp-ros2cli" "$ROS2CLI" || { add_ros2cli; said=1; }
# Scripts that continue by themselves set FSS_SETUP_NEXT to nothing.
next=${FSS_SETUP_NEXT-scripts/demo.sh}
[[ ! $said ]] || say "done in $((SECONDS / 60)) min $((SECONDS % 60)) s${next:+; next: $next}"
