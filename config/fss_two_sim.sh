# Two vehicles in one simulated test bed, each with its own nodes: docs/how-to/vehicles.md.
# shellcheck shell=sh disable=SC2154

export ROS_DOMAIN_ID="${ROS_DOMAIN_ID:-0}"
arm=config/truth.yaml links=4
port=$((20000 + 40 * ROS_DOMAIN_ID))    # of the first vehicle's board; those of its links follow
ports="[$(seq -s, $((port + 1)) $((port + links)))]"

FSS_NAMESPACE=    # of all vehicles
node testbed fss_sim testbed --ros-args -p vehicles:=config/two_vehicles.yaml -p preset:=paper \
  -p arm:=$arm -p board_port:=$port -p "ports:=$ports"

for k in 1 2; do
  FSS_NAMESPACE=fss$k
  at=$((port + 10 * (k - 1)))    # of its board
  node record fss_arm_bags record --ros-args -p "output:=out/$fss_name/$FSS_NAMESPACE/bags"
  for i in $(seq "$links"); do
    node "link_$i" fss_arm_driver link --ros-args -p arm:=$arm -p link:="$i" \
      -p "url:=udp://127.0.0.1:$((at + i))?bind=$((at + 20 + i))"
  done
  node arm fss_arm_driver arm --ros-args -p arm:=$arm
  node base fss_base_driver base --ros-args -p "url:=udp://127.0.0.1:$at?bind=$((at + 20))"
  node navigation fss_gnc navigation --ros-args -p arm:=$arm
  node control fss_gnc control --ros-args -p arm:=$arm
  node guidance fss_gnc guidance --ros-args -p arm:=$arm -p "vehicles:=['fss1', 'fss2']"
done
