# Like fss_gnc_sim.sh, with a control law of your own in place of control and guidance: docs/how-to/controller.md.
# shellcheck shell=sh disable=SC2154

export ROS_DOMAIN_ID="${ROS_DOMAIN_ID:-0}"
arm=config/truth.yaml links=4
port=$((20000 + 40 * ROS_DOMAIN_ID))    # of the board; those of the links follow
ports="[$(seq -s, $((port + 1)) $((port + links)))]"
law=${law:-docs/examples/laws/pd_hold.py:PdHold}

node record fss_arm_bags record --ros-args -p "output:=out/$fss_name/bags"
node testbed fss_sim testbed --ros-args -p arm:=$arm -p board_port:=$port -p "ports:=$ports"
for i in $(seq "$links"); do
  node "link_$i" fss_arm_driver link --ros-args -p arm:=$arm -p "link:=$i" \
    -p "url:=udp://127.0.0.1:$((port + i))?bind=$((port + 20 + i))"
done
node arm fss_arm_driver arm --ros-args -p arm:=$arm
node base fss_base_driver base --ros-args -p "url:=udp://127.0.0.1:$port?bind=$((port + 20))"
node navigation fss_gnc navigation --ros-args -p arm:=$arm
node controller fss_gnc controller --ros-args -p arm:=$arm -p "law:=$law"
