# Like fss_gnc_sim.sh, with a tumbling target to capture: docs/how-to/mission.md.
# shellcheck shell=sh

export ROS_DOMAIN_ID="${ROS_DOMAIN_ID:-0}"
arm=config/truth.yaml
posture="[0.95, 1.3, 1.36, -1.23]"   # compact: the base turns in little space
mass=10.0 inertia=0.25   # of the target [kg], [kg m^2]

node record fss_arm_bags record --ros-args -p output:=out/fss_capture_sim/bags
node testbed fss_sim testbed --ros-args -p arm:=$arm -p board_port:=5000 -p "base:=[-1.1, -1.1, -1.4]" \
  -p "q:=$posture" -p target_mass:=$mass -p target_inertia:=$inertia \
  -p "target_pose:=[0.0, 0.0, -0.3]" -p "target_twist:=[-0.006, 0.004, 0.15]"
for i in 1 2 3 4; do
  node "link_$i" fss_arm_driver link --ros-args -p arm:=$arm -p link:=$i \
    -p "url:=udp://127.0.0.1:500$i?bind=600$i"
done
node arm fss_arm_driver arm --ros-args -p arm:=$arm
node base fss_base_driver base --ros-args -p "url:=udp://127.0.0.1:5000?bind=6000"
node navigation fss_gnc navigation --ros-args -p arm:=$arm -p target_mass:=$mass -p target_inertia:=$inertia
node control fss_gnc control --ros-args -p arm:=$arm -p target_mass:=$mass -p target_inertia:=$inertia
node guidance fss_gnc guidance --ros-args -p arm:=$arm -p "posture:=$posture" \
  -p target_mass:=$mass -p target_inertia:=$inertia
