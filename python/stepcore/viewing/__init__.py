"""Views of motion: pages that replay it, a live view, pictures and videos.

All of them show the same `Drawing`: the shapes of a model in the frames of its bodies, with the
colours of its file. Each kind of drawing needs an extra, which is imported when it is used.
"""
