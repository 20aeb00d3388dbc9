# Like fss_gnc_sim.sh, with a control law of your own in place of control and guidance: docs/how-to/controller.md.
# shellcheck shell=sh

export ROS_DOMAIN_ID="${ROS_DOMAIN_ID:-0}"
arm=config/truth.yaml
law=${law:-docs/examples/laws/pd_hold.py:PdHold}

node record fss_arm_bags record --ros-args -p output:=out/fss_law_sim/bags
node testbed fss_sim testbed --ros-args -p arm:=$arm -p board_port:=5000
for i in 1 2 3 4; do
  node "link_$i" fss_arm_driver link --ros-args -p arm:=$arm -p link:=$i \
    -p "url:=udp://127.0.0.1:500$i?bind=600$i"
done
node arm fss_arm_driver arm --ros-args -p arm:=$arm
node base fss_base_driver base --ros-args -p "url:=udp://127.0.0.1:5000?bind=6000"
node navigation fss_gnc navigation --ros-args -p arm:=$arm
node controller fss_gnc controller --ros-args -p arm:=$arm -p "law:=$law"
