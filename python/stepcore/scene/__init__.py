"""Scenes: elements with checked fields, poses, and the order of elements in the model."""
