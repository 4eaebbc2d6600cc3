"""The layout of the joint coordinates; it stands in `stepcore.engine.coordinates`."""

from stepcore.engine.coordinates import Coordinates as Coordinates
from stepcore.engine.coordinates import cross as cross
from stepcore.engine.coordinates import product as product
from stepcore.engine.coordinates import rotated as rotated
from stepcore.engine.coordinates import rotation as rotation
from stepcore.engine.coordinates import turned as turned
