"""Read URDF: links and joints become bodies and joints of a scene."""
