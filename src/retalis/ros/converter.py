"""Node `retalis_ros_converter`."""

import rospy


def main() -> None:
    """Run the node until it is shut down."""
    rospy.init_node("retalis_ros_converter")
    rospy.spin()
