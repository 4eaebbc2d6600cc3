"""Results as text, tables, pictures, pages and data."""
