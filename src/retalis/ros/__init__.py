"""The two nodes; the only room that imports rospy."""
