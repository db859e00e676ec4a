"""Node `retalis`."""

import rospy


def main() -> None:
    """Run the node until it is shut down."""
    rospy.init_node("retalis")
    rospy.spin()
