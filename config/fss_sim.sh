# Like fss.sh, with a simulated test bed in place of the links and the VICON receiver.
# shellcheck shell=sh disable=SC2154

export ROS_DOMAIN_ID="${ROS_DOMAIN_ID:-0}"
arm=config/truth.yaml guess=config/cad.yaml links=4    # the simulated arm, and where calibrations start
port=$((20000 + 40 * ROS_DOMAIN_ID))    # of the board; those of the links follow
ports="[$(seq -s, $((port + 1)) $((port + links)))]"
out="out/$fss_name"    # $fss_name: the name of this file

node record fss_arm_bags record --ros-args -p "output:=$out/bags"
node testbed fss_sim testbed --ros-args -p arm:=$arm -p "ports:=$ports" -p preset:=paper    # with the base's board: -p board_port:=$port
# node base fss_base_driver base --ros-args -p "url:=udp://127.0.0.1:$port?bind=$((port + 20))"
for i in $(seq "$links"); do
  node "link_$i" fss_arm_driver link --ros-args -p arm:=$arm -p "link:=$i" \
    -p "url:=udp://127.0.0.1:$((port + i))?bind=$((port + 20 + i))"
done
node arm fss_arm_driver arm --ros-args -p arm:=$arm
node kinematic fss_arm_calib kinematic --ros-args -p arm:=$guess \
  -p "output:=$out/arm.yaml" -p "state_file:=$out/observations.json"
# After that has passed, the dynamic calibration can start from its result:
# node dynamic fss_arm_calib dynamic --ros-args -p arm:=$out/arm.yaml
# It predicts with the guess, not the truth, until the calibrations pass.
node base_reaction fss_arm_view base_reaction --ros-args -p arm:=$guess
