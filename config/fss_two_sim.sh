# Two vehicles in one simulated test bed, each with its own nodes: docs/how-to/vehicles.md.
# shellcheck shell=sh

export ROS_DOMAIN_ID="${ROS_DOMAIN_ID:-0}"
arm=config/truth.yaml

FSS_NAMESPACE=    # of all vehicles
node testbed fss_sim testbed --ros-args -p vehicles:=config/two_vehicles.yaml -p preset:=paper

for k in 1 2; do
  FSS_NAMESPACE=fss$k
  at=$((5000 + 100 * (k - 1)))    # the board's port; those of the links follow
  node record fss_arm_bags record --ros-args -p output:=out/fss_two_sim/$FSS_NAMESPACE/bags
  for i in 1 2 3 4; do
    node "link_$i" fss_arm_driver link --ros-args -p arm:=$arm -p link:=$i \
      -p "url:=udp://127.0.0.1:$((at + i))?bind=$((at + 1000 + i))"
  done
  node arm fss_arm_driver arm --ros-args -p arm:=$arm
  node base fss_base_driver base --ros-args -p "url:=udp://127.0.0.1:$at?bind=$((at + 1000))"
  node navigation fss_gnc navigation --ros-args -p arm:=$arm
  node control fss_gnc control --ros-args -p arm:=$arm
  node guidance fss_gnc guidance --ros-args -p arm:=$arm -p "vehicles:=['fss1', 'fss2']"
done
