"""Read and write MJCF, MuJoCo's model format: `reader` fills a `Scene`, `writer` writes one."""
