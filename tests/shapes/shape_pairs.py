"""The pairs of shapes that the tests go through."""

BUILT = [
    ("plane", "sphere"),
    ("plane", "capsule"),
    ("plane", "ellipsoid"),
    ("plane", "cylinder"),
    ("plane", "box"),
    ("plane", "mesh"),
    ("sphere", "sphere"),
    ("sphere", "capsule"),
    ("sphere", "ellipsoid"),
    ("sphere", "cylinder"),
    ("sphere", "box"),
    ("sphere", "mesh"),
    ("capsule", "capsule"),
    ("capsule", "ellipsoid"),
    ("capsule", "box"),
    ("capsule", "mesh"),
    ("ellipsoid", "ellipsoid"),
    ("ellipsoid", "cylinder"),
    ("ellipsoid", "box"),
    ("ellipsoid", "mesh"),
    ("cylinder", "box"),
    ("cylinder", "mesh"),
    ("box", "mesh"),
    ("mesh", "mesh"),
    ("capsule", "cylinder"),
    ("cylinder", "cylinder"),
]

# Overlapping, these take a face where a pair of edges is a little nearer: see docs/trust.md.
FACES_FIRST = [("box", "box")]
