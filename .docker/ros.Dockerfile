# The ROS 2 nodes in a container, which need a server (docs/ros.md); build it from the project's folder:
#   docker build --file .docker/ros.Dockerfile --tag experience-map-ros .
FROM ros:jazzy

WORKDIR /ws
COPY ros/expmap_ros src/expmap_ros
COPY ros/expmap_msgs src/expmap_msgs
RUN apt-get update \
    && apt-get install --yes --no-install-recommends python3-venv \
    && rosdep install --from-paths src --ignore-src --default-yes \
    && rm -rf /var/lib/apt/lists/*

# pip may not install into the system's Python (PEP 668); the nodes see its packages and the client of the robots.
COPY webapp/__init__.py webapp/errors.py webapp/py.typed client/webapp/
COPY webapp/robot client/webapp/robot
COPY LICENSE client/
RUN python3 -m venv --system-site-packages nodes \
    && touch nodes/COLCON_IGNORE client/COLCON_IGNORE \
    && nodes/bin/pip install --no-cache-dir client/webapp/robot
RUN . nodes/bin/activate && . /opt/ros/jazzy/setup.sh && python3 -m colcon build \
    && useradd --system --home-dir /var/lib/expmap --create-home --uid 10001 expmap

USER expmap
WORKDIR /var/lib/expmap
ENTRYPOINT ["/bin/bash", "-c", ". /ws/install/setup.bash && exec \"$@\"", "--"]
CMD ["ros2", "run", "expmap_ros", "pose_estimator"]
