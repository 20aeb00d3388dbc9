# Like fss_gnc_sim.sh, with a tumbling target to capture: docs/how-to/mission.md.
# shellcheck shell=sh disable=SC2154

export ROS_DOMAIN_ID="${ROS_DOMAIN_ID:-0}"
arm=config/truth.yaml links=4
port=$((20000 + 40 * ROS_DOMAIN_ID))    # of the board; those of the links follow
ports="[$(seq -s, $((port + 1)) $((port + links)))]"
posture="[0.95, 1.3, 1.36, -1.23]"   # an angle for each joint; compact: the base turns in little space
mass=10.0 inertia=0.25   # of the target [kg], [kg m^2]

node record fss_arm_bags record --ros-args -p "output:=out/$fss_name/bags"
node testbed fss_sim testbed --ros-args -p arm:=$arm -p board_port:=$port -p "ports:=$ports" -p "base:=[-1.1, -1.1, -1.4]" \
  -p "q:=$posture" -p target_mass:=$mass -p target_inertia:=$inertia \
  -p "target_pose:=[0.0, 0.0, -0.3]" -p "target_twist:=[-0.006, 0.004, 0.15]"
for i in $(seq "$links"); do
  node "link_$i" fss_arm_driver link --ros-args -p arm:=$arm -p "link:=$i" \
    -p "url:=udp://127.0.0.1:$((port + i))?bind=$((port + 20 + i))"
done
node arm fss_arm_driver arm --ros-args -p arm:=$arm
node base fss_base_driver base --ros-args -p "url:=udp://127.0.0.1:$port?bind=$((port + 20))"
node navigation fss_gnc navigation --ros-args -p arm:=$arm -p target_mass:=$mass -p target_inertia:=$inertia
node control fss_gnc control --ros-args -p arm:=$arm -p target_mass:=$mass -p target_inertia:=$inertia
node guidance fss_gnc guidance --ros-args -p arm:=$arm -p "posture:=$posture" \
  -p target_mass:=$mass -p target_inertia:=$inertia
