"""A concentric tube robot under the names of CRTK, for ROS 2."""
