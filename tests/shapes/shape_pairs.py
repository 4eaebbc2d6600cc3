"""The pairs of shapes that the tests go through."""

ROUND = ("sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh")
BUILT = [
    ("plane", "sphere"),
    ("plane", "capsule"),
    ("plane", "ellipsoid"),
    ("plane", "cylinder"),
    ("plane", "box"),
    ("sphere", "sphere"),
    ("sphere", "capsule"),
    ("sphere", "box"),
    ("capsule", "capsule"),
]
