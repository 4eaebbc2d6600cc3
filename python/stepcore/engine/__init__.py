"""What is stepped: the compiled model, one world, many worlds, views by name."""
