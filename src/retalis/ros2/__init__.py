"""The transport of ROS 2: rclpy. Only this package imports rclpy."""
