"""An independent oracle for where two convex shapes touch, in numpy, over many poses at once.

It shares neither code nor idea with the engine, which has closed forms, clipping and a descent on
Minkowski differences. Here there is one function of a direction,

    g(n) = min over B of n·b − max over A of n·a        |n| = 1, from A to B,

how far two planes across n can be apart with A behind one and B before the other. The signed
distance is its maximum over all n, for shapes apart (how far) and for shapes that overlap (minus
the shortest way out). So any direction proves a lower bound of the distance; two points, one of
each shape, prove an upper bound where the shapes are apart; where they overlap a covering of all
directions does.

`convex.py` has the shapes, `search.py` the maximum, `cover.py` the proof that it is one,
`certificate.py` judges an answer by what it claims, `poses.py` draws poses and sizes.
"""
