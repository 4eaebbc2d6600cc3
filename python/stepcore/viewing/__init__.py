"""Looking at motion: pages that replay it, a live view, pictures and videos.

All of them show the same `Drawing`: the shapes of a model in the frames of its bodies, with the
colours of its file. What they are drawn with is an extra each, and imported only when it is used.
"""
