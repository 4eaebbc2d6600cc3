"""The section `<compiler>`."""

from stepcore.mjcf.schema.notation import AUTO, BOOL, spec

COMPILER = spec(
    f"autolimits:{BOOL} boundmass:1 boundinertia:1 settotalmass:1 balanceinertia:{BOOL} "
    f"strippath:{BOOL} coordinate:local|global angle:radian|degree fitaabb:{BOOL} eulerseq "
    f"meshdir texturedir discardvisual:{BOOL} usethread:{BOOL} fusestatic:{BOOL} "
    f"inertiafromgeom:{AUTO} inertiagrouprange:int2 saveinertial:{BOOL} savecompiled:{BOOL} "
    f"savecanonical:{BOOL} assetdir alignfree:{BOOL} conflict:warning|merge|error "
    "passthrough:none|textures",
    {
        "lengthrange": spec(
            f"mode:none|muscle|muscleuser|all useexisting:{BOOL} uselimit:{BOOL} accel:1 "
            "maxforce:1 timeconst:1 timestep:1 inttotal:1 interval:1 tolrange:1"
        )
    },
)
