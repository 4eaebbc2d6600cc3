"""The pairs of shapes that the tests go through."""

BUILT = [
    ("plane", "sphere"),
    ("plane", "capsule"),
    ("plane", "ellipsoid"),
    ("plane", "cylinder"),
    ("plane", "box"),
    ("sphere", "sphere"),
    ("sphere", "capsule"),
    ("sphere", "ellipsoid"),
    ("sphere", "box"),
    ("capsule", "capsule"),
    ("capsule", "ellipsoid"),
    ("ellipsoid", "ellipsoid"),
    ("ellipsoid", "cylinder"),
    ("ellipsoid", "box"),
    ("cylinder", "box"),
    ("sphere", "cylinder"),
    ("capsule", "box"),
    ("box", "box"),
]
