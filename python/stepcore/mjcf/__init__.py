"""MJCF, MuJoCo's model format: `reader` fills a `Scene` from a file, `write` writes one."""
