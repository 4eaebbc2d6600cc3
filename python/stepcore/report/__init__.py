"""Reports: how results become text, tables, plots, pages and data."""
