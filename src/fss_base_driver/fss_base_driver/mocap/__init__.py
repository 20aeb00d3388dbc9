"""Motion capture: frames of a system, topics of other receivers, and plausibility of poses."""

from fss_base_driver.mocap.receiver import Receiver as Receiver
from fss_base_driver.mocap.reception import Reception as Reception
from fss_base_driver.mocap.relays import Relay as Relay
from fss_base_driver.mocap.relays import RelayError as RelayError
from fss_base_driver.mocap.subjects import Bounds as Bounds
from fss_base_driver.mocap.subjects import Pose as Pose
from fss_base_driver.mocap.subjects import Subjects as Subjects
