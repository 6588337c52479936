"""ROS 2 topics over zenoh, as its middleware rmw_zenoh has them on the wire, without an installation of ROS."""
