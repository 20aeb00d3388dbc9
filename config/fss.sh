# Nodes on the spacecraft, for scripts/fss_up.sh: settings, then a line for each node in the order
# of their start: its name, and the arguments of `ros2 run`. They stop in reverse order, the
# recorder last. The name is that of a ROS node in the process, whose diagnostics report its health:
# link_1 if one process hosts all links. Plain sh; paths are relative to the top folder.
# shellcheck shell=sh

export ROS_DOMAIN_ID="${ROS_DOMAIN_ID:-0}"
# FSS_NAMESPACE=fss2    # one of several vehicles: docs/how-to/vehicles.md
# export ROS_STATIC_PEERS="192.168.1.10;192.168.1.20"    # the ground's computer too: docs/how-to/network.md
arm=config/arm.yaml    # your description; not out/arm.yaml, which the calibration overwrites

node record fss_arm_bags record --ros-args -p output:=bags
for i in 1 2 3 4; do
  node "link_$i" fss_arm_driver link --ros-args -p arm:=$arm -p link:=$i \
    -p "url:=udp://192.168.1.1$i:5001?bind=600$i"
done
node arm fss_arm_driver arm --ros-args -p arm:=$arm
# node base fss_base_driver base --ros-args -p url:=udp://192.168.1.20:5000?bind=6000    # docs/how-to/base.md
# node mocap fss_base_driver mocap --ros-args -p system:=vicon -p host:=192.168.1.2    # docs/how-to/mocap.md
node kinematic fss_arm_calib kinematic --ros-args -p arm:=$arm \
  -p output:=out/arm.yaml -p state_file:=out/observations.json
# The dynamic calibration starts from the kinematic result and its covariance once that has passed
# (docs/explanation/dynamic.md):
# node dynamic fss_arm_calib dynamic --ros-args -p arm:=$arm -p output:=out/arm_dynamic.yaml
# Torque constants, friction and torque sensors while joints turn (docs/explanation/drives.md):
# node drives fss_arm_calib drives --ros-args -p arm:=$arm -p output:=out/arm_drives.yaml
# Kinematics, masses and drift at once, from the data of these nodes (docs/explanation/joint.md):
# node joint fss_arm_calib joint --ros-args -p arm:=$arm -p output:=out/arm_joint.yaml
node base_reaction fss_arm_view base_reaction --ros-args -p arm:=$arm
