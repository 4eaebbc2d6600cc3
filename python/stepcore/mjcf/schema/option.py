"""The section `<option>`, and the old section `<size>`."""

from stepcore.mjcf.schema.notation import ABLE, spec

FLAGS = (
    "constraint equality frictionloss limit contact spring damper gravity clampctrl warmstart "
    "filterparent actuation refsafe sensor midphase eulerdamp autoreset nativeccd island "
    "multiccd override energy fwdinv invdiscrete sleep diagexact ipc speculative"
)
OPTION = spec(
    "timestep:1 impratio:1 tolerance:1 ls_tolerance:1 noslip_tolerance:1 ccd_tolerance:1 "
    "sleep_tolerance:1 gravity:3 wind:3 magnetic:3 density:1 viscosity:1 o_margin:1 "
    "o_solref:1-2 o_solimp:1-5 o_friction:1-5 "
    "integrator:Euler|RK4|implicit|implicitfast|discrete cone:pyramidal|elliptic "
    "jacobian:dense|sparse|auto solver:PGS|CG|Newton iterations:int ls_iterations:int "
    "noslip_iterations:int ccd_iterations:int sdf_iterations:int sdf_initpoints:int "
    "actuatorgroupdisable:int*",
    {"flag": spec(" ".join(f"{name}:{ABLE}" for name in FLAGS.split()))},
    once=("flag",),
)
SIZE = spec(
    "memory njmax nconmax nstack nuserdata nkey:int nuser_body nuser_jnt nuser_geom nuser_site "
    "nuser_cam nuser_tendon nuser_actuator nuser_sensor"
)
