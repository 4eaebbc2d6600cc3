"""For every element of MJCF a scene in which its attributes matter.

The scene of a path, "section/tag", is `SCENES[path]`, in which ``@`` stands for the attributes of
the element; `BASE[path]` are those that it has anyway.
"""

OPTION = 'timestep=".004" solver="Newton" iterations="200" tolerance="0"'
ROBOT = """<mujoco><compiler angle="radian"/>{option}{before}
<worldbody><geom name="floor" type="plane" size="5 5 .1"/>
  <body name="arm" pos="0 0 .6"><joint name="j" axis="0 1 0" range="-.5 -.01" stiffness="3"
      springref=".1" damping=".2" frictionloss=".05"/>
    <joint name="l" type="slide" axis="1 0 0" pos="0 .1 0"/>
    <geom name="upper" type="capsule" size=".04" fromto="0 0 0 .4 0 0"/>
    <site name="s1" pos=".1 .1 0"/>
    <body name="fore" pos=".4 0 0"><joint name="k" axis="0 .6 .8"/>
      <geom name="lower" type="box" size=".15 .04 .03" pos=".15 0 0"/>
      <site name="s2" pos=".3 0 .1" euler=".1 .2 .3"/></body></body>
  <body name="ball" pos="1 0 .097"><freejoint name="free"/>
    <geom name="bg" size=".1" friction=".4"/><site name="s3"/></body>
  {world}</worldbody>{after}</mujoco>"""


def robot(
    before: str = "", world: str = "", after: str = "", option: str = f"<option {OPTION}/>"
) -> str:
    """The scene: an arm whose joint is at its limit, a ball that rests, and what is added."""
    return ROBOT.format(option=option, before=before, world=world, after=after)


BODY = """<body name="b" @><joint name="bj" axis="1 0 0"/>
<geom name="x" size=".1 .1 .1" pos=".1 .2 0"/></body>"""
GEOM = """<body name="b" pos="0 1 .09"><freejoint/><geom name="x" @/></body>
<body name="b2" pos="0 1 .28"><freejoint/><geom size=".1" friction=".3" condim="4"/></body>"""
ASLEEP = """<mujoco><option><flag {flag}/></option><worldbody><body pos="0 0 1" {body}>
<freejoint/><geom size=".1"/></body></worldbody><keyframe><key/></keyframe></mujoco>"""
CLASS = '<default><default class="cc"><joint stiffness="9"/></default></default>'
TETRA = '<mesh name="me" vertex="0 0 0 .125 0 0 0 .25 0 0 0 .375"/>'
ASSETS = f"""<asset>{TETRA}<material name="ma"/>
<hfield name="hf" size="1 1 .1 .1" nrow="2" ncol="2" elevation="0 .5 .5 1"/></asset>"""
MESH = '<body name="b" pos="0 1 .5"><joint axis="1 1 0"/><geom type="mesh" mesh="m"/></body>'
ACTUATORS = {
    "motor": 'joint="j"',
    "position": 'joint="j" kp="5"',
    "velocity": 'joint="j" kv="2"',
    "intvelocity": 'joint="j" kp="5" actrange="-1 1"',
    "general": 'joint="j" gainprm="3"',
    "damper": 'joint="j" kv="2" ctrlrange="0 1"',
    "cylinder": 'joint="j" timeconst=".1"',
    "muscle": 'joint="j" lengthrange="-.5 1"',
    "dcmotor": 'joint="j" motorconst=".5" resistance="1"',
    "pid": 'joint="j" kp="5" input="pos"',
    "adhesion": 'body="ball" ctrlrange="0 1"',
    "orientation": 'joint="bl" kp="3"',
}
BALL_BODY = """<body name="swing" pos="0 -1 1"><joint name="bl" type="ball"/>
<geom size=".1" pos=".2 0 0"/></body>
<body pos="0 -2 1"><joint name="bl2" type="ball"/><geom size=".1" pos=".2 0 0"/></body>"""
TENDONS = """<tendon><fixed name="tf"><joint joint="j" coef="1"/>
<joint joint="k" coef="-2"/></fixed></tendon>"""
SPATIAL = '<site site="s1"/><geom geom="wrap" sidesite="side"/><site site="s2"/>'
WRAP = """<geom name="wrap" size=".05" pos=".4 .05 .62" contype="0" conaffinity="0"/>
<site name="side" pos=".4 .05 .8"/>"""

SCENES: dict[str, str] = {
    "joint, held up": robot(
        world='<body name="b" pos="0 1 .5" gravcomp="1"><joint name="x" @/>'
        '<geom size=".1" pos=".1 .2 0"/></body>',
        after='<actuator><motor joint="x" gear="3" ctrlrange="-.1 .1"/></actuator>',
    ),
    "body, mocap": robot(
        world='<body name="b" @><geom name="x" size=".3 .3 .3"/></body>',
        after='<equality><connect body1="b" body2="fore" anchor="0 0 0"/></equality>',
    ),
    "geom, static": robot(
        before=ASSETS,
        world='<geom name="x" type="hfield" @/><body pos="0 0 2"><joint/><geom size=".1"/></body>',
    ),
    "compiler, ranges": robot(
        after="<compiler @/>",
        world='<body><joint limited="true" range="0 1"/><geom size="1"/></body>',
    ).replace("range=", 'limited="true" range=', 1),
    "option": robot(option="<option @/>", world=BALL_BODY),
    # Tangents of one contact that feel each other: one sweep does not end it.
    "option, noslip": robot(
        option="<option @/>",
        world='<body pos="0 1 .099"><freejoint/><geom size=".1" mass="0"/>'
        '<inertial pos=".05 .03 .02" mass="1" diaginertia=".01 .02 .025"/></body>',
    ),
    "option/flag": robot(
        world='<body pos="0 1 1"><joint axis="0 1 0" range="-1 -.01" solreflimit=".002 1"/>'
        '<geom size=".1"/></body>',
        after='<option><flag @/></option><actuator><motor name="m" joint="j" ctrlrange="-.1 .1"/>'
        "</actuator>"
        '<equality><connect body1="fore" body2="world" anchor=".3 0 0"/></equality>',
    ),
    "option/flag, override": robot(option=f'<option {OPTION} o_solref=".05 .7"><flag @/></option>'),
    # What sleeps from the start hangs in the air.
    "option/flag, sleep": ASLEEP.format(flag="@", body='sleep="init"'),
    "body, sleep": ASLEEP.format(flag='sleep="enable"', body="@"),
    "compiler": robot(
        after="<compiler @/>",
        before=ASSETS,
        world='<body name="b" pos="0 1 .5"><joint name="h" axis="1 0 0" range="-40 2"/>'
        '<geom type="box" size=".1 .2 .3" group="3" euler="30 20 10" pos="0 .3 0"/>'
        '<geom size=".05" pos=".2 0 .1"/></body>'
        '<body name="h2" pos="0 3 .5"><joint axis="1 0 0"/><geom size=".1" pos="0 .3 0"/>'
        '<inertial pos="0 .1 0" mass="3" diaginertia="1 1 1"/></body>'
        '<body name="fb" pos="0 2 .5"><freejoint/><geom type="box" size=".1 .2 .3" pos=".1 0 0"/>'
        "</body>",
    ),
    "size": robot(after="<size @/>"),
    "body": robot(before=CLASS, world=BODY),
    "frame": robot(
        before=CLASS,
        world='<frame @><body name="b" pos=".2 1 .5"><joint axis="1 0 0" damping=".1"'
        ' armature=".01"/><geom name="x" size=".1" pos=".1 .2 0"/></body></frame>',
    ),
    "replicate": robot(
        world='<replicate @><body name="b" pos=".2 1 .5"><joint axis="1 .3 0"/>'
        '<geom name="x" size=".1" pos=".1 .2 0"/></body></replicate>'
    ),
    "inertial": robot(
        world='<body name="b" pos="0 1 .5"><joint axis="1 0 0"/><inertial @/></body>'
    ),
    "joint": robot(
        world='<body name="b" pos="0 1 .5"><joint name="x" @/><geom size=".1" pos=".1 .2 0"/>'
        "</body>",
        after='<actuator><motor joint="x" gear="3"/></actuator>',
    ),
    "freejoint": robot(
        world='<body name="b" pos="0 1 .5"><freejoint @/>'
        '<geom type="box" size=".1 .2 .3" pos=".1 .2 0"/></body>'
    ),
    "geom": robot(before=ASSETS, world=GEOM),
    "site": robot(
        before=ASSETS,
        world='<body name="b" pos="0 1 .5"><joint axis="1 0 0"/><geom size=".1" pos=".1 .2 0"/>'
        '<site name="x" @/></body>',
        after='<actuator><motor site="x" gear="1 2 3 .1 .2 .3"/></actuator>',
    ),
    "asset/mesh": robot(
        before='<asset><material name="ma"/><mesh name="m" @/></asset>', world=MESH
    ),
    "asset/hfield": robot(
        before='<asset><hfield name="m" @/></asset>',
        world='<geom type="hfield" hfield="m" pos="0 2 0"/>'
        '<body pos="0 2 .5"><freejoint/><geom size=".45"/></body>',
    ),
    "contact/pair": robot(
        before='<default><geom contype="0"/></default>',
        after="<contact><pair @/></contact>",
    ),
    "contact/exclude": robot(after="<contact><exclude @/></contact>"),
    "tendon/fixed": robot(
        after='<tendon><fixed name="x" @><joint joint="j" coef="1"/><joint joint="k" coef="-2"/>'
        '</fixed></tendon><actuator><motor tendon="x" gear="3"/></actuator>'
    ),
    "tendon/fixed/joint": robot(
        after='<tendon><fixed stiffness="5"><joint joint="j" coef="1"/><joint @/></fixed></tendon>'
    ),
    "tendon/spatial": robot(
        before='<asset><material name="ma"/></asset>',
        world=WRAP,
        after=f'<tendon><spatial name="x" @>{SPATIAL}</spatial></tendon>'
        '<actuator><motor tendon="x" gear="3"/></actuator>',
    ),
    "tendon/spatial, straight": robot(
        after='<tendon><spatial name="x" @><site site="s1"/><site site="s2"/></spatial></tendon>'
        '<actuator><motor tendon="x" gear="3"/></actuator>',
    ),
    "tendon/spatial/site": robot(
        after='<tendon><spatial stiffness="50" springlength=".1"><site site="s1"/><site @/>'
        "</spatial></tendon>"
    ),
    "tendon/spatial/geom": robot(
        world=WRAP + '<site name="side2" pos=".4 .05 .3"/>'
        '<geom name="wrap2" size=".07" pos=".4 .08 .65" contype="0" conaffinity="0"/>',
        after='<tendon><spatial stiffness="50" springlength=".1"><site site="s1"/><geom @/>'
        '<site site="s2"/></spatial></tendon>',
    ),
    "tendon/spatial/pulley": robot(
        after='<tendon><spatial stiffness="50" springlength=".1"><site site="s1"/><site site="s3"/>'
        '<pulley @/><site site="s2"/><site site="s3"/></spatial></tendon>'
    ),
    "equality/connect": robot(after="<equality><connect @/></equality>"),
    "equality/weld": robot(after="<equality><weld @/></equality>"),
    "equality/joint": robot(after="<equality><joint @/></equality>"),
    "equality/tendon": robot(
        after='<tendon><fixed name="tf"><joint joint="j" coef="1"/></fixed><fixed name="tg">'
        '<joint joint="k" coef="1"/></fixed></tendon><equality><tendon @/></equality>'
    ),
    "keyframe/key": robot(
        world='<body name="mo" mocap="true"><geom size=".1"/></body>',
        after='<actuator><motor joint="j"/><intvelocity joint="k" kp="3" actrange="-1 1"/>'
        "</actuator>"
        "<keyframe><key @/></keyframe>",
    ),
    "actuator/intvelocity, plain": robot(
        after='<actuator><intvelocity joint="j" kp="5" @/></actuator>'
    ),
    **{
        f"actuator/{tag}": robot(
            world=BALL_BODY
            + '<geom type="box" name="wall" size=".1 .1 .1" pos="1 .15 .1" contype="0"/>',
            after=f"{TENDONS}<actuator><{tag} @/></actuator>",
        )
        for tag in ACTUATORS
    },
}
# Attributes that the element of a scene has in both models.
BASE: dict[str, str] = {
    "option": OPTION,
    "body": 'pos="0 1 .5"',
    "inertial": 'pos="0 0 .1" mass="1"',
    "contact/pair": 'geom1="floor" geom2="bg"',
    "tendon/spatial/geom": 'geom="wrap"',
    "geom": 'size=".1 .1 .1"',
    "replicate": 'count="2"',
    "contact/exclude": 'body1="ball" body2="world"',
    **{f"actuator/{tag}": words for tag, words in ACTUATORS.items()},
}
