"""ROS message types: definitions, decoding and encoding."""
