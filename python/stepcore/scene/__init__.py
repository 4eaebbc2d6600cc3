"""What people write: elements, frames, layout, checked values."""
