#!/bin/sh
# Writes systemd units for a configuration, a service for each node and a target
# for all.
# usage: fss_systemd.sh FOLDER [CONFIG]     config/fss.sh by default
set -eu
fss_scripts=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd -P)
# shellcheck source=scripts/fss/config.sh
. "$fss_scripts/fss/config.sh"
help "$@"
[ $# -gt 0 ] || fail "usage: fss_systemd.sh FOLDER [CONFIG]"
mkdir -p -- "$1" || exit 1
folder=$(readlink -f -- "$1")
read_config "${2:-}"

# The nodes read the configuration again; the command that disarms the links does not.
reach='DOMAIN_ID|AUTOMATIC_DISCOVERY_RANGE|STATIC_PEERS|DISCOVERY_SERVER|SUPER_CLIENT|SECURITY_[A-Z_]*'
environment=$(env | sed -nE "s/^ROS_($reach)=.*/Environment=\"&\"/p")
[ -z "$fss_vehicle" ] || environment="$environment
Environment=\"FSS_NAMESPACE=$fss_vehicle\""

# Services start one after the other and stop the other way round, as `After` has it.
after=network-online.target
service() { echo "$fss_name-$1.service" | tr / -; }
unit() {
  file=$(service "$1")
  : >>"$FSS_LOGS/$1.log"   # systemd would make it as root, and fss_up.sh could not write to it
  {
    cat <<END
[Unit]
Description=FSS Arm: $1
PartOf=$fss_name.target
After=$after
Wants=network-online.target
StartLimitIntervalSec=$FSS_WINDOW
StartLimitBurst=$((FSS_RESTARTS + 1))

[Service]
Type=exec
User=$(id -un)
$environment
WorkingDirectory=$fss_root
ExecStart=$fss_scripts/fss/node.sh $fss_config $1
END
    # systemd also runs this for a process that exited by itself: there is no node to call then.
    disarm="[ -z \"\$\$MAINPID\" ] || exec $fss_scripts/fss_arm.sh${FSS_NAMESPACE:+ --vehicle $FSS_NAMESPACE} disarm"
    [ "${1##*/}" != arm ] || echo "ExecStop=-/bin/sh -c '$disarm'"
    [ -z "$fss_priority" ] || echo "LimitRTPRIO=$fss_priority
LimitMEMLOCK=infinity"
    # systemd puts the result in.
    cat <<END
ExecStopPost=-$fss_scripts/fss/log_failure.sh $fss_config $1 \${SERVICE_RESULT}
Restart=on-failure
RestartSec=1
TimeoutStopSec=$FSS_STOP_TIMEOUT
StandardOutput=append:$FSS_LOGS/$1.log
StandardError=inherit

[Install]
WantedBy=$fss_name.target
END
  } >"$folder/$file"
  after=$file
}
each_node unit

cat >"$folder/$fss_name.target" <<END
[Unit]
Description=FSS Arm: all nodes of $fss_config
Wants=$(for name in $fss_nodes; do printf '%s ' "$(service "$name")"; done)

[Install]
WantedBy=multi-user.target
END
echo "written to $folder; next: sudo cp $folder/* /etc/systemd/system && sudo systemctl daemon-reload"
