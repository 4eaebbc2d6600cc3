"""The tables of `extremes.py`: each file yields the cells of one scene."""
