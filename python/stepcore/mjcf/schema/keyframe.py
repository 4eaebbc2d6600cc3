"""The section `<keyframe>`."""

from stepcore.mjcf.schema.notation import spec

KEYFRAME = spec(
    "", {"key": spec("name time:1 qpos:* qvel:* act:* mpos:* mquat:* ctrl:* plastic:*")}
)
