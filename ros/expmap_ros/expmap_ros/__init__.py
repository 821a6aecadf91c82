"""ROS 2 nodes of Experience Map.

A node is a module here: `python -m expmap_ros.pose_estimator`, or `ros2 run expmap_ros pose_estimator`. Those
that ask a server, or send to one, need rclpy, numpy and the robots' client only; those that read a map need
the program itself.
"""
