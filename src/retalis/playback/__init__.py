"""Running a program over recorded bags, without ROS."""
