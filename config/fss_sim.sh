# Like fss.sh, with a simulated test bed in place of the links and the VICON receiver.
# shellcheck shell=sh

export ROS_DOMAIN_ID="${ROS_DOMAIN_ID:-0}"
arm=config/truth.yaml

node record fss_arm_bags record --ros-args -p output:=out/fss_sim/bags
node testbed fss_sim testbed --ros-args -p arm:=$arm -p preset:=paper    # with the base's board: -p board_port:=5010
# node base fss_base_driver base --ros-args -p url:=udp://127.0.0.1:5010?bind=6010
for i in 1 2 3 4; do
  node "link_$i" fss_arm_driver link --ros-args -p arm:=$arm -p link:=$i \
    -p "url:=udp://127.0.0.1:500$i?bind=600$i"
done
node arm fss_arm_driver arm --ros-args -p arm:=$arm
node kinematic fss_arm_calib kinematic --ros-args -p arm:=config/cad.yaml \
  -p output:=out/fss_sim/arm.yaml -p state_file:=out/fss_sim/observations.json
# After that has passed, the dynamic calibration can start from its result:
# node dynamic fss_arm_calib dynamic --ros-args -p arm:=out/fss_sim/arm.yaml
# It predicts with the guess, not the truth, until the calibrations pass.
node base_reaction fss_arm_view base_reaction --ros-args -p arm:=config/cad.yaml
