"""The elements of a `Scene`: records whose fields are checked on every assignment.

Units are SI, angles are in radians, quaternions are w x y z and stored at unit length. A value
outside its limits, of the wrong shape or not finite raises a ValueError that names the element,
the field, the value and the limit. The element then stays unchanged. Field names and defaults are
MuJoCo's. Elements compare by identity.
"""

from stepcore.scene.element import Element as Element
from stepcore.scene.element import make_element as make_element
from stepcore.scene.elements.actuator import Actuator as Actuator
from stepcore.scene.elements.body import Body as Body
from stepcore.scene.elements.body import Joint as Joint
from stepcore.scene.elements.body import Site as Site
from stepcore.scene.elements.equality import Equality as Equality
from stepcore.scene.elements.field_types import GRAVITY as GRAVITY
from stepcore.scene.elements.field_types import MAGNETIC as MAGNETIC
from stepcore.scene.elements.field_types import SOLIMP as SOLIMP
from stepcore.scene.elements.field_types import SOLREF as SOLREF
from stepcore.scene.elements.field_types import WHOLE as WHOLE
from stepcore.scene.elements.geom import ContactOverride as ContactOverride
from stepcore.scene.elements.geom import Geom as Geom
from stepcore.scene.elements.geom import HField as HField
from stepcore.scene.elements.geom import Mesh as Mesh
from stepcore.scene.elements.geom import Pair as Pair
from stepcore.scene.elements.sensor import Sensor as Sensor
from stepcore.scene.elements.tendon import Pulley as Pulley
from stepcore.scene.elements.tendon import Tendon as Tendon
from stepcore.scene.elements.world import Features as Features
from stepcore.scene.elements.world import Key as Key
from stepcore.scene.elements.world import LengthRange as LengthRange
from stepcore.scene.elements.world import MassRules as MassRules
