# The workspace's environment for a shell (bash, zsh, or sh at the top folder): `. scripts/env.sh`
# shellcheck shell=sh disable=SC1090,SC1091,SC2128,SC3028

# colcon's scripts endure neither -u nor -e; both are put back at the end.
_fss_options=
case $- in *u*) _fss_options="$_fss_options -u"; set +u ;; esac
case $- in *e*) _fss_options="$_fss_options -e"; set +e ;; esac

if [ -n "$ZSH_VERSION" ]; then
  _fss_shell=zsh
  eval '_fss_root=${${(%):-%x}:A:h:h}'
elif [ -n "$BASH_VERSION" ]; then
  _fss_shell=bash
  _fss_root=$(CDPATH='' cd -- "$(dirname -- "$BASH_SOURCE")/.." >/dev/null && pwd -P)
else
  _fss_shell="sh"
  _fss_root=$(pwd -P)
fi

_fss_load() {
  if [ ! -f "$_fss_root/scripts/env.sh" ]; then
    echo "env.sh: a plain sh cannot find this file; source it from the top folder" >&2
    return 1
  fi
  if [ ! -x "$_fss_root/.venv/bin/python" ]; then
    if [ -h "$_fss_root/.venv/bin/python" ]; then
      echo "env.sh: $(id -un) cannot run the Python of $_fss_root/.venv; make a clone of your own" \
        "and run its scripts/setup.sh" >&2
    else
      echo "env.sh: there is no .venv yet; run $_fss_root/scripts/setup.sh" >&2
    fi
    return 1
  fi
  # A Python that was started from another venv leaves this behind; its libraries would be loaded.
  unset _ROS_WHEELS_BOOTSTRAP_COMPLETE
  # Containers set this for their images; here each start would compile all its imports again.
  unset PYTHONDONTWRITEBYTECODE
  export VIRTUAL_ENV="$_fss_root/.venv"
  if [ -f "$_fss_root/install/setup.$_fss_shell" ]; then
    export COLCON_CURRENT_PREFIX="$_fss_root/install"   # a plain sh cannot determine it
    . "$_fss_root/install/setup.$_fss_shell"
    unset COLCON_CURRENT_PREFIX
  else
    [ ! -f "$VIRTUAL_ENV/local_setup.$_fss_shell" ] || . "$VIRTUAL_ENV/local_setup.$_fss_shell"
    echo "env.sh: nothing is built yet; run colcon build or scripts/setup.sh" >&2
  fi
  case "$PATH" in
    "$VIRTUAL_ENV/bin:"*) ;;
    *) PATH="$VIRTUAL_ENV/bin:$PATH" ;;
  esac
  # The stand-in goes last, so that a real ros2 comes before it.
  case ":$PATH:" in
    *":$_fss_root/scripts/bin:"*) ;;
    *) PATH="$PATH:$_fss_root/scripts/bin" ;;
  esac
  export PATH

  export ROS_DISTRO="${ROS_DISTRO:-jazzy}"   # as a distribution's setup does, for tools that ask
  export ROS_LOG_DIR="${ROS_LOG_DIR:-$_fss_root/log/ros}"
  # To Fast DDS, LOCALHOST would mean shared memory too; SYSTEM_DEFAULT leaves it to the profile.
  case "${RMW_IMPLEMENTATION:-rmw_fastrtps_cpp}" in
    rmw_fastrtps_*) _fss_range=SYSTEM_DEFAULT ;;
    *) _fss_range=LOCALHOST ;;
  esac
  export ROS_AUTOMATIC_DISCOVERY_RANGE="${ROS_AUTOMATIC_DISCOVERY_RANGE:-$_fss_range}"
  _fss_profile=$_fss_root/config/fastdds.xml
  if [ "$ROS_AUTOMATIC_DISCOVERY_RANGE" = SUBNET ]; then
    _fss_profile=$_fss_root/config/fastdds_network.xml
  elif [ -n "${ROS_STATIC_PEERS:-}" ]; then
    _fss_write_peers || return 1
  fi
  # A profile of this workspace is replaced by the present one, any other profile is kept.
  case "${FASTRTPS_DEFAULT_PROFILES_FILE:-$_fss_root/}" in
    "$_fss_root/"*) export FASTRTPS_DEFAULT_PROFILES_FILE="$_fss_profile" ;;
  esac
}

# The profile for the computers of ROS_STATIC_PEERS and this one.
_fss_write_peers() {
  _fss_profile=$_fss_root/log/fastdds_peers.xml
  _fss_locators=
  for _fss_peer in $(echo "127.0.0.1;$ROS_STATIC_PEERS" | tr ';' ' '); do
    _fss_locators="$_fss_locators<locator><udpv4><address>$_fss_peer</address></udpv4></locator>"
  done
  mkdir -p "$_fss_root/log" &&
    sed "s|<!-- PEERS -->|$_fss_locators|" "$_fss_root/config/fastdds_peers.xml" \
      >"$_fss_profile.$$" && mv "$_fss_profile.$$" "$_fss_profile"
}

_fss_load
_fss_status=$?
for _fss_option in u e; do
  case "$_fss_options" in *"-$_fss_option"*) set "-$_fss_option" ;; esac
done
unset _fss_root _fss_shell _fss_options _fss_option _fss_range _fss_profile _fss_locators _fss_peer
unset -f _fss_load _fss_write_peers
if [ "$_fss_status" = 0 ]; then unset _fss_status; else unset _fss_status; return 1; fi
