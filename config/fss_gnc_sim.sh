# Like fss_sim.sh, with the base's board in the test bed, navigation, control and guidance: docs/how-to/guidance.md.
# shellcheck shell=sh

export ROS_DOMAIN_ID="${ROS_DOMAIN_ID:-0}"
arm=config/truth.yaml

node record fss_arm_bags record --ros-args -p output:=out/fss_gnc_sim/bags
node testbed fss_sim testbed --ros-args -p arm:=$arm -p board_port:=5000
for i in 1 2 3 4; do
  node "link_$i" fss_arm_driver link --ros-args -p arm:=$arm -p link:=$i \
    -p "url:=udp://127.0.0.1:500$i?bind=600$i"
done
node arm fss_arm_driver arm --ros-args -p arm:=$arm
node base fss_base_driver base --ros-args -p "url:=udp://127.0.0.1:5000?bind=6000"
node navigation fss_gnc navigation --ros-args -p arm:=$arm
node control fss_gnc control --ros-args -p arm:=$arm
node guidance fss_gnc guidance --ros-args -p arm:=$arm
