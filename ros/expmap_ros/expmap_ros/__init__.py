"""ROS 2 nodes of Experience Map.

Each node is a module: `python -m expmap_ros.pose_estimator`, or `ros2 run expmap_ros pose_estimator`. Nodes
that use a server need only rclpy, numpy and the robots' client; those that read a map need the program
itself.
"""
